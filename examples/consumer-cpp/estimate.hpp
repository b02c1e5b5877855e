// An estimate as a real-time thread can hold it: of fixed size, owning no memory, and what of it may be used.
#pragma once

#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <string>

inline constexpr std::size_t PARAMETERS = 6;
inline constexpr std::array<const char*, PARAMETERS> NAMES{"C_af", "C_ar", "C_ai", "sigma_f", "sigma_r", "sigma_i"};

struct Staleness {   // choose what your loop can bear; s
    double silence;  // since an estimate came
    double data;     // since data last informed a parameter: at 2 m/s, 300 s are 600 m of field
};

struct Row {
    double value = NAN;  // N/rad or m; NaN: absent, which is not 0.0
    double sd = NAN;
    double age = NAN;  // s since data last informed it, when it was sent
    bool estimated = false;
    std::array<char, 32> code{};  // why not, as schemas/reasons.py has it
};

struct Estimate {
    std::uint64_t t_ns = 0;
    std::chrono::steady_clock::time_point heard{};  // this computer's own clock: clocks need not agree
    std::array<Row, PARAMETERS> rows{};
};

// Raises std::invalid_argument for what is no estimate of this version. It allocates: for Zenoh's thread.
Estimate estimate_of(const std::uint8_t* bytes, std::size_t size, const std::string& encoding);

// Why this parameter may not be used now, "" where it may. Allocates nothing, waits for nobody.
const char* refusal(const Estimate& estimate, std::size_t i, std::chrono::steady_clock::time_point now,
                    const Staleness& stale) noexcept;
