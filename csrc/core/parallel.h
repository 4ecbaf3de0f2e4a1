// One parallel loop over a persistent pool of threads.
#pragma once

#include <cstdint>
#include <memory>
#include <type_traits>

namespace mipbake {

// Threads that a parallel loop may use, the caller included. The default is MIPBAKE_THREADS in the environment, or the
// number of hardware threads; EnvironmentFault where MIPBAKE_THREADS is not a number from 1 to 1024.
int num_threads();
void set_num_threads(int count);

namespace detail {
void parallel_for(std::int64_t n, std::int64_t grain, void (*body)(void*, std::int64_t, std::int64_t), void* context);
}

// Calls f(begin, end) on disjoint ranges that cover [0, n). Every range begins at a multiple of `grain` and is `grain`
// long, but for the last, WHATEVER the number of threads: what a range computes never depends on it, so results are
// reproducible bit for bit. The caller takes part. Inside f, a nested parallel_for runs serially. f must not throw.
template <class F>
void parallel_for(std::int64_t n, std::int64_t grain, F&& f) {
    using Body = std::remove_reference_t<F>;
    detail::parallel_for(
        n, grain, [](void* body, std::int64_t begin, std::int64_t end) { (*static_cast<Body*>(body))(begin, end); },
        const_cast<void*>(static_cast<const void*>(std::addressof(f))));
}

}  // namespace mipbake
