// Dual numbers: a value with its derivatives by N inputs (forward mode). T is a scalar or a packet; the derivatives may
// have a narrower type D, since no cancellation that the value's width guards against happens among them.
#pragma once

#include <type_traits>

#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class T, int N, class D = T>
struct Dual {
    T v;
    D d[N];

    Dual() = default;
    // A constant.
    MIPBAKE_INLINE Dual(double value) : v(static_cast<T>(value)) {
        for (D& partial : d) partial = D(0);
    }
    // The input `index`: its derivative by itself is 1.
    static MIPBAKE_INLINE Dual input(const T& value, int index) {
        Dual out(0.0);
        out.v = value;
        out.d[index] = D(1);
        return out;
    }
};

namespace dual {
template <class S>
using IfNumber = std::enable_if_t<std::is_arithmetic_v<S>, int>;

// `value`, with every derivative of a times s (plus every derivative of b times t).
template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> chain(const T& value, const Dual<T, N, D>& a, const D& s) {
    Dual<T, N, D> out;
    out.v = value;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] * s;
    return out;
}
template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> chain(const T& value, const Dual<T, N, D>& a, const D& s, const Dual<T, N, D>& b,
                                   const D& t) {
    Dual<T, N, D> out;
    out.v = value;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] * s + b.d[i] * t;
    return out;
}
}  // namespace dual

template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> operator+(const Dual<T, N, D>& a, const Dual<T, N, D>& b) {
    Dual<T, N, D> out;
    out.v = a.v + b.v;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] + b.d[i];
    return out;
}
template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> operator-(const Dual<T, N, D>& a, const Dual<T, N, D>& b) {
    Dual<T, N, D> out;
    out.v = a.v - b.v;
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] - b.d[i];
    return out;
}
template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> operator-(const Dual<T, N, D>& a) {
    return dual::chain(-a.v, a, D(-1));
}
template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> operator*(const Dual<T, N, D>& a, const Dual<T, N, D>& b) {
    return dual::chain(a.v * b.v, a, narrow<D>(b.v), b, narrow<D>(a.v));
}
template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> operator/(const Dual<T, N, D>& a, const Dual<T, N, D>& b) {
    const T inverse = T(1) / b.v, quotient = a.v * inverse;
    return dual::chain(quotient, a, narrow<D>(inverse), b, narrow<D>(-quotient * inverse));
}

template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator+(Dual<T, N, D> a, S s) {
    a.v = a.v + T(s);
    return a;
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator+(S s, const Dual<T, N, D>& a) {
    return a + s;
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator-(const Dual<T, N, D>& a, S s) {
    return a + (-s);
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator-(S s, const Dual<T, N, D>& a) {
    return dual::chain(T(s) - a.v, a, D(-1));
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator*(const Dual<T, N, D>& a, S s) {
    return dual::chain(a.v * T(s), a, D(s));
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator*(S s, const Dual<T, N, D>& a) {
    return a * s;
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator/(S s, const Dual<T, N, D>& a) {
    const T inverse = T(1) / a.v, quotient = T(s) * inverse;
    return dual::chain(quotient, a, narrow<D>(-quotient * inverse));
}

template <class T, int N, class D>
MIPBAKE_INLINE auto operator<(const Dual<T, N, D>& a, const Dual<T, N, D>& b) {
    return a.v < b.v;
}
template <class T, int N, class D>
MIPBAKE_INLINE auto operator>(const Dual<T, N, D>& a, const Dual<T, N, D>& b) {
    return a.v > b.v;
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE auto operator<(const Dual<T, N, D>& a, S s) {
    return a.v < T(s);
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE auto operator>(const Dual<T, N, D>& a, S s) {
    return a.v > T(s);
}
template <class T, int N, class D, class S, dual::IfNumber<S> = 0>
MIPBAKE_INLINE auto operator>=(const Dual<T, N, D>& a, S s) {
    return a.v >= T(s);
}

// With packets that are constants: the directions of each texel.
template <class T, int N, class D, std::enable_if_t<!std::is_arithmetic_v<T>, int> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator+(Dual<T, N, D> a, const T& s) {
    a.v = a.v + s;
    return a;
}
template <class T, int N, class D, std::enable_if_t<!std::is_arithmetic_v<T>, int> = 0>
MIPBAKE_INLINE Dual<T, N, D> operator*(const Dual<T, N, D>& a, const T& s) {
    return dual::chain(a.v * s, a, narrow<D>(s));
}

template <class C, class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> select(const C& condition, const Dual<T, N, D>& yes, const Dual<T, N, D>& no) {
    Dual<T, N, D> out;
    out.v = select(condition, yes.v, no.v);
    const auto narrow_condition = narrow_mask<D>(condition);
    for (int i = 0; i < N; ++i) out.d[i] = select(narrow_condition, yes.d[i], no.d[i]);
    return out;
}

template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> square_root(const Dual<T, N, D>& a) {
    const T root = square_root(a.v);
    return dual::chain(root, a, narrow<D>(T(0.5) / root));
}
template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> exponential(const Dual<T, N, D>& a) {
    const T value = exponential(a.v);
    return dual::chain(value, a, narrow<D>(value));
}

template <class T, int N, class D>
MIPBAKE_INLINE Dual<T, N, D> logarithm(const Dual<T, N, D>& a) {
    return dual::chain(logarithm(a.v), a, narrow<D>(T(1) / a.v));
}

template <class T, int N, class D>
struct PlainOf<Dual<T, N, D>> {
    using type = typename PlainOf<T>::type;
};
namespace dual {
template <class T>
struct ValueOf;
template <class T, int N, class D>
struct ValueOf<Dual<T, N, D>> {
    using type = T;
};
}  // namespace dual
template <class T, class W, int N, class D>
MIPBAKE_INLINE Dual<W, N, D> exponential_for(const Dual<W, N, D>& a) {
    const W value = exponential_for<typename dual::ValueOf<T>::type>(a.v);
    return dual::chain(value, a, narrow<D>(value));
}
template <class T, class W, int N, class D>
MIPBAKE_INLINE Dual<W, N, D> logarithm_for(const Dual<W, N, D>& a) {
    return dual::chain(logarithm_for<typename dual::ValueOf<T>::type>(a.v), a, narrow<D>(W(1) / a.v));
}
template <class T, class W, int N, class D>
MIPBAKE_INLINE T narrow_exponential(const Dual<W, N, D>& a) {
    T out;
    out.v = narrow_exponential<typename dual::ValueOf<T>::type>(a.v);
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i] * narrow<D>(out.v);
    return out;
}

template <class T, int N, class D>
struct Narrow<Dual<T, N, D>> {
    template <class W>
    static MIPBAKE_INLINE Dual<T, N, D> from(const Dual<W, N, D>& wide) {
        Dual<T, N, D> out;
        out.v = narrow<T>(wide.v);
        for (int i = 0; i < N; ++i) out.d[i] = wide.d[i];
        return out;
    }
};

// The way back from narrow: a dual number of the wide type.
template <class Wide, class T, int N, class D>
MIPBAKE_INLINE Wide widen(const Dual<T, N, D>& a) {
    Wide out;
    out.v = widen<typename dual::ValueOf<Wide>::type>(a.v);
    for (int i = 0; i < N; ++i) out.d[i] = a.d[i];
    return out;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
