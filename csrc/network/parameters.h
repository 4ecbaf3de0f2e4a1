// Stored channels to the parameters that latent networks read and make, and back: the C++ side of
// models/parameters.py. A model is one of models.h, made of what it reads.
#pragma once

#include "network/corrections.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace network {

constexpr float kMinLogAlpha2 = -12.404371f;  // ln of kMinRoughness^4
constexpr float kLeastHeight2 = 1e-4f;        // MIN_HEIGHT^2

template <class M>
constexpr int parameter_count = M::Read::metallic ? (M::lines ? 9 : 7) : M::Read::channels;

// channel(c) is stored channel c.
template <class M, class T, class Channel>
MIPBAKE_INLINE void put_parameters(Channel&& channel, Walk<T> out) {
    using R = typename M::Read;
    if constexpr (!R::metallic) {
        for (int c = 0; c < R::channels; ++c) out.put(channel(c));
    } else {
        for (int c = 0; c < 4; ++c) out.put(channel(c));
        const T roughness = clamp(channel(R::lobe), kMinRoughness, 1.0);
        if constexpr (!M::lines) out.put(natural_logarithm(roughness) * T(4.0f));
        out.put(channel(R::normal));
        out.put(channel(R::normal + 1));
        if constexpr (M::lines) {
            const T x = channel(8), y = channel(9), strength = channel(10), alpha = roughness * roughness;
            const T across = natural_logarithm(alpha) * T(2.0f);
            const T along = natural_logarithm(alpha + (T(1.0f) - alpha) * strength * strength) * T(2.0f);
            const T mean = (along + across) * T(0.5f), half = (along - across) * T(0.5f);
            const T d = half * (x * x - y * y), c = half * T(2.0f) * x * y;
            out.put(mean + d);
            out.put(mean - d);
            out.put(c);
        }
    }
}

template <class T>
MIPBAKE_INLINE Pair<T> onto_disc(const Pair<T>& xy) {
    return xy * (T(1.0f) / square_root(larger(square_length(xy), T(1.0f))));
}

// The lobe of a log-roughness tensor as KHR_materials_anisotropy stores it.
template <class T>
MIPBAKE_INLINE Lines<T> lines_of_tensor(const T& a, const T& b, const T& c) {
    const T half(0.5f), one(1.0f);
    const T mean = (a + b) * half, d = (a - b) * half, squared = d * d + c * c;
    const T radius = square_root(squared + T(1e-12f));
    const T wide = clamp(mean + radius, kMinLogAlpha2, 0.0), narrow = clamp(mean - radius, kMinLogAlpha2, 0.0);
    const T alpha = exponential(narrow * half);
    Lines<T> out;
    out.narrow = exponential(narrow * T(0.25f));
    out.strength =
        smaller(square_root((exponential(wide * half) - alpha) / larger(one - alpha, T(1e-3f)) + T(1e-8f)), one);
    const T along = select(squared < T(1e-12f), T(1e-6f), d);
    const T size = square_root(along * along + c * c);
    out.direction = half_turned(along / size, c / size);
    return out;
}

// The stored channels of unconstrained parameters.
template <class M, class T>
MIPBAKE_INLINE void put_stored(Means<T> given, const Limits& limits, Walk<T> out) {
    using R = typename M::Read;
    const T one(1.0f);
    for (int c = 0; c < colour_count<R> + (R::metallic ? 1 : 0); ++c) out.put(clamp(given.take(), 0.0, 1.0));
    if constexpr (R::metallic) {
        T roughness(0.0f);
        if constexpr (!M::lines) roughness = exponential(clamp(given.take(), kMinLogAlpha2, 0.0) * T(0.25f));
        Pair<T> xy;
        xy.x = given.take();
        xy.y = given.take();
        xy = onto_disc(xy);
        const T height = square_root(larger(one - square_length(xy), T(kLeastHeight2)));
        Lines<T> lines;
        if constexpr (M::lines) {
            const T a = given.take(), b = given.take(), c = given.take();
            lines = lines_of_tensor(a, b, c);
            roughness = lines.narrow;
        }
        out.put(roughness);
        out.put(xy.x);
        out.put(xy.y);
        out.put(height);
        if constexpr (M::lines) {
            out.put(lines.direction.x);
            out.put(lines.direction.y);
            out.put(lines.strength);
        }
    } else {
        Pair<T> xy;
        xy.x = given.take();
        xy.y = given.take();
        xy = onto_disc(xy);
        out.put(xy.x);
        out.put(xy.y);
        const T a = given.take(), b = given.take(), c = given.take();
        put_tensor((a + b) * T(0.125f), {(a - b) * T(0.5f), c}, 4 * limits.least_log_roughness, out);
        if constexpr (R::gamma) out.put(clamp(given.take(), -kMaxLogGamma, kMaxLogGamma));
    }
}

}  // namespace network
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
