#include "core/parallel.h"

#include <algorithm>
#include <atomic>
#include <condition_variable>
#include <cstdlib>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <system_error>
#include <thread>
#include <vector>

#ifndef _WIN32
#include <pthread.h>
#endif

#include "core/environment.h"

namespace mipbake {
namespace {

// One loop in flight. Workers and the caller take chunks from `next` until none is left.
struct Loop {
    std::int64_t n, grain, chunks;
    void (*body)(void*, std::int64_t, std::int64_t);
    void* context;
    std::atomic<std::int64_t> next{0};
    int seats;        // workers that may still join; guarded by the pool's mutex
    int working = 0;  // workers that have joined and not left; guarded by the pool's mutex

    void run() {
        for (std::int64_t i = next.fetch_add(1); i < chunks; i = next.fetch_add(1))
            body(context, i * grain, std::min(n, (i + 1) * grain));
    }
};

thread_local bool inside_loop = false;

class Pool {
  public:
    // False where another thread's loop has the pool: the caller then runs serially instead of waiting.
    bool run(Loop& loop) {
        const std::unique_lock<std::mutex> turn(turn_, std::try_to_lock);
        if (!turn.owns_lock()) return false;
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            while (static_cast<int>(threads_.size()) < loop.seats && begin_thread()) {
            }
            loop_ = &loop;
        }
        wake_.notify_all();
        loop.run();
        std::unique_lock<std::mutex> lock(mutex_);
        loop_ = nullptr;
        idle_.wait(lock, [&] { return loop.working == 0; });
        return true;
    }

    ~Pool() {
        {
            const std::lock_guard<std::mutex> lock(mutex_);
            stopping_ = true;
        }
        wake_.notify_all();
        for (std::thread& thread : threads_) thread.join();
    }

  private:
    // False where the system gives no more threads: the loop then has those that there are, and the caller.
    bool begin_thread() {
        try {
            threads_.emplace_back([this] { work(); });
            return true;
        } catch (const std::system_error&) {
            return false;
        }
    }

    void work() {
        inside_loop = true;
        std::unique_lock<std::mutex> lock(mutex_);
        for (;;) {
            wake_.wait(lock, [&] { return stopping_ || (loop_ != nullptr && loop_->seats > 0); });
            if (stopping_) return;
            Loop& loop = *loop_;
            --loop.seats;
            ++loop.working;
            lock.unlock();
            loop.run();
            lock.lock();
            loop.seats = 0;  // nothing is left to take
            if (--loop.working == 0) idle_.notify_one();
        }
    }

    std::mutex turn_, mutex_;
    std::condition_variable wake_, idle_;
    std::vector<std::thread> threads_;
    Loop* loop_ = nullptr;
    bool stopping_ = false;
};

int default_threads() {
    constexpr long most = 1024;
    const char* const text = std::getenv("MIPBAKE_THREADS");
    if (text == nullptr || *text == '\0')
        return static_cast<int>(std::clamp(static_cast<long>(std::thread::hardware_concurrency()), 1L, most));
    const std::string_view digits = text;
    const bool whole = digits.find_first_not_of("0123456789") == digits.npos;
    const long count = whole ? std::strtol(text, nullptr, 10) : 0;
    if (count < 1 || count > most)
        throw EnvironmentFault("the environment variable MIPBAKE_THREADS is '" + std::string(digits) +
                               "': expected a whole number from 1 to 1024, or no such variable for every core");
    return static_cast<int>(count);
}

std::atomic<int>& thread_count() {
    static std::atomic<int> count{default_threads()};
    return count;
}

// Created by the first parallel loop and never destroyed: joining threads while a process exits can hang it. A forked
// child has none of its parent's threads, so it abandons the pool and starts its own when it needs one.
std::atomic<Pool*> the_pool{nullptr};

Pool& pool() {
    static std::mutex creating;
    Pool* current = the_pool.load(std::memory_order_acquire);
    if (current != nullptr) return *current;
    const std::lock_guard<std::mutex> lock(creating);
    current = the_pool.load(std::memory_order_acquire);
    if (current == nullptr) {
#ifndef _WIN32
        static const int registered = pthread_atfork(nullptr, nullptr, [] {
            the_pool.store(nullptr, std::memory_order_release);
            inside_loop = false;
        });
        static_cast<void>(registered);
#endif
        current = std::make_unique<Pool>().release();
        the_pool.store(current, std::memory_order_release);
    }
    return *current;
}

}  // namespace

int num_threads() { return thread_count().load(); }

void set_num_threads(int count) { thread_count().store(std::max(1, count)); }

namespace detail {

void parallel_for(std::int64_t n, std::int64_t grain, void (*body)(void*, std::int64_t, std::int64_t), void* context) {
    if (n <= 0) return;
    grain = std::max<std::int64_t>(1, grain);
    Loop loop;
    loop.n = n;
    loop.grain = grain;
    loop.chunks = (n + grain - 1) / grain;
    loop.body = body;
    loop.context = context;
    loop.seats = static_cast<int>(std::min<std::int64_t>(num_threads(), loop.chunks)) - 1;
    if (loop.seats <= 0 || inside_loop) {
        loop.run();
        return;
    }
    inside_loop = true;
    if (!pool().run(loop)) loop.run();
    inside_loop = false;
}

}  // namespace detail
}  // namespace mipbake
