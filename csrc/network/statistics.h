// What averages of moments tell, and the changes of the averages that they suggest: the C++ side of
// models/moment_statistics.py, whose names and constants it has.
#pragma once

#include "network/moments.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace network {

// The constants of moment_statistics.py.
constexpr float kFarthest = 3.0f, kSoft = 0.05f, kCancelled = 4e-7f, kRounding = 2e-6f, kSoftVariance = 0.02f;
constexpr float kMostEccentric = 1 - 1e-5f;

template <class R>
constexpr int feature_count =
    26 + (R::metallic ? 8 : 0) + (R::metallic ? 0 : 15) + 2 * stretch_count<R> + (R::gamma ? 1 : 0);

template <class T>
struct Pair {
    T x, y;
};

template <class T>
MIPBAKE_INLINE T square_length(const Pair<T>& a) {
    return a.x * a.x + a.y * a.y;
}
template <class T>
MIPBAKE_INLINE Pair<T> operator*(const Pair<T>& a, const T& s) {
    return {a.x * s, a.y * s};
}
template <class T>
MIPBAKE_INLINE Pair<T> operator+(const Pair<T>& a, const Pair<T>& b) {
    return {a.x + b.x, a.y + b.y};
}
template <class T>
MIPBAKE_INLINE Pair<T> operator-(const Pair<T>& a, const Pair<T>& b) {
    return {a.x - b.x, a.y - b.y};
}

template <class R, class T>
struct Statistics {
    static constexpr int colours = colour_count<R>;
    T colour[colours], metallic;  // base, or diffuse and specular
    T roughness, log_roughness, log_gamma;
    Pair<T> stretch, normal, lean_normal, lean_stretch, axes, tall_normal, upward_normal;
    T to_lean, to_widened, to_geometric, to_quartic, to_tall, to_upward, to_narrowest;
    T spread, slopes, metallic_variance, metallic_colour[3], specular_variance[3], tall_specular[3], upward_specular[3];
    T freedom, tall_freedom, upward_freedom, colour_freedom;
};

template <class T>
struct Among {
    Pair<T> mean;
    T variance;
};

// Mean and variance of slopes among weighted texels, from averages of the products with their weight.
template <class T>
MIPBAKE_INLINE Among<T> among(const T& weight, const Pair<T>& first, const T& second, const Pair<T>& slope,
                              const T& slopes) {
    const T reach = T(kFarthest) * square_root(slopes), inverse = T(1.0f) / weight;
    const auto held = [&](const T& value, const T& middle) {
        return middle + smaller(larger(value * inverse - middle, -reach), reach);
    };
    const Pair<T> mean = {held(first.x, slope.x), held(first.y, slope.y)};
    const T variance = larger(second * inverse - square_length(mean), T(0.0f));
    return {mean, smaller(variance, T(kFarthest) * slopes)};
}

// x and y of the unit normals of slopes.
template <class T>
MIPBAKE_INLINE Pair<T> leaning(const Pair<T>& slope) {
    return slope * (T(1.0f) / square_root(T(1.0f) + square_length(slope)));
}

// How much a variance of slopes widens a lobe, from 0 to 1.
template <class T>
MIPBAKE_INLINE T widening(const T& variance, const T& alpha2) {
    const T logarithm = logarithm_of_one_plus(variance / alpha2) * T(0.25f);
    return logarithm / (logarithm + T(kSoft));
}

template <class T>
MIPBAKE_INLINE T share_of(const T& variance) {
    return larger(variance - T(kRounding), T(0.0f)) / (variance + T(kSoftVariance));
}

// Reads averages in the order of put_moments.
template <class T>
struct Means {
    const float* at;
    std::int64_t stride;
    MIPBAKE_INLINE T take() {
        const float* const here = at;
        at += stride;
        if constexpr (std::is_same_v<T, float>) {
            return *here;
        } else {
            return T::load(here);
        }
    }
};

