// The number types that texels are stored in, and the type that each is computed in. Half types are bit patterns here,
// so that the same code runs on every compiler and on a GPU.
#pragma once

#include <cstdint>
#include <cstring>

#include "core/platform.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct Float16 {  // IEEE 754 binary16
    std::uint16_t bits;
};
struct Bfloat16 {  // the upper half of a float
    std::uint16_t bits;
};

template <class S>
struct ComputeOf {
    using type = S;
};
template <>
struct ComputeOf<Float16> {
    using type = float;
};
template <>
struct ComputeOf<Bfloat16> {
    using type = float;
};
template <class S>
using Compute = typename ComputeOf<S>::type;

MIPBAKE_INLINE float float_of_bits(std::uint32_t bits) {
    float value;
    std::memcpy(&value, &bits, sizeof value);
    return value;
}
MIPBAKE_INLINE std::uint32_t bits_of_float(float value) {
    std::uint32_t bits;
    std::memcpy(&bits, &value, sizeof bits);
    return bits;
}

MIPBAKE_INLINE float value_of(float x) { return x; }
MIPBAKE_INLINE double value_of(double x) { return x; }
MIPBAKE_INLINE float value_of(Bfloat16 x) { return float_of_bits(std::uint32_t(x.bits) << 16); }
// Exact, without branches: normal numbers need another exponent bias, subnormal ones are rebuilt by a subtraction, and
// infinity and NaN keep an exponent of ones.
MIPBAKE_INLINE float value_of(Float16 x) {
    const std::uint32_t sign = std::uint32_t(x.bits & 0x8000u) << 16, rest = std::uint32_t(x.bits & 0x7fffu) << 13;
    const std::uint32_t exponent = rest & 0x0f800000u;
    const std::uint32_t normal = rest + (exponent == 0x0f800000u ? 0x70000000u : 0x38000000u);
    const float subnormal = float_of_bits(rest + 0x38800000u) - 0x1p-14f;
    return float_of_bits(sign | (exponent == 0 ? bits_of_float(subnormal) : normal));
}

// Rounds to the nearest, ties to even; beyond the largest number to infinity.
MIPBAKE_INLINE void store_value(float value, float* target) { *target = value; }
MIPBAKE_INLINE void store_value(double value, double* target) { *target = value; }
MIPBAKE_INLINE void store_value(float value, Bfloat16* target) {
    const std::uint32_t bits = bits_of_float(value);
    const std::uint32_t rounded = bits + 0x7fffu + ((bits >> 16) & 1u);
    target->bits = static_cast<std::uint16_t>((value == value ? rounded : bits | 0x00400000u) >> 16);
}
MIPBAKE_INLINE void store_value(float value, Float16* target) {
    const std::uint32_t bits = bits_of_float(value), sign = (bits >> 16) & 0x8000u, rest = bits & 0x7fffffffu;
    const std::uint32_t normal = (rest - 0x38000000u + 0xfffu + ((rest >> 13) & 1u)) >> 13;
    // Adding 1/2 leaves a subnormal result in the low bits, rounded by the addition.
    const std::uint32_t subnormal = bits_of_float(float_of_bits(rest) + 0.5f) - 0x3f000000u;
    std::uint32_t out = rest < 0x38800000u ? subnormal : normal;
    out = rest >= 0x477ff000u ? 0x7c00u : out;
    out = rest > 0x7f800000u ? 0x7e00u : out;
    target->bits = static_cast<std::uint16_t>(sign | out);
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
