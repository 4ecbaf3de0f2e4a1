// The footprint of a pixel in a texture: an ellipse, the image of the pixel's disc under the Jacobian of the texture
// coordinates. Its axes are the singular values and vectors of that matrix; the level of detail is the binary logarithm
// of the major one in texels of level 0. (Heckbert 1989, "Fundamentals of texture mapping and image warping",
// chapter 3.)
#pragma once

#include "core/real.h"
#include "sampling/coordinates.h"
#include "sampling/storage.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

constexpr int max_taps = 16;  // of anisotropic filtering

// log2 of x >= 0, to about 1 unit in the last place, in operations that vectorise: x = 2^e m with m in [2^-1/2, 2^1/2),
// log2(m) = 2 / ln 2 * atanh(t), t = (m - 1) / (m + 1). Infinity and NaN pass; 0 gives -infinity.
template <class T, class Bits, class Signed, int mantissa, int terms>
MIPBAKE_INLINE T log2_with(T x) {
    const bool tiny = x < T(sizeof(T) == 4 ? 0x1p-100 : 0x1p-1000);  // subnormal numbers among them
    const T scaled = tiny ? x * T(sizeof(T) == 4 ? 0x1p100 : 0x1p1000) : x;
    Bits bits;
    std::memcpy(&bits, &scaled, sizeof bits);
    // The bits of sqrt(1/2): subtracting them leaves the exponent e in the upper bits.
    const Bits half_root = sizeof(T) == 4 ? Bits(0x3f3504f3u) : Bits(0x3fe6a09e667f3bcdull);
    const Signed exponent = static_cast<Signed>(bits - half_root) >> mantissa;
    const Bits fraction = bits - (static_cast<Bits>(exponent) << mantissa);
    T m;
    std::memcpy(&m, &fraction, sizeof m);
    const T t = (m - 1) / (m + 1), square = t * t;
    T series = T(1) / T(2 * terms + 1);
    for (int k = terms - 1; k >= 0; --k) series = series * square + T(1) / T(2 * k + 1);
    T result = static_cast<T>(static_cast<int>(exponent)) - (tiny ? T(sizeof(T) == 4 ? 100 : 1000) : T(0)) +
               T(2.885390081777926814719849362) * t * series;
    result = x > 0 ? result : (x == 0 ? -T(HUGE_VALF) : x);
    return x < T(HUGE_VALF) ? result : x;
}
MIPBAKE_INLINE float log2_of(float x) { return log2_with<float, std::uint32_t, std::int32_t, 23, 4>(x); }
MIPBAKE_INLINE double log2_of(double x) { return log2_with<double, std::uint64_t, std::int64_t, 52, 10>(x); }

// Texels of level 0 by pixels: d(s, t) / d(X, Y), rows s = (sx, sy) and t = (tx, ty).
template <class T>
struct Jacobian {
    T sx, sy, tx, ty;
};

// J J^T = (p r; r q) has the eigenvalues mean +- root, the squares of the singular values.
template <class T>
struct Ellipse {
    T difference;  // (p - q) / 2
    T r, root;
    T major_square;
};

template <class T>
MIPBAKE_INLINE Ellipse<T> ellipse_of(const Jacobian<T>& j) {
    const T p = j.sx * j.sx + j.sy * j.sy, q = j.tx * j.tx + j.ty * j.ty;
    Ellipse<T> e;
    e.difference = T(0.5) * p - T(0.5) * q;
    e.r = j.sx * j.tx + j.sy * j.ty;
    e.root = square_root(e.difference * e.difference + e.r * e.r);
    const T mean = T(0.5) * p + T(0.5) * q, sum = mean + e.root;
    e.major_square = mean < T(HUGE_VALF) ? sum : mean;  // infinite derivatives: not the NaN of inf - inf
    return e;
}

// Binary logarithm of the major axis.
template <class T>
MIPBAKE_INLINE T lod_of(const Ellipse<T>& e) {
    return T(0.5) * log2_of(e.major_square);
}

// The gradient by J of g times a function of J J^T whose gradient by (p, q, r) is (gp, gq, gr).
template <class T>
MIPBAKE_INLINE Jacobian<T> gram_adjoint(const Jacobian<T>& j, T gp, T gq, T gr) {
    return {2 * gp * j.sx + gr * j.tx, 2 * gp * j.sy + gr * j.ty, 2 * gq * j.tx + gr * j.sx, 2 * gq * j.ty + gr * j.sy};
}

