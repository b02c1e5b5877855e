#include <stdexcept>
#include <utility>

#include "hear.hpp"

extern "C" {  // of ../consumer-rust/src/lib.rs
struct TilthHearing;
using TilthTake = void (*)(void* context, const std::uint8_t* bytes, std::size_t size, const char* encoding);
TilthHearing* tilth_hear(const char* endpoint, const char* key, TilthTake take, void* context);
void tilth_hear_no_more(TilthHearing* hearing);
}

namespace {
class OfRust : public Hearing {
public:
    OfRust(const std::string& endpoint, const std::string& key, Take take)
        : take_(std::move(take)), hearing_(tilth_hear(endpoint.c_str(), key.c_str(), &OfRust::call, &take_)) {
        if (hearing_ == nullptr) throw std::runtime_error(endpoint + ": nobody is heard there");
    }
    ~OfRust() override { tilth_hear_no_more(hearing_); }
    OfRust(const OfRust&) = delete;
    OfRust& operator=(const OfRust&) = delete;

private:
    static void call(void* context, const std::uint8_t* bytes, std::size_t size, const char* encoding) {
        (*static_cast<Take*>(context))(bytes, size, encoding);
    }
    Take take_;
    TilthHearing* hearing_;
};
}  // namespace

std::unique_ptr<Hearing> hear(const std::string& endpoint, const std::string& key, Take take) {
    return std::make_unique<OfRust>(endpoint, key, std::move(take));
}
