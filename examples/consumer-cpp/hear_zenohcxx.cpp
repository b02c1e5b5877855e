#include <utility>

#include "hear.hpp"
#include "zenoh.hxx"

namespace {
class OfZenohCpp : public Hearing {
public:
    OfZenohCpp(zenoh::Config config, const std::string& key, Take take)
        : session_(zenoh::Session::open(std::move(config))),
          subscriber_(session_.declare_subscriber(
              zenoh::KeyExpr(key),
              [take = std::move(take)](const zenoh::Sample& sample) {
                  const auto bytes = sample.get_payload().as_vector();
                  take(bytes.data(), bytes.size(), sample.get_encoding().as_string());
              },
              zenoh::closures::none)) {}

private:
    zenoh::Session session_;
    zenoh::Subscriber<void> subscriber_;
};
}  // namespace

// zenoh::ZException, which it throws, is a std::runtime_error.
std::unique_ptr<Hearing> hear(const std::string& endpoint, const std::string& key, Take take) {
    auto config = zenoh::Config::create_default();
    config.insert_json5("mode", "\"client\"");
    config.insert_json5("scouting/multicast/enabled", "false");
    config.insert_json5("connect/endpoints", "[\"" + endpoint + "\"]");
    return std::make_unique<OfZenohCpp>(std::move(config), key, std::move(take));
}
