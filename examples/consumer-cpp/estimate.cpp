#include "estimate.hpp"

#include <stdexcept>

#include "tilth.pb.h"

Estimate estimate_of(const std::uint8_t* bytes, std::size_t size, const std::string& encoding) {
    if (encoding != "application/protobuf;tilth.SoilTireEstimate") {
        throw std::invalid_argument("its encoding is " + encoding);
    }
    tilth::SoilTireEstimate message;
    if (!message.ParseFromArray(bytes, static_cast<int>(size))) throw std::invalid_argument("not a message");
    if (message.parameters_size() != static_cast<int>(PARAMETERS)) {
        throw std::invalid_argument("not the six parameters of this version");
    }
    Estimate found;
    found.t_ns = message.t_ns();
    found.heard = std::chrono::steady_clock::now();
    for (std::size_t i = 0; i < PARAMETERS; ++i) {
        const auto& sent = message.parameters(static_cast<int>(i));
        if (sent.name() != NAMES[i]) throw std::invalid_argument("not the six parameters of this version");
        auto& row = found.rows[i];
        // A plain getter says 0.0 for what is absent.
        if (sent.has_value()) row.value = sent.value();
        if (sent.has_sd()) row.sd = sent.sd();
        if (sent.has_age_s()) row.age = sent.age_s();
        row.estimated = sent.status() == tilth::ESTIMATED;
        const auto& code = sent.why().code();
        code.copy(row.code.data(), row.code.size() - 1);  // shortened, and always ended
    }
    return found;
}

const char* refusal(const Estimate& estimate, std::size_t i, std::chrono::steady_clock::time_point now,
                    const Staleness& stale) noexcept {
    if (estimate.t_ns == 0) return "nothing_heard";
    const double age = std::chrono::duration<double>(now - estimate.heard).count();
    if (!(age <= stale.silence)) return "silence";
    const auto& row = estimate.rows[i];
    if (!row.estimated) return row.code[0] != '\0' ? row.code.data() : "not_estimated";
    if (!(std::isfinite(row.value) && row.value > 0.0 && std::isfinite(row.sd) && row.sd > 0.0)) {
        return "no_value";
    }
    if (std::isfinite(stale.data) && !(row.age + age <= stale.data)) return "old_data";
    return "";
}
