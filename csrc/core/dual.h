// Dual numbers: a value with its derivatives by N inputs (forward mode). T is a scalar or a packet.
#pragma once

#include <type_traits>

#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class T, int N>
struct Dual {
    T v;
    T d[N];

    Dual() = default;
    // A constant.
    MIPBAKE_INLINE Dual(double value) : v(static_cast<T>(value)) {
        for (T& partial : d) partial = T(0);
    }
    // The input `index`: its derivative by itself is 1.
    static MIPBAKE_FUNCTION Dual input(const T& value, int index) {
        Dual out(0.0);
        out.v = value;
        out.d[index] = T(1);
        return out;
    }
};

namespace dual {
// value, with every derivative of a times s.
template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> chain(const T& value, const Dual<T, N>& a, const T& s) {
    Dual<T, N> out;
    out.v = value;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] * s;
    return out;
}
template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> chain(const T& value, const Dual<T, N>& a, const T& s, const Dual<T, N>& b, const T& t) {
    Dual<T, N> out;
    out.v = value;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] * s + b.d[i] * t;
    return out;
}
template <class S>
using IfNumber = std::enable_if_t<std::is_arithmetic_v<S>, int>;
}  // namespace dual

template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> operator+(const Dual<T, N>& a, const Dual<T, N>& b) {
    Dual<T, N> out;
    out.v = a.v + b.v;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] + b.d[i];
    return out;
}
template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> operator-(const Dual<T, N>& a, const Dual<T, N>& b) {
    Dual<T, N> out;
    out.v = a.v - b.v;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] - b.d[i];
    return out;
}
template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> operator-(const Dual<T, N>& a) {
    return dual::chain(-a.v, a, T(-1));
}
template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> operator*(const Dual<T, N>& a, const Dual<T, N>& b) {
    return dual::chain(a.v * b.v, a, b.v, b, a.v);
}
template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> operator/(const Dual<T, N>& a, const Dual<T, N>& b) {
    const T inverse = T(1) / b.v, quotient = a.v * inverse;
    return dual::chain(quotient, a, inverse, b, -quotient * inverse);
}

template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION Dual<T, N> operator+(Dual<T, N> a, S s) {
    a.v = a.v + T(s);
    return a;
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION Dual<T, N> operator+(S s, const Dual<T, N>& a) {
    return a + s;
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION Dual<T, N> operator-(const Dual<T, N>& a, S s) {
    return a + (-s);
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION Dual<T, N> operator-(S s, const Dual<T, N>& a) {
    return dual::chain(T(s) - a.v, a, T(-1));
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION Dual<T, N> operator*(const Dual<T, N>& a, S s) {
    return dual::chain(a.v * T(s), a, T(s));
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION Dual<T, N> operator*(S s, const Dual<T, N>& a) {
    return a * s;
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION Dual<T, N> operator/(S s, const Dual<T, N>& a) {
    const T inverse = T(1) / a.v, quotient = T(s) * inverse;
    return dual::chain(quotient, a, -quotient * inverse);
}

template <class T, int N>
MIPBAKE_FUNCTION auto operator<(const Dual<T, N>& a, const Dual<T, N>& b) {
    return a.v < b.v;
}
template <class T, int N>
MIPBAKE_FUNCTION auto operator>(const Dual<T, N>& a, const Dual<T, N>& b) {
    return a.v > b.v;
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION auto operator<(const Dual<T, N>& a, S s) {
    return a.v < T(s);
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION auto operator>(const Dual<T, N>& a, S s) {
    return a.v > T(s);
}
template <class T, int N, class S, dual::IfNumber<S> = 0>
MIPBAKE_FUNCTION auto operator>=(const Dual<T, N>& a, S s) {
    return a.v >= T(s);
}

template <class C, class T, int N>
MIPBAKE_FUNCTION Dual<T, N> select(const C& condition, const Dual<T, N>& yes, const Dual<T, N>& no) {
    Dual<T, N> out;
    out.v = select(condition, yes.v, no.v);
    for (int i = 0; i < N; ++i) out.d[i] = select(condition, yes.d[i], no.d[i]);
    return out;
}

template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> square_root(const Dual<T, N>& a) {
    const T root = square_root(a.v);
    return dual::chain(root, a, T(0.5) / root);
}
template <class T, int N>
MIPBAKE_FUNCTION Dual<T, N> exponential(const Dual<T, N>& a) {
    const T value = exponential(a.v);
    return dual::chain(value, a, value);
}

template <class T, int N>
struct Narrow<Dual<T, N>> {
    template <class W>
    static MIPBAKE_FUNCTION Dual<T, N> from(const Dual<W, N>& wide) {
        Dual<T, N> out;
        out.v = narrow<T>(wide.v);
        for (int i = 0; i < N; ++i) out.d[i] = narrow<T>(wide.d[i]);
        return out;
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
