// Attributes at one pixel from those of its triangle's vertices, and the adjoint. Laine et al. 2020, section 3.4.
//
// Channels C is a constant, or 0 where `channels` says how many there are.
#pragma once

#include "core/platform.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// The attributes of the three vertices.
template <class T>
struct Corners {
    const T *a0, *a1, *a2;
};

// Eq. 3 in the form A_2 + u (A_0 - A_2) + v (A_1 - A_2), which keeps equal attributes exactly.
template <int C, class T>
MIPBAKE_INLINE void interpolate_values(const Corners<T>& a, T u, T v, int channels, T* out) {
    const int n = C > 0 ? C : channels;
    for (int c = 0; c < n; ++c) out[c] = a.a2[c] + u * (a.a0[c] - a.a2[c]) + v * (a.a1[c] - a.a2[c]);
}

// dA/dX and dA/dY of `count` listed channels from db = (du/dX, du/dY, dv/dX, dv/dY).
template <class T>
MIPBAKE_INLINE void interpolate_derivatives(const Corners<T>& a, const T* db, const int* listed, int count, T* out) {
    for (int k = 0; k < count; ++k) {
        const int c = listed[k];
        const T by_u = a.a0[c] - a.a2[c], by_v = a.a1[c] - a.a2[c];
        out[2 * k] = by_u * db[0] + by_v * db[2];
        out[2 * k + 1] = by_u * db[1] + by_v * db[3];
    }
}

// Eq. 4: the gradient of (u, v).
template <int C, class T>
MIPBAKE_INLINE void barycentric_gradient(const Corners<T>& a, int channels, const T* grad, T* grad_u, T* grad_v) {
    const int n = C > 0 ? C : channels;
    T by_u = 0, by_v = 0;
    for (int c = 0; c < n; ++c) {
        by_u += (a.a0[c] - a.a2[c]) * grad[c];
        by_v += (a.a1[c] - a.a2[c]) * grad[c];
    }
    *grad_u = by_u;
    *grad_v = by_v;
}

// The gradient of db.
template <class T>
MIPBAKE_INLINE void derivative_gradient(const Corners<T>& a, const T* grad_da, const int* listed, int count,
                                        T* grad_db) {
    T sum[4] = {0, 0, 0, 0};
    for (int k = 0; k < count; ++k) {
        const int c = listed[k];
        const T by_u = a.a0[c] - a.a2[c], by_v = a.a1[c] - a.a2[c];
        sum[0] += by_u * grad_da[2 * k];
        sum[1] += by_u * grad_da[2 * k + 1];
        sum[2] += by_v * grad_da[2 * k];
        sum[3] += by_v * grad_da[2 * k + 1];
    }
    for (int i = 0; i < 4; ++i) grad_db[i] = sum[i];
}

// Calls add(vertex, channel, value) with what a pixel contributes to the gradients of its three vertices: {u, v, 1 - u
// - v} times the gradient of the value.
template <int C, class T, class Add>
MIPBAKE_INLINE void value_contributions(T u, T v, int channels, const T* grad, Add&& add) {
    const int n = C > 0 ? C : channels;
    const T w = 1 - u - v;
    for (int c = 0; c < n; ++c) add(0, c, u * grad[c]);
    for (int c = 0; c < n; ++c) add(1, c, v * grad[c]);
    for (int c = 0; c < n; ++c) add(2, c, w * grad[c]);
}

template <class T, class Add>
MIPBAKE_INLINE void derivative_contributions(const T* db, const T* grad_da, const int* listed, int count, Add&& add) {
    for (int k = 0; k < count; ++k) {
        const T first = db[0] * grad_da[2 * k] + db[1] * grad_da[2 * k + 1];
        const T second = db[2] * grad_da[2 * k] + db[3] * grad_da[2 * k + 1];
        add(0, listed[k], first);
        add(1, listed[k], second);
        add(2, listed[k], -(first + second));
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
