// Random signs by a counter: a hash of which parameter, which step and which seed. Nothing is stored, and the same
// question has the same answer in every kernel, on every processor.
#pragma once

#include <cstdint>

#include "core/platform.h"
#include "ops/stochastic.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Permuted congruential generator of three numbers, one of them out: `pcg3d` of Jarzynski and Olano 2020, "Hash
// Functions for GPU Rendering".
MIPBAKE_INLINE std::uint32_t hash_of(std::uint32_t x, std::uint32_t y, std::uint32_t z) {
    x = x * 1664525u + 1013904223u;
    y = y * 1664525u + 1013904223u;
    z = z * 1664525u + 1013904223u;
    x += y * z;
    y += z * x;
    z += x * y;
    x ^= x >> 16;
    y ^= y >> 16;
    z ^= z >> 16;
    return x + y * z;
}

// -1 or 1, by the uppermost bit.
template <class T>
MIPBAKE_INLINE T sign_of(std::uint32_t parameter, const SignKey& key) {
    return hash_of(parameter, key.step, key.seed) >> 31 ? T(1) : T(-1);
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
