// Zenoh, as much of it as this program needs. hear_zenohcxx.cpp has it of zenoh-cpp, hear_rust.cpp of the
// static library that cargo builds in ../consumer-rust.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

// What came on the key, in a thread of Zenoh's.
using Take = std::function<void(const std::uint8_t* bytes, std::size_t size, const std::string& encoding)>;

// A subscription; ends with it. `hear` throws std::runtime_error where there is nobody at the endpoint.
struct Hearing {
    virtual ~Hearing() = default;
};
std::unique_ptr<Hearing> hear(const std::string& endpoint, const std::string& key, Take take);
