// e^x and ln x of packets, by their series.
#pragma once

#include <cstdint>
#include <cstring>
#include <type_traits>

#include "core/packet.h"

#ifdef MIPBAKE_VECTORS
namespace mipbake {
inline namespace MIPBAKE_ISA {

namespace series {
// 1 / n!: the Taylor series of e^r.
constexpr double inverse_factorial[] = {
    1.0,        1.0,         0.5,          1.0 / 6,       1.0 / 24,       1.0 / 120,       1.0 / 720,
    1.0 / 5040, 1.0 / 40320, 1.0 / 362880, 1.0 / 3628800, 1.0 / 39916800, 1.0 / 479001600, 1.0 / 6227020800.0};

// Taylor's polynomial of e^r.
template <int degree, class V>
MIPBAKE_INLINE V exponential(const V& r) {
    using T = std::decay_t<decltype(r[0])>;
    V sum = r * T(inverse_factorial[degree]) + T(inverse_factorial[degree - 1]);
    for (int j = degree - 2; j >= 0; --j) sum = sum * r + T(inverse_factorial[j]);
    return sum;
}

// A number that, added, rounds to an integer, kept in the low bits.
template <class T>
constexpr T kRounding = sizeof(T) == 8 ? T(6755399441055744.0) : T(12582912.0);  // 1.5 * 2^52, 1.5 * 2^23

// 2^k from k + kRounding.
template <class V>
MIPBAKE_INLINE V power_of_two(const V& shifted) {
    using T = std::decay_t<decltype(shifted[0])>;
    using I = typename Register<typename IntegerOf<T>::type>::type;
    I bits;
    std::memcpy(&bits, &shifted, sizeof bits);
    bits = (bits + (sizeof(T) == 8 ? 1023 : 127)) << (sizeof(T) == 8 ? 52 : 23);
    V out;
    std::memcpy(&out, &bits, sizeof out);
    return out;
}

// x = k ln 2 + rest.
struct Reduced {
    using V = Register<double>::type;
    V shifted, rest;  // k + kRounding
    static MIPBAKE_INLINE Reduced of(const V& x) {
        Reduced out;
        out.shifted = x * 1.4426950408889634 + kRounding<double>;
        const V k = out.shifted - kRounding<double>;
        out.rest = (x - k * 0.693147180369123816490) - k * 1.90821492927058770002e-10;
        return out;
    }
};

template <int degree, int N>
MIPBAKE_INLINE Packet<double, N> exponential_to(const Packet<double, N>& x) {
    Packet<double, N> out;
    for (int i = 0; i < x.registers; ++i) {
        const Reduced r = Reduced::of(x.r[i]);
        out.r[i] = exponential<degree>(r.rest) * power_of_two(r.shifted);
    }
    return out;
}

// ln x = k ln 2 + 2 artanh f, f = (m - 1) / (m + 1), with x = 2^k m and m from sqrt(1/2) to sqrt(2): |f| < 0.1716.
template <int terms, int N>
MIPBAKE_INLINE Packet<double, N> logarithm_to(const Packet<double, N>& x) {
    using V = typename Packet<double, N>::V;
    using U = typename Register<std::uint64_t>::type;
    constexpr std::uint64_t half_root = 0x3fe6a09e667f3bcdu;  // sqrt(1/2)
    Packet<double, N> out;
    for (int i = 0; i < x.registers; ++i) {
        U bits, mantissa, exponent;
        std::memcpy(&bits, &x.r[i], sizeof bits);
        exponent = (bits + (0x3ff0000000000000u - half_root)) >> 52;  // k + 1023
        mantissa = bits - ((exponent - 1023u) << 52);
        exponent |= 0x4330000000000000u;  // as the low bits of 2^52
        V m, k;
        std::memcpy(&m, &mantissa, sizeof m);
        std::memcpy(&k, &exponent, sizeof k);
        k -= 4503599627370496.0 + 1023;
        const V f = (m - 1.0) / (m + 1.0), f2 = f * f;
        V sum = f2 * (2.0 / (2 * terms + 1)) + 2.0 / (2 * terms - 1);
        for (int j = terms - 2; j >= 1; --j) sum = sum * f2 + 2.0 / (2 * j + 1);
        // f (2 + f2 sum), the small terms first.
        out.r[i] = k * 0.693147180369123816490 + (k * 1.90821492927058770002e-10 + (f * 2.0 + f * f2 * sum));
    }
    return out;
}
}  // namespace series

// e^x for |x| <= 700, to 1 unit in the last place.
template <int N>
MIPBAKE_FUNCTION Packet<double, N> exponential(const Packet<double, N>& x) {
    return series::exponential_to<13>(x);
}
// e^x for |x| <= 87, to 2 units in the last place.
template <int N>
MIPBAKE_INLINE Packet<float, N> exponential(const Packet<float, N>& x) {
    Packet<float, N> out;
    for (int i = 0; i < x.registers; ++i) {
        const auto shifted = x.r[i] * 1.44269504f + series::kRounding<float>;
        const auto k = shifted - series::kRounding<float>;
        const auto rest = (x.r[i] - k * 0.693359375f) - k * -2.12194440e-4f;
        out.r[i] = series::exponential<7>(rest) * series::power_of_two(shifted);
    }
    return out;
}
// ln x of positive normal numbers, to 2 units in the last place of the larger of ln x and 1.
template <int N>
MIPBAKE_FUNCTION Packet<double, N> logarithm(const Packet<double, N>& x) {
    return series::logarithm_to<11>(x);
}

// The same, within 1e-11 where results in float are all that is wanted: relatively, or of 1 where that is larger.
template <class T, int N>
MIPBAKE_INLINE Packet<double, N> exponential_for(const Packet<double, N>& x) {
    if constexpr (std::is_same_v<typename T::Scalar, float>) {
        return series::exponential_to<9>(x);
    } else {
        return exponential(x);
    }
}
template <class T, int N>
MIPBAKE_INLINE Packet<double, N> logarithm_for(const Packet<double, N>& x) {
    if constexpr (std::is_same_v<typename T::Scalar, float>) {
        return series::logarithm_to<6>(x);
    } else {
        return logarithm(x);
    }
}
// e^x in T for |x| <= 87 in float: the remainder of ln 2 is found in double, so that a large x costs no digits.
template <class T, int N>
MIPBAKE_INLINE T narrow_exponential(const Packet<double, N>& x) {
    if constexpr (std::is_same_v<typename T::Scalar, float>) {
        Packet<double, N> rest, k;
        for (int i = 0; i < x.registers; ++i) {
            const series::Reduced r = series::Reduced::of(x.r[i]);
            rest.r[i] = r.rest;
            k.r[i] = r.shifted - series::kRounding<double>;
        }
        const T r = narrow<T>(rest), power = narrow<T>(k);
        T out;
        for (int i = 0; i < out.registers; ++i)
            out.r[i] = series::exponential<7>(r.r[i]) * series::power_of_two(power.r[i] + series::kRounding<float>);
        return out;
    } else {
        return exponential(x);
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
#endif
