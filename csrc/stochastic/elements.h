// What is done to one element: perturbing it, its gradient, and its step. CPU and CUDA share these.
#pragma once

#include <cmath>

#include "core/real.h"
#include "stochastic/signs.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// ElementChannels with its numbers in place, as a kernel on a GPU takes it.
template <class T>
struct ChannelNumbers {
    int count, lifted;
    T magnitude[most_channels], low[most_channels], high[most_channels];
};

template <class T>
inline ChannelNumbers<T> numbers_of(const ElementChannels<T>& channels) {
    ChannelNumbers<T> out{};
    out.count = channels.count;
    out.lifted = channels.lifted;
    for (int c = 0; c < channels.count; ++c) {
        out.magnitude[c] = channels.magnitude[c];
        out.low[c] = channels.low != nullptr ? channels.low[c] : T(0);
        out.high[c] = channels.high != nullptr ? channels.high[c] : T(0);
    }
    return out;
}

// Makes (x, y, z), each stored as (n + 1) / 2, a unit vector above the surface: z from x and y, which are scaled back
// onto the unit disc where they lie outside of it.
template <class T>
MIPBAKE_INLINE void lift(T* stored) {
    T x = 2 * stored[0] - 1, y = 2 * stored[1] - 1;
    const T square = x * x + y * y;
    if (square > 1) {
        const T scale = 1 / square_root(square);
        x *= scale;
        y *= scale;
        stored[0] = T(0.5) * (x + 1);
        stored[1] = T(0.5) * (y + 1);
    }
    stored[2] = T(0.5) * (square_root(square < 1 ? 1 - square : T(0)) + 1);
}

// Rounding may carry what is made of numbers within the limits beyond them. A channel that stays as it is has none.
template <class T>
MIPBAKE_INLINE T within(T value, const ChannelNumbers<T>& n, int c) {
    const T bounded = value < n.low[c] ? n.low[c] : value > n.high[c] ? n.high[c] : value;
    return n.magnitude[c] > 0 ? bounded : value;
}

// Both perturbed elements lie within the limits: where a parameter is nearer to one than its magnitude, the middle of
// the two moves, so that the difference stays a central one.
template <class T>
MIPBAKE_INLINE void perturb_element(const T* values, const ChannelNumbers<T>& n, std::uint32_t first,
                                    const SignKey& key, T* plus, T* minus) {
    for (int c = 0; c < n.count; ++c) {
        const T magnitude = n.magnitude[c];
        const T low = n.low[c] + magnitude, high = n.high[c] - magnitude;
        T middle = values[c];
        middle = middle < low ? low : middle;
        middle = middle > high ? (high < low ? T(0.5) * (low + high) : high) : middle;
        middle = magnitude > 0 ? middle : values[c];
        const T step = sign_of<T>(first + static_cast<std::uint32_t>(c), key) * magnitude;
        plus[c] = within(middle + step, n, c);
        minus[c] = within(middle - step, n, c);
    }
    if (n.lifted >= 0) {
        lift(plus + n.lifted);
        lift(minus + n.lifted);
    }
}

// Adds s_i times the sum of the differences over 2 epsilon_i, equation 8: all pixels of an element share its signs.
template <class T>
MIPBAKE_INLINE void add_gradient(T sum, const ChannelNumbers<T>& n, std::uint32_t first, const SignKey& key,
                                 T* gradient) {
    for (int c = 0; c < n.count; ++c) {
        const T magnitude = n.magnitude[c];
        const T share = magnitude > 0 ? sum / (2 * magnitude) : T(0);
        gradient[c] += sign_of<T>(first + static_cast<std::uint32_t>(c), key) * share;
    }
}

// What Adam divides its moments by at a step, so that their start at 0 does not count.
template <class T>
struct AdamScales {
    T first, second;
};

MIPBAKE_INLINE float power_of(float base, float exponent) { return ::powf(base, exponent); }
MIPBAKE_INLINE double power_of(double base, double exponent) { return ::pow(base, exponent); }

template <class T>
MIPBAKE_INLINE AdamScales<T> adam_scales(std::int32_t steps, T beta1, T beta2) {
    const T count = static_cast<T>(steps);
    return {1 / (1 - power_of(beta1, count)), 1 / (1 - power_of(beta2, count))};
}

template <class T>
MIPBAKE_INLINE void adam_element(T* values, T* gradient, T* first, T* second, const AdamScales<T>& whole,
                                 const ChannelNumbers<T>& n, T beta1, T beta2, T epsilon) {
    for (int c = 0; c < n.count; ++c) {
        const T g = gradient[c];
        gradient[c] = 0;
        first[c] = beta1 * first[c] + (1 - beta1) * g;
        second[c] = beta2 * second[c] + (1 - beta2) * g * g;
        T value =
            values[c] - n.magnitude[c] * (first[c] * whole.first) / (square_root(second[c] * whole.second) + epsilon);
        value = value < n.low[c] ? n.low[c] : value;
        value = value > n.high[c] ? n.high[c] : value;
        values[c] = n.magnitude[c] > 0 ? value : values[c];
    }
    if (n.lifted >= 0) lift(values + n.lifted);
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