// Adjoint of lod_of. A circle has no major direction; its two are then taken alike. Zero where lod is infinite.
template <class T>
MIPBAKE_INLINE Jacobian<T> lod_adjoint(const Jacobian<T>& j, const Ellipse<T>& e, T g) {
    const bool regular = e.major_square > 0 && e.major_square < T(HUGE_VALF);
    const T scale =
        regular ? g * T(0.72134752044448170367996234050095) / e.major_square : T(0);  // g / (2 ln 2 major^2)
    const bool circle = !(e.root > 0);
    const T inverse = T(1) / (circle ? T(1) : e.root);
    const T cosine = circle ? T(0) : e.difference * inverse, sine = circle ? T(0) : e.r * inverse;
    const T half = T(0.5) * scale;
    const Jacobian<T> out = gram_adjoint(j, half + half * cosine, half - half * cosine, scale * sine);
    return regular ? out : Jacobian<T>{0, 0, 0, 0};
}

// Lookups along the major axis: `count` of them, at ((k + 1/2) / count - 1/2) * axis from the centre.
template <class T>
struct AxisTaps {
    int count;
    T s, t;  // the axis, in texels of level 0
    T lod;   // of the major axis divided by the count
};

// Rounding leaves a circle's axes equal to within some 10^-7 of them; that must not double its taps.
template <class T>
MIPBAKE_INLINE AxisTaps<T> axis_taps(const Jacobian<T>& j, const Ellipse<T>& e) {
    AxisTaps<T> taps;
    const bool regular = e.major_square > 0 && e.major_square < T(HUGE_VALF);
    T area = j.sx * j.ty - j.sy * j.tx;  // major times minor axis
    area = area < 0 ? -area : area;
    const bool thin = !(area * T(max_taps) > e.major_square);
    const T ratio = thin ? T(max_taps) : e.major_square / (thin ? T(1) : area);
    const T rounded = ratio - T(0x1p-10);
    const int whole = static_cast<int>(rounded);
    const int count = whole + (static_cast<T>(whole) < rounded ? 1 : 0);
    taps.count = !regular || count < 1 ? 1 : count > max_taps ? max_taps : count;
    // The eigenvector from the row of J J^T - minor^2 that is the longer one.
    const bool along_s = e.difference >= 0;
    const T s = along_s ? e.difference + e.root : e.r, t = along_s ? e.r : e.root - e.difference;
    const T length = square_root(s * s + t * t);
    const T scale = regular && length > 0 && length < T(HUGE_VALF) ? square_root(e.major_square) / length : T(0);
    taps.s = scale > 0 ? s * scale : T(0);
    taps.t = scale > 0 ? t * scale : T(0);
    taps.lod = T(0.5) * log2_of(e.major_square) - log2_of(static_cast<T>(taps.count));
    return taps;
}

// Adjoint of axis_taps at a fixed count: the gradient by J from the gradients by the axis and by lod. With the
// eigenvectors e (major) and f of M = J J^T, d major^2 = e . dM e and de = f (f . dM e) / (major^2 - minor^2).
template <class T>
MIPBAKE_INLINE Jacobian<T> axis_adjoint(const Jacobian<T>& j, const Ellipse<T>& e, T gs, T gt, T glod) {
    const Jacobian<T> from_lod = lod_adjoint(j, e, glod);
    if (!(e.root > 0) || !(e.major_square < T(HUGE_VALF))) return from_lod;
    const bool along_s = e.difference >= 0;
    T s = along_s ? e.difference + e.root : e.r, t = along_s ? e.r : e.root - e.difference;
    const T length = square_root(s * s + t * t), major = square_root(e.major_square);
    if (!(length > 0) || !(length < T(HUGE_VALF))) return from_lod;
    s /= length;
    t /= length;
    const T along = (gs * s + gt * t) / (2 * major);            // by major^2
    const T across = major * (gt * s - gs * t) / (2 * e.root);  // by f . dM e, f = (-t, s)
    const Jacobian<T> from_axis = gram_adjoint(j, along * s * s - across * s * t, along * t * t + across * s * t,
                                               2 * along * s * t + across * (s * s - t * t));
    return {from_lod.sx + from_axis.sx, from_lod.sy + from_axis.sy, from_lod.tx + from_axis.tx,
            from_lod.ty + from_axis.ty};
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
