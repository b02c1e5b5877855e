// Two threads, a million values through eight places: all of them, in order, whole. Built with the thread
// sanitizer where the compiler has it.
#include <array>
#include <cstdint>
#include <cstdio>
#include <thread>

#include "ring.hpp"

using Value = std::array<std::uint64_t, 9>;  // more than a processor moves at once

int main() {
    static Ring<Value, 8> ring;
    constexpr std::uint64_t most = 1'000'000;
    std::thread puts([] {
        for (std::uint64_t k = 1; k <= most;) {
            Value value;
            value.fill(k);
            if (ring.put(value)) {
                ++k;
            } else {
                std::this_thread::yield();
            }
        }
    });
    std::uint64_t expected = 1, wrong = 0;
    for (Value value; expected <= most;) {
        if (!ring.take(value)) {
            std::this_thread::yield();
            continue;
        }
        for (const auto part : value) wrong += part != expected;
        ++expected;
    }
    puts.join();
    Value left;
    wrong += ring.take(left);
    std::printf("%llu values, %llu wrong\n", static_cast<unsigned long long>(most),
                static_cast<unsigned long long>(wrong));
    return wrong != 0;
}
