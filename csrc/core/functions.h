// Functions of float numbers and packets that networks need beside those of real.h, accurate to a few units in the last
// place of the larger of the result and 1.
#pragma once

#include "core/packet.h"
#include "core/packet_series.h"
#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

#ifdef MIPBAKE_VECTORS
// ln x of positive normal numbers: k ln 2 + 2 artanh f, f = (m - 1) / (m + 1), with x = 2^k m and m from sqrt(1/2) on.
template <int N>
MIPBAKE_INLINE Packet<float, N> natural_logarithm(const Packet<float, N>& x) {
    using V = typename Packet<float, N>::V;
    using I = typename Register<std::int32_t>::type;
    constexpr std::int32_t half_root = 0x3f3504f3;  // sqrt(1/2)
    Packet<float, N> out;
    for (int i = 0; i < x.registers; ++i) {
        I bits;
        std::memcpy(&bits, &x.r[i], sizeof bits);
        const I k = (bits - half_root) >> 23;
        bits -= k << 23;
        V m;
        std::memcpy(&m, &bits, sizeof m);
        const V exponent = __builtin_convertvector(k, V);
        const V f = (m - 1.0f) / (m + 1.0f), f2 = f * f;
        const V sum = (((f2 * (2.0f / 9) + 2.0f / 7) * f2 + 2.0f / 5) * f2 + 2.0f / 3) * f2;
        out.r[i] = exponent * 0.693359375f + (exponent * -2.12194440e-4f + (f * 2.0f + f * sum));
    }
    return out;
}
#endif
MIPBAKE_INLINE float natural_logarithm(float x) { return logf(x); }

template <class T>
MIPBAKE_INLINE T magnitude(const T& x) {
    return larger(x, -x);
}

// e^x, at most e^80 and at least e^-80.
template <class T>
MIPBAKE_INLINE T bounded_exponential(const T& x) {
    return exponential(clamp(x, -80.0, 80.0));
}

template <class T>
MIPBAKE_INLINE T hyperbolic_tangent(const T& x) {
    const T e = exponential(clamp(x, -20.0, 20.0) * T(2.0f));
    return (e - T(1.0f)) / (e + T(1.0f));
}

template <class T>
MIPBAKE_INLINE T area_hyperbolic_sine(const T& x) {
    const T size = magnitude(x);
    const T found = natural_logarithm(size + square_root(size * size + T(1.0f)));
    return select(x < T(0.0f), -found, found);
}

// artanh x for |x| < 1.
template <class T>
MIPBAKE_INLINE T area_hyperbolic_tangent(const T& x) {
    return natural_logarithm((T(1.0f) + x) / (T(1.0f) - x)) * T(0.5f);
}

// ln(1 + x) for x of at least 0, without loss where x is small.
template <class T>
MIPBAKE_INLINE T logarithm_of_one_plus(const T& x) {
    const T sum = T(1.0f) + x, kept = sum - T(1.0f);
    const T found = natural_logarithm(sum) * x / larger(kept, T(1e-30f));
    return select(kept > T(0.0f), found, x);
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
