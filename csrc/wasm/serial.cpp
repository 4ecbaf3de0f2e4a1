// In place of core/parallel.cpp: a module of WebAssembly runs on one thread. The npm package hands parts of a bake to
// workers instead.
#include <algorithm>

#include "core/parallel.h"

namespace mipbake {

int num_threads() { return 1; }
void set_num_threads(int) {}

namespace detail {

// Ranges are those that threads would have, so results are the same.
void parallel_for(std::int64_t n, std::int64_t grain, void (*body)(void*, std::int64_t, std::int64_t), void* context) {
    grain = std::max<std::int64_t>(1, grain);
    for (std::int64_t begin = 0; begin < n; begin += grain) body(context, begin, std::min(n, begin + grain));
}

}  // namespace detail
}  // namespace mipbake