template <class R, class T>
MIPBAKE_FUNCTION Statistics<R, T> statistics(Means<T> mean, const Limits& limits) {
    constexpr int C = colour_count<R>;
    const T zero(0.0f), one(1.0f);
    Statistics<R, T> out;
    for (int i = 0; i < C; ++i) {
        out.colour[i] = clamp(mean.take(), 0.0, 1.0);
        if (R::metallic && i == 2) out.metallic = clamp(mean.take(), 0.0, 1.0);
    }
    out.roughness = clamp(mean.take(), 0.0, limits.most_roughness);
    if constexpr (R::tensor) {
        out.stretch.x = mean.take();
        out.stretch.y = mean.take();
    }
    if constexpr (R::gamma) out.log_gamma = mean.take();
    Pair<T> xy, slope;
    xy.x = mean.take();
    xy.y = mean.take();
    const T drop = mean.take();
    slope.x = mean.take();
    slope.y = mean.take();
    const T slope_xx = mean.take(), slope_yy = mean.take(), slope_xy = mean.take();
    const T mean_alpha2 = mean.take(), mean_log_roughness = mean.take();
    T tensor[3];
    if constexpr (R::tensor)
        for (T& each : tensor) each = mean.take();
    T metallic_base[3], metallic2, specular2[3];
    if constexpr (R::metallic) {
        for (T& each : metallic_base) each = mean.take();
        metallic2 = mean.take();
    } else {
        for (T& each : specular2) each = mean.take();
    }
    T height_specular[3], upward_specular[3];
    const T mean_height = mean.take();
    Pair<T> height_slope, upward_slope;
    height_slope.x = mean.take();
    height_slope.y = mean.take();
    const T height_steepness = mean.take();
    if constexpr (!R::metallic)
        for (T& each : height_specular) each = mean.take();
    const T upward = larger(mean.take(), T(1e-4f));
    upward_slope.x = mean.take();
    upward_slope.y = mean.take();
    const T upward_steepness = mean.take();
    const auto held = [&](const T& alpha2) { return clamp(alpha2, limits.least_alpha2, limits.most_alpha2); };
    const T upward_alpha2 = held(mean.take() / upward);
    if constexpr (!R::metallic)
        for (T& each : upward_specular) each = mean.take();

    const T quartic = held(mean_alpha2), length2 = square_length(xy);
    out.spread = clamp(T(2.0f) * drop - drop * drop - length2 * T(1 + kCancelled), 0.0, 1.0);
    const T height = one - drop;
    out.normal = xy * (one / square_root(larger(length2 + height * height, T(1e-8f))));
    const T xx = slope_xx - slope.x * slope.x, yy = slope_yy - slope.y * slope.y;
    const T crossed = slope_xy - slope.x * slope.y;
    out.slopes = clamp(xx + yy - T(kCancelled) * square_length(slope), 0.0, 50.0);
    const T shaded = larger(out.roughness, T(limits.least_roughness));
    out.log_roughness = natural_logarithm(shaded);
    const T length = square_root(larger(one - out.spread, T(1e-6f)));
    const T concentration = (one - length) / length;
    const T alpha = shaded * shaded, alpha2 = alpha * alpha;
    const T widened = (alpha2 + T(2.0f) * concentration * larger(one - alpha2, zero)) / (one + T(2.0f) * concentration);
    const Pair<T> axes = Pair<T>{xx - yy, T(2.0f) * crossed} * (one / (out.slopes + T(1e-5f)));
    out.axes = axes * (one / square_root(larger(square_length(axes), one)));

    T lean_alpha2 = quartic + out.slopes;
    if constexpr (R::tensor) {
        const T middle = larger(tensor[0], quartic) + out.slopes;
        const Pair<T> difference = Pair<T>{tensor[1], tensor[2]} + out.axes * out.slopes;
        const T size = square_root(square_length(difference));
        const T eccentric = smaller(size / middle, T(kMostEccentric));
        lean_alpha2 = middle * square_root(one - eccentric * eccentric);
        const T factor = area_hyperbolic_tangent(eccentric) / larger(size, T(1e-30f));
        const Pair<T> lean = difference * select(eccentric > T(1e-6f), factor, zero);
        out.lean_stretch = lean - out.stretch;
    }
    const T quarter(0.25f);
    out.to_lean = natural_logarithm(held(lean_alpha2)) * quarter - out.log_roughness;
    out.to_widened = natural_logarithm(widened) * quarter - out.log_roughness;
    const T geometric = clamp(mean_log_roughness, limits.least_log_roughness, limits.most_log_roughness);
    out.to_geometric = clamp(geometric - out.log_roughness, -2.0, 0.5);
    out.to_quartic = natural_logarithm(quartic) * quarter - out.log_roughness;
    out.lean_normal = leaning(slope) - out.normal;
    // By Jensen's inequality; kernels with negative lobes break it.
    const T tall = larger(mean_height, one / quartic), narrowest = one / tall;
    const Among<T> tallest = among(tall, height_slope, height_steepness, slope, out.slopes);
    const Among<T> brightest = among(upward, upward_slope, upward_steepness, slope, out.slopes);
    out.to_tall = natural_logarithm(held(narrowest + tallest.variance)) * quarter - out.log_roughness;
    out.to_upward = natural_logarithm(held(upward_alpha2 + brightest.variance)) * quarter - out.log_roughness;
    out.to_narrowest = smaller(natural_logarithm(tall) * T(-0.25f) - out.log_roughness, zero);
    out.tall_normal = leaning(tallest.mean) - out.normal;
    out.upward_normal = leaning(brightest.mean) - out.normal;
    T varied;
    if constexpr (R::metallic) {
        out.metallic_variance = varied = clamp(metallic2 - out.metallic * out.metallic, 0.0, 1.0);
        for (int i = 0; i < 3; ++i) out.metallic_colour[i] = metallic_base[i] - out.metallic * out.colour[i];
    } else {
        varied = zero;
        for (int i = 0; i < 3; ++i) {
            const T specular = out.colour[3 + i];
            out.specular_variance[i] = clamp(specular2[i] - specular * specular, 0.0, 1.0);
            varied += out.specular_variance[i];
            out.tall_specular[i] = clamp(height_specular[i] * narrowest, 0.0, 1.0) - specular;
            out.upward_specular[i] = clamp(upward_specular[i] / upward, 0.0, 1.0) - specular;
        }
    }
    // `to_widened` narrows what is as rough as can be.
    const T differing = larger(larger(out.to_lean, zero) + out.to_widened - smaller(out.to_geometric, zero), zero);
    out.freedom = differing / (differing + T(kSoft));
    out.tall_freedom = widening(tallest.variance, narrowest);
    out.upward_freedom = widening(brightest.variance, upward_alpha2);
    out.colour_freedom = share_of(out.spread) + share_of(varied);
    return out;
}

