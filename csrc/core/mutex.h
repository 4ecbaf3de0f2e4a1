// A mutex where there are threads, and none in WebAssembly, where there is one thread.
#pragma once

#include <mutex>

namespace mipbake {

#ifdef __wasi__
struct Mutex {
    void lock() {}
    void unlock() {}
    bool try_lock() { return true; }
};
#else
using Mutex = std::mutex;
#endif

}  // namespace mipbake
