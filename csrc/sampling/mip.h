// One axis of a MIP step by area averaging: n texels become max(1, n / 2), each the mean of n / (n / 2) of them. Where
// n is odd that takes three texels with weights that depend on the place (a polyphase filter; Guthe and Heckbert 2005,
// "Non-power-of-two mipmap creation").
#pragma once

#include "core/platform.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

MIPBAKE_INLINE int mip_size(int size) { return size > 1 ? size / 2 : 1; }

// Output i is the sum of weights[k] times input `first` + k, k < count.
template <class T>
struct MipTaps {
    int first, count;
    T weights[3];
};

template <class T>
MIPBAKE_INLINE MipTaps<T> mip_taps(int i, int size) {
    if (size == 1) return {0, 1, {T(1), T(0), T(0)}};
    if (size % 2 == 0) return {2 * i, 2, {T(0.5), T(0.5), T(0)}};
    const T n = static_cast<T>(size), half = static_cast<T>(size / 2);
    return {2 * i, 3, {(half - static_cast<T>(i)) / n, half / n, static_cast<T>(i + 1) / n}};
}

// The adjoint: input i goes to outputs first + k, k < count, with these weights.
template <class T>
MIPBAKE_INLINE MipTaps<T> mip_adjoint_taps(int i, int size) {
    if (size == 1) return {0, 1, {T(1), T(0), T(0)}};
    if (size % 2 == 0) return {i / 2, 1, {T(0.5), T(0), T(0)}};
    const T n = static_cast<T>(size);
    const int half = size / 2, k = i / 2;
    if (i % 2 == 1) return {k, 1, {static_cast<T>(half) / n, T(0), T(0)}};
    const T above = static_cast<T>(k) / n, below = static_cast<T>(half - k) / n;
    if (k == 0) return {0, 1, {below, T(0), T(0)}};
    if (k == half) return {k - 1, 1, {above, T(0), T(0)}};
    return {k - 1, 2, {above, below, T(0)}};
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
