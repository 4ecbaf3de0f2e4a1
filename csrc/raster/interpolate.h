// Attributes at one pixel from the attributes of its triangle's vertices, and the adjoint. Laine et al. 2020, section
// 3.4.
//
// C is the number of channels, or 0 where `channels` says it. K is the number of channels whose derivatives are wanted
// where these are the first K, or -1 where a list says which.
#pragma once

#include "core/platform.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// The attributes of the three vertices.
template <class T>
struct Corners {
    const T *a0, *a1, *a2;
};

struct Listed {
    const int* channels;
    int count;
};
template <int K>
MIPBAKE_INLINE int listed_count(const Listed& listed) {
    return K >= 0 ? K : listed.count;
}
template <int K>
MIPBAKE_INLINE int listed_channel(const Listed& listed, int k) {
    return K >= 0 ? k : listed.channels[k];
}

// Eq. 3 in the form A_2 + u (A_0 - A_2) + v (A_1 - A_2), which keeps equal attributes exactly.
template <int C, class T>
MIPBAKE_INLINE void interpolate_values(const Corners<T>& a, T u, T v, int channels, T* out) {
    const auto value = [&](int c) { return a.a2[c] + u * (a.a0[c] - a.a2[c]) + v * (a.a1[c] - a.a2[c]); };
    if constexpr (C > 0) {
        T values[C];  // one register: `out` could otherwise overlap the attributes
        for (int c = 0; c < C; ++c) values[c] = value(c);
        for (int c = 0; c < C; ++c) out[c] = values[c];
    } else {
        for (int c = 0; c < channels; ++c) out[c] = value(c);
    }
}

// dA/dX and dA/dY of the listed channels from db = (du/dX, du/dY, dv/dX, dv/dY).
template <int K, class T>
MIPBAKE_INLINE void interpolate_derivatives(const Corners<T>& a, const T* db, const Listed& listed, T* out) {
    const auto derivative = [&](int k, int axis) {
        const int c = listed_channel<K>(listed, k);
        return (a.a0[c] - a.a2[c]) * db[axis] + (a.a1[c] - a.a2[c]) * db[2 + axis];
    };
    if constexpr (K > 0) {
        T derivatives[2 * K];
        for (int i = 0; i < 2 * K; ++i) derivatives[i] = derivative(i / 2, i % 2);
        for (int i = 0; i < 2 * K; ++i) out[i] = derivatives[i];
    } else {
        for (int i = 0; i < 2 * listed_count<K>(listed); ++i) out[i] = derivative(i / 2, i % 2);
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
template <int K, class T>
MIPBAKE_INLINE void derivative_gradient(const Corners<T>& a, const T* grad_da, const Listed& listed, T* grad_db) {
    T sum[4] = {0, 0, 0, 0};
    for (int k = 0; k < listed_count<K>(listed); ++k) {
        const int c = listed_channel<K>(listed, k);
        const T by_u = a.a0[c] - a.a2[c], by_v = a.a1[c] - a.a2[c];
        sum[0] += by_u * grad_da[2 * k];
        sum[1] += by_u * grad_da[2 * k + 1];
        sum[2] += by_v * grad_da[2 * k];
        sum[3] += by_v * grad_da[2 * k + 1];
    }
    for (int i = 0; i < 4; ++i) grad_db[i] = sum[i];
}

// What a pixel contributes to the gradients of its vertices. Vertex 0 gets u of the gradient of a value, and du/dX and
// du/dY of the gradients of its derivatives; vertex 1 gets the same of v. The three contributions add up to the
// gradient of the value.
template <class T>
MIPBAKE_INLINE T derivative_share(const T* db, int vertex, const T* grad_da, int k) {
    return db[2 * vertex] * grad_da[2 * k] + db[2 * vertex + 1] * grad_da[2 * k + 1];
}

// Calls add(vertex, channel, value) with all of them.
template <class T, class Add>
MIPBAKE_INLINE void value_contributions(T u, T v, int channels, const T* grad, Add&& add) {
    const T w = 1 - u - v;
    for (int c = 0; c < channels; ++c) add(0, c, u * grad[c]);
    for (int c = 0; c < channels; ++c) add(1, c, v * grad[c]);
    for (int c = 0; c < channels; ++c) add(2, c, w * grad[c]);
}
template <class T, class Add>
MIPBAKE_INLINE void derivative_contributions(const T* db, const T* grad_da, const Listed& listed, Add&& add) {
    for (int k = 0; k < listed.count; ++k) {
        const T first = derivative_share(db, 0, grad_da, k), second = derivative_share(db, 1, grad_da, k);
        add(0, listed.channels[k], first);
        add(1, listed.channels[k], second);
        add(2, listed.channels[k], -(first + second));
    }
}

// The same for few channels, summed into the three vertices' rows at once. S may be wider than T.
template <int C, int K, class T, class S>
MIPBAKE_INLINE void add_contributions(T u, T v, const T* db, const T* grad, const T* grad_da, S* const* rows) {
    T first[C], second[C], third[C];
    for (int c = 0; c < C; ++c) {
        first[c] = u * grad[c];
        second[c] = v * grad[c];
        if (c < K) {
            first[c] += derivative_share(db, 0, grad_da, c);
            second[c] += derivative_share(db, 1, grad_da, c);
        }
        third[c] = grad[c] - (first[c] + second[c]);
    }
    // One after the other: two vertices of a triangle may be the same.
    S sums[C];
    for (int c = 0; c < C; ++c) sums[c] = rows[0][c] + static_cast<S>(first[c]);
    for (int c = 0; c < C; ++c) rows[0][c] = sums[c];
    for (int c = 0; c < C; ++c) sums[c] = rows[1][c] + static_cast<S>(second[c]);
    for (int c = 0; c < C; ++c) rows[1][c] = sums[c];
    for (int c = 0; c < C; ++c) sums[c] = rows[2][c] + static_cast<S>(third[c]);
    for (int c = 0; c < C; ++c) rows[2][c] = sums[c];
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
