// Bilinear and trilinear interpolation of texels with C channels, and their adjoints.
//
// Interpolation is a + f (b - a) throughout: equal texels give exactly that value, and f = 0 gives exactly a.
#pragma once

#include "sampling/coordinates.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// The four texels of a bilinear lookup, named (row, column), and its fractions (x along a row, y across rows).
template <class T>
struct Quad {
    const T *t00, *t01, *t10, *t11;
    T x, y;
};

template <class T>
MIPBAKE_INLINE T lerp(T a, T b, T f) {
    return a + f * (b - a);
}

template <class T>
MIPBAKE_INLINE T bilinear(const Quad<T>& q, int c) {
    return lerp(lerp(q.t00[c], q.t01[c], q.x), lerp(q.t10[c], q.t11[c], q.x), q.y);
}

// C is the number of channels, or 0 where only `channels` knows it.
template <int C, class T>
MIPBAKE_INLINE void sample_level(const Quad<T>& q, int channels, T* __restrict out) {
    const int n = C > 0 ? C : channels;
    for (int c = 0; c < n; ++c) out[c] = bilinear(q, c);
}

template <int C, class T>
MIPBAKE_INLINE void sample_levels(const Quad<T>& finer, const Quad<T>& coarser, T blend, int channels,
                                  T* __restrict out) {
    const int n = C > 0 ? C : channels;
    for (int c = 0; c < n; ++c) out[c] = lerp(bilinear(finer, c), bilinear(coarser, c), blend);
}

// Adjoint in the fractions: d/dx and d/dy of dot(grad, bilinear), and dot(grad, bilinear) itself, which the adjoint in
// the level of detail subtracts between levels.
template <class T>
struct QuadSlopes {
    T x, y, value;
};

template <int C, class T>
MIPBAKE_INLINE QuadSlopes<T> quad_slopes(const Quad<T>& q, int channels, const T* grad) {
    const int n = C > 0 ? C : channels;
    QuadSlopes<T> s = {0, 0, 0};
    for (int c = 0; c < n; ++c) {
        const T top = lerp(q.t00[c], q.t01[c], q.x), bottom = lerp(q.t10[c], q.t11[c], q.x);
        s.x += grad[c] * lerp(q.t01[c] - q.t00[c], q.t11[c] - q.t10[c], q.y);
        s.y += grad[c] * (bottom - top);
        s.value += grad[c] * lerp(top, bottom, q.y);
    }
    return s;
}

// Adjoint in the texels: adds weight * grad to one texel's gradient.
template <int C, class T>
MIPBAKE_INLINE void add_texel(T* __restrict texel, T weight, int channels, const T* __restrict grad) {
    const int n = C > 0 ? C : channels;
    for (int c = 0; c < n; ++c) texel[c] += weight * grad[c];
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
