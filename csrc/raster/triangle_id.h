// The fourth channel of a rasterised pixel: the number of its triangle + 1, or 0 where there is none.
#pragma once

#include <cstdint>

#include "core/platform.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// The index of the triangle, or -1 where the pixel is empty. A number that is neither (NaN is not) clears `valid` and
// counts as empty; `count` is the number of triangles, exact in T.
template <class T>
MIPBAKE_INLINE std::int32_t triangle_of(T id, T count, bool& valid) {
    const bool good = id >= T(0) && id <= count;
    valid = valid && good;
    return good ? static_cast<std::int32_t>(id) - 1 : -1;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
