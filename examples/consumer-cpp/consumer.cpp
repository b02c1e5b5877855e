// Hears the recommended estimate of a Tilth daemon; a real-time thread knows a hundred times a second which
// numbers it may use.
//
//     tilth_consumer tcp/127.0.0.1:7447 tilth/jd7930-parker500 [LINES]
//
// Three threads. Zenoh's hears, reads the message and puts an Estimate into a ring. The real-time one takes it
// from there, and puts what it has in force into another ring. This one prints that, once a second. Between
// them nobody waits; after its start the real-time thread allocates nothing, and ends the program if it does.
#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <time.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <mutex>
#include <new>
#include <thread>

#include "estimate.hpp"
#include "hear.hpp"
#include "ring.hpp"

namespace {
using Clock = std::chrono::steady_clock;

constexpr Staleness STALE{3.0, 300.0};
constexpr std::array<double, PARAMETERS> NOMINAL{220e3, 486e3, 167e3, 0.4, 0.6, 0.5};  // your own rig's
constexpr long PERIOD_NS = 10'000'000;
constexpr int A_SECOND = 100;  // periods

struct InForce {
    std::array<double, PARAMETERS> theta{};                // N/rad and m: estimated, or nominal
    std::array<std::array<char, 32>, PARAMETERS> codes{};  // why nominal, "" where estimated
};

Ring<Estimate, 8> estimates;  // one comes each second
Ring<InForce, 8> told;
std::atomic<bool> running{true};
thread_local bool is_real_time = false;

// One turn of a controller: what it may use now. Your gains and your command come here.
void turn(const Estimate& last, InForce& force) noexcept {
    const auto now = Clock::now();
    for (std::size_t i = 0; i < PARAMETERS; ++i) {
        const char* why = refusal(last, i, now, STALE);
        force.theta[i] = *why == '\0' ? last.rows[i].value : NOMINAL[i];
        std::snprintf(force.codes[i].data(), force.codes[i].size(), "%s", why);
    }
}

void real_time() noexcept {
    // Without the right to a priority, an ordinary thread, with the jitter of one.
    const sched_param most{.sched_priority = 50};
    if (pthread_setschedparam(pthread_self(), SCHED_FIFO, &most) != 0 || mlockall(MCL_CURRENT) != 0) {
        std::fputs("no right to real time: see limits.conf, rtprio and memlock\n", stderr);
    }
    static Estimate last;
    static InForce force;
    timespec next{};
    clock_gettime(CLOCK_MONOTONIC, &next);
    is_real_time = true;
    for (int k = 1; running.load(std::memory_order_relaxed); ++k) {
        while (estimates.take(last)) {
        }
        turn(last, force);
        if (k % A_SECOND == 0) told.put(force);
        next.tv_nsec += PERIOD_NS;
        if (next.tv_nsec >= 1'000'000'000) {
            next.tv_nsec -= 1'000'000'000;
            ++next.tv_sec;
        }
        clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &next, nullptr);
    }
    is_real_time = false;
}

void print(const InForce& force) {
    for (std::size_t i = 0; i < PARAMETERS; ++i) {
        const char* why = force.codes[i].data();
        const char* end = i + 1 < PARAMETERS ? "; " : "\n";
        if (*why == '\0') {
            std::printf("%s=%.4f%s", NAMES[i], force.theta[i], end);
        } else {
            std::printf("%s: %s%s", NAMES[i], why, end);
        }
    }
    std::fflush(stdout);
}

int run(const std::string& endpoint, const std::string& base, long lines) {
    std::mutex putting;  // Zenoh may call from several threads; the ring takes from one
    std::uint64_t last_ns = 0;
    const auto hearing = hear(endpoint, base + "/soil_tire", [&](auto* bytes, auto size, auto& encoding) {
        try {
            const auto estimate = estimate_of(bytes, size, encoding);
            const std::lock_guard<std::mutex> alone(putting);
            if (estimate.t_ns == last_ns) return;  // the same again does not grow younger
            last_ns = estimate.t_ns;
            if (!estimates.put(estimate)) std::fputs("dropped: the real-time thread does not take them\n", stderr);
        } catch (const std::exception& error) {  // whatever a stranger sent
            std::fprintf(stderr, "refused: %s\n", error.what());
        }
    });
    std::thread controller(real_time);
    for (InForce force; lines > 0;) {
        if (told.take(force)) {
            print(force);
            --lines;
        } else {
            std::this_thread::sleep_for(std::chrono::milliseconds(20));
        }
    }
    running = false;
    controller.join();
    return 0;
}
}  // namespace

// Whatever is made in C++ comes here.
void* operator new(std::size_t size) {
    if (is_real_time) {
        std::fputs("the real-time thread has allocated\n", stderr);
        std::abort();
    }
    if (void* made = std::malloc(size > 0 ? size : 1)) return made;
    throw std::bad_alloc();
}
void operator delete(void* made) noexcept { std::free(made); }
void operator delete(void* made, std::size_t) noexcept { std::free(made); }

int main(int count, char** words) {
    if (count < 3) {
        std::fputs("tilth_consumer ENDPOINT PREFIX/MACHINE [LINES]\n", stderr);
        return 2;
    }
    try {
        return run(words[1], words[2], count > 3 ? std::stol(words[3]) : 1'000'000'000L);
    } catch (const std::exception& error) {
        std::fprintf(stderr, "%s\n", error.what());
        return 1;
    }
}
