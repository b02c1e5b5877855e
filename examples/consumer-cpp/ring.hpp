// A ring between two threads: one puts, one takes, neither waits, nothing is allocated.
#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <type_traits>

// Holds up to N values of T, which are copied. `put` belongs to one thread, `take` to one other.
template <typename T, std::size_t N>
class Ring {
    static_assert(N > 0 && (N & (N - 1)) == 0, "a power of two");
    static_assert(std::is_trivially_copyable_v<T>, "what owns memory would be freed in the wrong thread");
    static_assert(std::atomic<std::size_t>::is_always_lock_free, "this processor would need a lock");

public:
    // False where it is full: the value is dropped, and who takes is slow or gone.
    bool put(const T& value) noexcept {
        const auto at = put_.load(std::memory_order_relaxed);
        if (at - taken_.load(std::memory_order_acquire) == N) return false;
        values_[at % N] = value;
        put_.store(at + 1, std::memory_order_release);  // only now it is there
        return true;
    }

    // False where there is nothing.
    bool take(T& value) noexcept {
        const auto at = taken_.load(std::memory_order_relaxed);
        if (at == put_.load(std::memory_order_acquire)) return false;
        value = values_[at % N];
        taken_.store(at + 1, std::memory_order_release);  // only now its place may be written again
        return true;
    }

private:
    // On lines of the cache of their own: one thread's counting does not slow the other down.
    alignas(64) std::atomic<std::size_t> put_{0};
    alignas(64) std::atomic<std::size_t> taken_{0};
    alignas(64) std::array<T, N> values_{};
};
