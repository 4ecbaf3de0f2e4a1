// What is averaged of a texel, and what the encoder sees of it: the C++ side of models/moments.py, in the order
// of its dataclass. T is float or a packet of floats, one texel a lane.
#pragma once

#include "core/functions.h"
#include "network/models.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace network {

// Numbers that hang on the material model alone.
struct Limits {
    float least_roughness, most_roughness;          // that are shaded
    float least_log_roughness, most_log_roughness;  // their logarithms
    float least_alpha2, most_alpha2;                // their fourth powers
};

template <class R>
constexpr int colour_count = R::metallic ? 3 : 6;
template <class R>
constexpr int stretch_count = R::tensor ? 2 : 0;

// Moments up to 1 - n_z, which sharpening is told by.
template <class R>
constexpr int detail_count = colour_count<R> + (R::metallic ? 1 : 0) + 1 + stretch_count<R> + (R::gamma ? 1 : 0) + 3;
template <class R>
constexpr int moment_count =
    detail_count<R> + 7 + (R::tensor ? 3 : 0) + (R::metallic ? 4 : 3) + 4 + 5 + (R::metallic ? 0 : 6);
template <class R>
constexpr int input_count = colour_count<R> + (R::metallic ? 1 : 0) + 1 + stretch_count<R> + (R::gamma ? 1 : 0) + 5;

constexpr float kMinHeight = 0.1f;  // slopes are cut at 10, as moments.py has it

// A texel, read.
template <class R, class T>
struct Texel {
    T colours[colour_count<R>], metallic, x, y, z, roughness, stretch[2], peak;

    // channel(c) is stored channel c.
    template <class Channel>
    static MIPBAKE_INLINE Texel of(Channel&& channel) {
        Texel out;
        for (int i = 0; i < colour_count<R>; ++i) out.colours[i] = channel(i);
        out.metallic = R::metallic ? channel(3) : T(0.0f);
        out.x = channel(R::normal);
        out.y = channel(R::normal + 1);
        if constexpr (R::heights) {
            out.z = channel(R::normal + 2);
        } else {
            out.z = square_root(larger(T(1.0f) - (out.x * out.x + out.y * out.y), T(0.0f)));
        }
        if constexpr (R::tensor) {
            const T a = channel(R::lobe), b = channel(R::lobe + 1);
            out.roughness = bounded_exponential((a + b) * T(0.125f));
            out.stretch[0] = (a - b) * T(0.5f);
            out.stretch[1] = channel(R::lobe + 2);
        } else {
            out.roughness = channel(R::lobe);
        }
        if constexpr (R::gamma) out.peak = channel(R::peak);
        return out;
    }
};

// A pointer that walks over the channels of a texel, `stride` floats apart.
template <class T>
struct Walk {
    float* at;
    std::int64_t stride;
    MIPBAKE_INLINE void put(const T& value) {
        if constexpr (std::is_same_v<T, float>) {
            *at = value;
        } else {
            store_lanes(at, value);
        }
        at += stride;
    }
};

// Numbers of about 1 for the encoder.
template <class R, class T>
MIPBAKE_INLINE void put_inputs(const Texel<R, T>& texel, const Limits& limits, Walk<T> out) {
    for (const T& colour : texel.colours) out.put(colour * T(2.0f) - T(0.8f));
    if constexpr (R::metallic) out.put(texel.metallic);
    const T shaded = larger(texel.roughness, T(limits.least_roughness));
    out.put(natural_logarithm(shaded) + T(0.8f));
    if constexpr (R::tensor) {
        out.put(texel.stretch[0]);
        out.put(texel.stretch[1]);
    }
    if constexpr (R::gamma) out.put(texel.peak);
    out.put(texel.x * T(3.0f));
    out.put(texel.y * T(3.0f));
    const T width = larger(texel.z, T(0.1f)) * shaded * shaded;
    out.put(area_hyperbolic_sine(texel.x / width) * T(1.0f / 3));
    out.put(area_hyperbolic_sine(texel.y / width) * T(1.0f / 3));
    out.put((texel.x * texel.x + texel.y * texel.y) * T(4.0f));
}

// alpha^2 s^T S^-1 s of a slope, and the tensor's three numbers over alpha^2.
template <class R, class T>
MIPBAKE_INLINE T seen_steepness(const Texel<R, T>& texel, const T& x, const T& y, T (&tensor)[3]) {
    const T steepness = x * x + y * y;
    if constexpr (!R::tensor) {
        return steepness;
    } else {
        const T d = texel.stretch[0], c = texel.stretch[1];
        const T q = square_root(d * d + c * c), e = bounded_exponential(q), inverse = T(1.0f) / e;
        tensor[0] = (e + inverse) * T(0.5f);
        const T ratio = (e - inverse) * T(0.5f) / larger(q, T(1e-4f));
        const T sinhc = select(q > T(1e-4f), ratio, T(1.0f));
        tensor[1] = sinhc * d;
        tensor[2] = sinhc * c;
        const T turned = d * (x * x - y * y) + T(2.0f) * c * x * y;
        return larger(tensor[0] * steepness - sinhc * turned, T(0.0f));
    }
}

template <class R, class T>
MIPBAKE_INLINE void put_moments(const Texel<R, T>& texel, const Limits& limits, Walk<T> out) {
    for (const T& colour : texel.colours) {
        out.put(colour);
        if (R::metallic && &colour == texel.colours + 2) out.put(texel.metallic);
    }
    out.put(texel.roughness);
    if constexpr (R::tensor) {
        out.put(texel.stretch[0]);
        out.put(texel.stretch[1]);
    }
    if constexpr (R::gamma) out.put(texel.peak);
    out.put(texel.x);
    out.put(texel.y);
    // 1 - n_z without cancellation: alpha^2 goes down to 4e-6, and spreads of normals are measured against it.
    const T flat = texel.x * texel.x + texel.y * texel.y;
    out.put(select(texel.z > T(0.0f), flat / (T(1.0f) + larger(texel.z, T(0.0f))), T(1.0f) - texel.z));

    const T height_of_normal = larger(texel.z, T(kMinHeight));
    const T x = texel.x / height_of_normal, y = texel.y / height_of_normal, steepness = x * x + y * y;
    const T shaded = larger(texel.roughness, T(limits.least_roughness));
    const T alpha = shaded * shaded, alpha2 = alpha * alpha;
    T tensor[3];
    const T seen = seen_steepness(texel, x, y, tensor);
    out.put(x);
    out.put(y);
    out.put(x * x);
    out.put(y * y);
    out.put(x * y);
    out.put(alpha2);
    out.put(natural_logarithm(shaded));
    if constexpr (R::tensor)
        for (const T& each : tensor) out.put(alpha2 * each);
    if constexpr (R::metallic) {
        for (const T& colour : texel.colours) out.put(texel.metallic * colour);
        out.put(texel.metallic * texel.metallic);
    } else {
        for (int i = 3; i < 6; ++i) out.put(texel.colours[i] * texel.colours[i]);
    }
    const T height = T(1.0f) / alpha2;
    out.put(height);
    out.put(height * x);
    out.put(height * y);
    out.put(height * steepness);
    if constexpr (!R::metallic)
        for (int i = 3; i < 6; ++i) out.put(height * texel.colours[i]);
    const T sum = alpha2 + seen, upward = alpha2 / (sum * sum);
    out.put(upward);
    out.put(upward * x);
    out.put(upward * y);
    out.put(upward * steepness);
    out.put(upward * alpha2);
    if constexpr (!R::metallic)
        for (int i = 3; i < 6; ++i) out.put(upward * texel.colours[i]);
}

}  // namespace network
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
