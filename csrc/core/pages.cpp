#include "core/pages.h"

#ifdef __linux__

#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <sys/mman.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdlib>
#include <map>
#include <mutex>
#include <thread>

namespace mipbake {
namespace {

// A guess: lookups at random points bring back some 20 MB meanwhile.
constexpr std::chrono::milliseconds kPeriod(1);

}  // namespace

struct Pages::Shared {
    std::mutex mutex;  // guards all; nothing is unmapped while pages are let go of
    std::condition_variable wake;
    bool ended = false;
    std::map<void*, std::size_t> mappings;
    std::thread watcher;

    void release() {
        for (const auto& [start, bytes] : mappings) madvise(start, bytes, MADV_DONTNEED);
    }

    void watch(std::int64_t most) {
        std::unique_lock<std::mutex> lock(mutex);
        while (!wake.wait_for(lock, kPeriod, [&] { return ended; }))
            if (!mappings.empty() && resident_bytes() > most) release();
    }
};

bool pages_supported() { return true; }

std::int64_t resident_bytes() {
    static const int file = open("/proc/self/statm", O_RDONLY | O_CLOEXEC);
    std::array<char, 128> text{};
    if (file < 0 || pread(file, text.data(), text.size() - 1, 0) <= 0) return 0;
    char* after = nullptr;
    std::strtoll(text.data(), &after, 10);  // the size of the address space comes first
    return std::strtoll(after, nullptr, 10) * sysconf(_SC_PAGESIZE);
}

Pages::Pages(std::int64_t most) : shared_(std::make_shared<Shared>()) {
    // Signals are for other threads: one that waits would go on waiting.
    sigset_t all, before;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &before);
    shared_->watcher = std::thread([shared = shared_.get(), most] { shared->watch(most); });
    pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

Pages::~Pages() {
    {
        const std::lock_guard<std::mutex> lock(shared_->mutex);
        shared_->ended = true;
    }
    shared_->wake.notify_all();
    shared_->watcher.join();
}

std::shared_ptr<void> Pages::map(int file, std::int64_t bytes) {
    const auto size = static_cast<std::size_t>(bytes);
    void* const start = mmap(nullptr, size, PROT_READ | PROT_WRITE, MAP_SHARED, file, 0);
    if (start == MAP_FAILED) return nullptr;
    const std::lock_guard<std::mutex> lock(shared_->mutex);
    shared_->mappings.emplace(start, size);
    return {start, [shared = shared_](void* mapped) {
                const std::lock_guard<std::mutex> unmapping(shared->mutex);
                const auto found = shared->mappings.find(mapped);
                munmap(mapped, found->second);
                shared->mappings.erase(found);
            }};
}

void Pages::release() {
    const std::lock_guard<std::mutex> lock(shared_->mutex);
    shared_->release();
}

}  // namespace mipbake

#else

namespace mipbake {

struct Pages::Shared {};

bool pages_supported() { return false; }

std::int64_t resident_bytes() { return 0; }

Pages::Pages(std::int64_t) {}

Pages::~Pages() = default;

std::shared_ptr<void> Pages::map(int, std::int64_t) { return nullptr; }

void Pages::release() {}

}  // namespace mipbake

#endif
