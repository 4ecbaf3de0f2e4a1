// The few functions that kernels need of a scalar type. packet.h and dual.h provide the same functions for their types,
// so that one template serves a float on a GPU, a packet of texels on a CPU and a dual number that carries derivatives.
#pragma once

#include <cmath>
#include <type_traits>

#include "core/platform.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

MIPBAKE_INLINE float square_root(float x) { return sqrtf(x); }
MIPBAKE_INLINE double square_root(double x) { return ::sqrt(x); }
MIPBAKE_INLINE float exponential(float x) { return expf(x); }
MIPBAKE_INLINE double exponential(double x) { return ::exp(x); }
MIPBAKE_INLINE double logarithm(double x) { return ::log(x); }

template <class T, std::enable_if_t<std::is_arithmetic_v<T>, int> = 0>
MIPBAKE_INLINE T select(bool condition, const T& yes, const T& no) {
    return condition ? yes : no;
}
MIPBAKE_INLINE bool both(bool a, bool b) { return a && b; }

// narrow<T>(x): from the wide type that geometry is computed in to the type of the rest. See shading/ggx_lobe.h.
template <class T>
struct Narrow {
    template <class W>
    static MIPBAKE_INLINE T from(const W& wide) {
        return static_cast<T>(wide);
    }
};
template <class T, class W>
MIPBAKE_INLINE T narrow(const W& wide) {
    return Narrow<T>::from(wide);
}

// widen<W>(x): the way back. packet.h has it for packets.
template <class W, class T, std::enable_if_t<std::is_arithmetic_v<T>, int> = 0>
MIPBAKE_INLINE W widen(T x) {
    return static_cast<W>(x);
}

// e^x and ln x of the wide type, as accurate as results of type T need; and e^x in T. packet_series.h spends less on
// float.
template <class T>
MIPBAKE_INLINE double exponential_for(double x) {
    return exponential(x);
}
template <class T>
MIPBAKE_INLINE double logarithm_for(double x) {
    return logarithm(x);
}
template <class T>
MIPBAKE_INLINE T narrow_exponential(double x) {
    return static_cast<T>(exponential(x));
}

// The plain number of the precision of T: what a packet holds, what a dual number is about.
template <class T>
struct PlainOf {
    using type = T;
};

// A mask of the wide type as one of the narrow type T.
template <class T>
MIPBAKE_INLINE bool narrow_mask(bool mask) {
    return mask;
}

template <class T>
MIPBAKE_INLINE T larger(const T& a, const T& b) {
    return select(a > b, a, b);
}
template <class T>
MIPBAKE_INLINE T smaller(const T& a, const T& b) {
    return select(a < b, a, b);
}
// x held to [low, high]; its derivative is 1 up to and at the limits, and 0 beyond.
template <class T>
MIPBAKE_INLINE T clamp(const T& x, double low, double high) {
    return select(x > high, T(high), select(x < low, T(low), x));
}
template <class T>
MIPBAKE_INLINE T square(const T& x) {
    return x * x;
}

template <class T>
struct Vec3 {
    T x, y, z;
};

// Calls f(a_i, b_i) on the components of two vectors.
template <class A, class B, class F>
MIPBAKE_INLINE void zip_vector(A& a, B& b, F& f) {
    f(a.x, b.x);
    f(a.y, b.y);
    f(a.z, b.z);
}

// The product with a vector of plain numbers, or of the same type.
template <class T, class S>
MIPBAKE_INLINE T dot(const Vec3<T>& a, const Vec3<S>& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class T>
MIPBAKE_INLINE Vec3<T> operator+(const Vec3<T>& a, const Vec3<T>& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class T>
MIPBAKE_INLINE Vec3<T> operator-(const Vec3<T>& a, const Vec3<T>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T, class S>
MIPBAKE_INLINE Vec3<T> operator*(const Vec3<T>& a, const S& s) {
    return {a.x * s, a.y * s, a.z * s};
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
