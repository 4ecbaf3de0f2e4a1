// The fourth channel of a rasterised pixel: the number of its triangle + 1, or 0 where there is none.
//
// Numbers of T: a double holds each of them. A float holds those up to 2^24; each further number is the next float, so
// number n has the bits kFloatBits + n, as in nvdiffrast. Both orders are the same.
#pragma once

#include <cstdint>
#include <cstring>
#include <type_traits>

#include "core/platform.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

constexpr std::int32_t kFloatNumbers = 1 << 24, kFloatBits = 0x4a800000;

// A number as T holds it.
template <class T>
MIPBAKE_INLINE T triangle_id(std::int64_t number) {
    if constexpr (std::is_same_v<T, float>) {
        if (number > kFloatNumbers) {
            const std::int32_t bits = kFloatBits + static_cast<std::int32_t>(number);
            float id;
            std::memcpy(&id, &bits, sizeof id);
            return id;
        }
    }
    return static_cast<T>(number);
}

// The index of the triangle, or -1 where the pixel is empty. What is no number (NaN is not) clears `valid` and counts
// as empty; `last` is the id of the last triangle.
template <class T>
MIPBAKE_INLINE std::int32_t triangle_of(T id, T last, bool& valid) {
    const bool good = id >= T(0) && id <= last;
    valid = valid && good;
    if (!good) return -1;
    if constexpr (std::is_same_v<T, float>) {
        if (id > static_cast<float>(kFloatNumbers)) {
            std::int32_t bits;
            std::memcpy(&bits, &id, sizeof bits);
            return bits - kFloatBits - 1;
        }
    }
    return static_cast<std::int32_t>(id) - 1;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
