// Bilinear and trilinear interpolation of texels with C channels, and their adjoints.
//
// Interpolation is a + f (b - a) throughout: equal texels give exactly that value, and f = 0 gives exactly a.
#pragma once

#include "sampling/storage.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class T>
MIPBAKE_INLINE T lerp(T a, T b, T f) {
    return a + f * (b - a);
}

// The four texels of a bilinear lookup (left and right of the upper row, left and right of the lower one) and its
// fractions (x along a row, y across rows).
template <class S>
struct PlanarQuad {
    using Storage = S;
    using Real = Compute<S>;
    const S* texels[4];
    Real x, y;

    MIPBAKE_INLINE Real at(int k, int c) const { return value_of(texels[k][c]); }
};

// At the corner of a cube only three texels meet; the fourth, number `missing` (or -1), is their mean. On a GPU a texel
// outside of a texture that is surrounded by zeros is a null pointer.
template <class S>
struct GeneralQuad {
    using Storage = S;
    using Real = Compute<S>;
    const S* texels[4];
    Real x, y;
    int missing;

    MIPBAKE_INLINE Real stored(int k, int c) const {
        return texels[k] == nullptr ? Real(0) : static_cast<Real>(value_of(texels[k][c]));
    }
    MIPBAKE_INLINE Real at(int k, int c) const {
        if (k != missing) return stored(k, c);
        const Real a = stored((k + 1) & 3, c), b = stored((k + 2) & 3, c), d = stored((k + 3) & 3, c);
        return a + ((b - a) + (d - a)) * Real(1.0 / 3.0);
    }
};

template <class Q>
MIPBAKE_INLINE typename Q::Real bilinear(const Q& q, int c) {
    return lerp(lerp(q.at(0, c), q.at(1, c), q.x), lerp(q.at(2, c), q.at(3, c), q.x), q.y);
}

// Adjoint in the fractions: d/dx and d/dy of dot(grad, bilinear), and dot(grad, bilinear) itself, which the adjoint in
// the level of detail subtracts between levels. C is the number of channels, or 0 where only `channels` knows it.
template <class T>
struct QuadSlopes {
    T x, y, value;
};

template <int C, class Q>
MIPBAKE_INLINE QuadSlopes<typename Q::Real> quad_slopes(const Q& q, int channels, const typename Q::Real* grad) {
    using T = typename Q::Real;
    const int n = C > 0 ? C : channels;
    QuadSlopes<T> s = {0, 0, 0};
    for (int c = 0; c < n; ++c) {
        const T t00 = q.at(0, c), t01 = q.at(1, c), t10 = q.at(2, c), t11 = q.at(3, c);
        const T top = lerp(t00, t01, q.x), bottom = lerp(t10, t11, q.x);
        s.x += grad[c] * lerp(t01 - t00, t11 - t10, q.y);
        s.y += grad[c] * (bottom - top);
        s.value += grad[c] * lerp(top, bottom, q.y);
    }
    return s;
}

// The weights of the four texels, with the share of a missing one given to the others.
template <class T>
MIPBAKE_INLINE void quad_weights(T x, T y, T weight, int missing, T* weights) {
    weights[0] = weight * (1 - y) * (1 - x);
    weights[1] = weight * (1 - y) * x;
    weights[2] = weight * y * (1 - x);
    weights[3] = weight * y * x;
    if (missing < 0) return;
    const T share = weights[missing] * T(1.0 / 3.0);
    for (int k = 0; k < 4; ++k) weights[k] = k == missing ? T(0) : weights[k] + share;
}

// Adjoint in the texels: adds weight * grad to one texel's gradient. All sums are formed before one is stored, which
// lets a compiler vectorise them without knowing that the two do not overlap.
template <int C, class T>
MIPBAKE_INLINE void add_texel(T* texel, T weight, int channels, const T* grad) {
    if (C > 0) {
        T sums[C > 0 ? C : 1];
        for (int c = 0; c < C; ++c) sums[c] = texel[c] + weight * grad[c];
        for (int c = 0; c < C; ++c) texel[c] = sums[c];
    } else {
        for (int c = 0; c < channels; ++c) texel[c] += weight * grad[c];
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