// The statistics scaled to about 1, for a decoder.
template <class R, class T>
MIPBAKE_FUNCTION void put_features(const Statistics<R, T>& found, Walk<T> out) {
    const T four(4.0f);
    const auto put_pair = [&](const Pair<T>& pair, float factor) {
        out.put(pair.x * T(factor));
        out.put(pair.y * T(factor));
    };
    for (const T* each : {&found.to_lean, &found.to_widened, &found.to_geometric, &found.to_quartic})
        out.put(*each * four);
    out.put(found.log_roughness + T(0.8f));
    if constexpr (R::metallic) {
        out.put(found.metallic);
        for (const T& colour : found.colour) out.put(colour * T(2.0f) - T(0.8f));
    }
    for (const T* each : {&found.slopes, &found.spread})
        out.put(natural_logarithm(*each + T(1e-5f)) * T(0.25f) + T(1.0f));
    put_pair(found.axes, 2.0f);
    if constexpr (R::metallic) {
        out.put(found.metallic_variance * four);
        for (const T& each : found.metallic_colour) out.put(each * four);
    }
    put_pair(found.normal, 2.0f);
    put_pair(found.lean_normal, 4.0f);
    out.put(found.freedom);
    out.put(found.colour_freedom);
    const T ratio = found.slopes * bounded_exponential(found.log_roughness * T(-4.0f));
    out.put(natural_logarithm(ratio + T(1e-3f)) * T(0.25f));
    out.put(found.to_tall * four);
    out.put(found.to_upward * four);
    put_pair(found.tall_normal, 4.0f);
    put_pair(found.upward_normal, 4.0f);
    const auto put_offset = [&](const Pair<T>& normal, const T& by) {
        const T width = bounded_exponential((found.log_roughness + by) * T(-2.0f));
        out.put(area_hyperbolic_sine(normal.x * width) * T(0.5f));
        out.put(area_hyperbolic_sine(normal.y * width) * T(0.5f));
    };
    put_offset(found.tall_normal, found.to_tall);
    put_offset(found.upward_normal, found.to_upward);
    if constexpr (!R::metallic) {
        for (const T& colour : found.colour) out.put(colour * T(2.0f) - T(0.8f));
        for (const T& each : found.specular_variance) out.put(each * four);
        for (const T& each : found.tall_specular) out.put(each * four);
        for (const T& each : found.upward_specular) out.put(each * four);
    }
    if constexpr (R::tensor) {
        put_pair(found.stretch, 1.0f);
        put_pair(found.lean_stretch, 2.0f);
    }
    if constexpr (R::gamma) out.put(found.log_gamma);
}

}  // namespace network
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
