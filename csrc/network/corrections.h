// What a decoder may change about averages, and the stored channels that come of it: the C++ side of
// models/corrections.py and direction.py, whose names and constants it has.
#pragma once

#include "network/statistics.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace network {

// The constants of corrections.py and moment_network.py.
constexpr float kCaution = 2.0f, kDecision = 5.0f, kMostGain = 0.5f, kMostSpecularGain = 1.5f, kMostPeak = 0.5f;
constexpr float kMostChange = 3.0f, kNarrower = 0.1f, kFarthestTurn = 0.5f, kMaxLength2 = 0.999f, kMinHeight2 = 1e-4f;
constexpr float kStep = 0.1f, kDetailScale = 8.0f;
// Those of direction.py.
constexpr float kMostShare = 1.5f, kShareDecision = 4.0f, kMostRatio = 0.98f, kFree = 0.5f, kLeast = 1e-12f;
// Those of parameters.py and of mipbake.material.
constexpr float kMinRoughness = 0.045f, kMaxLogGamma = 1.5f, kMaxLogAlpha2 = 2.0f, kLog2 = 0.69314718f;

constexpr int kCrisp = 3, kStretchOutputs = 3;

// Whether an output exists hangs on what is read and made; all that are made of a model have its colours.
template <class R>
constexpr int output_count = 5 + (R::metallic ? 5 : 5) + 1 + 1 + 2 + 2 + (R::gamma ? 1 : 0);

template <class R, class T>
struct Outputs {
    T to_lean, to_widened, to_geometric, to_quartic, roughness;
    T gain[3], metallic_colour, metallic_variance;
    T lean_normal, tilt;
    Pair<T> normal, choice;
    T specular_gain[3], tall_specular, upward_specular, log_gamma;

    static MIPBAKE_INLINE Outputs of(Means<T> said) {
        Outputs out;
        const auto take = [&] { return said.take() * T(kStep); };
        for (T* each : {&out.to_lean, &out.to_widened, &out.to_geometric, &out.to_quartic, &out.roughness})
            *each = take();
        if constexpr (R::metallic) {
            for (T& each : out.gain) each = take();
            out.metallic_colour = take();
            out.metallic_variance = take();
        }
        for (T* each : {&out.lean_normal, &out.tilt, &out.normal.x, &out.normal.y, &out.choice.x, &out.choice.y})
            *each = take();
        if constexpr (!R::metallic) {
            for (T& each : out.specular_gain) each = take();
            out.tall_specular = take();
            out.upward_specular = take();
        }
        if constexpr (R::gamma) out.log_gamma = take();
        return out;
    }
};

// What sharpening adds to the averages of colours, lobe and normal.
template <class R, class T>
struct Added {
    T colour[colour_count<R>], metallic, roughness, log_gamma;
    Pair<T> stretch, normal;

    // detail: what sharpening added, scaled by kDetailScale, in the order of moments; crisp: kCrisp sums.
    static MIPBAKE_INLINE Added of(Means<T> detail, Means<T> crisp) {
        const T scale(1 / kDetailScale);
        const T colours = hyperbolic_tangent(crisp.take()) * scale, lobes = hyperbolic_tangent(crisp.take()) * scale,
                normals = hyperbolic_tangent(crisp.take()) * scale;
        Added out;
        for (int i = 0; i < colour_count<R>; ++i) {
            out.colour[i] = colours * detail.take();
            if (R::metallic && i == 2) out.metallic = colours * detail.take();
        }
        out.roughness = lobes * detail.take();
        if constexpr (R::tensor) {
            out.stretch.x = lobes * detail.take();
            out.stretch.y = lobes * detail.take();
        }
        if constexpr (R::gamma) out.log_gamma = lobes * detail.take();
        out.normal.x = normals * detail.take();
        out.normal.y = normals * detail.take();
        return out;
    }
};

template <class T>
MIPBAKE_INLINE T softly(const T& x) {
    return hyperbolic_tangent(x);
}

template <class R, class T>
MIPBAKE_INLINE void put_colours(const Statistics<R, T>& found, const Outputs<R, T>& said, const Added<R, T>& added,
                                Walk<T>& out) {
    if constexpr (R::metallic) {
        const T gain = T(kMostGain) * smaller(found.colour_freedom, T(1.0f)) * found.metallic;
        for (int i = 0; i < 3; ++i) {
            const T base = found.colour[i] * exponential(gain * softly(said.gain[i])) +
                           said.metallic_colour * found.metallic_colour[i];
            out.put(clamp(base + added.colour[i], 0.0, 1.0));
        }
        const T metallic = found.metallic + said.metallic_variance * found.metallic_variance;
        out.put(clamp(metallic + added.metallic, 0.0, 1.0));
    } else {
        for (int i = 0; i < 3; ++i) out.put(clamp(found.colour[i] + added.colour[i], 0.0, 1.0));
        // A lobe that stands for some of the texels reflects less than they do, and lobes differ where colours do not.
        const T freedom = T(kMostSpecularGain) * smaller(found.colour_freedom + found.freedom, T(1.0f));
        for (int i = 0; i < 3; ++i) {
            T specular = found.colour[3 + i] * exponential(freedom * softly(said.specular_gain[i]));
            specular += said.tall_specular * found.tall_specular[i];
            specular += said.upward_specular * found.upward_specular[i];
            out.put(clamp(specular + added.colour[3 + i], 0.0, 1.0));
        }
    }
}

// Share of the anisotropy of `lean`.
template <class T>
MIPBAKE_INLINE T lean_share(const T& said) {
    const T logit = T(kShareDecision) * said - T(kLog2);
    return T(kMostShare) / (T(1.0f) + bounded_exponential(-logit));
}

// A log-roughness tensor whose eigenvalues lie between `least` and kMaxLogAlpha2.
template <class T>
MIPBAKE_INLINE void put_tensor(const T& log_roughness, const Pair<T>& stretch, float least, Walk<T>& out) {
    const T four(4.0f), half(0.5f), middle = log_roughness * four;
    const T radius = square_root(square_length(stretch) + T(1e-12f));
    const T high = clamp(middle + radius, least, kMaxLogAlpha2), low = clamp(middle - radius, least, kMaxLogAlpha2);
    const T mean = (high + low) * half, shrink = (high - low) * half / radius;
    out.put(mean + shrink * stretch.x);
    out.put(mean - shrink * stretch.x);
    out.put(shrink * stretch.y);
}

// Cosine and sine of half an angle between -pi and pi, from those of the angle: the larger of both first.
template <class T>
MIPBAKE_INLINE Pair<T> half_turned(const T& cosine, const T& sine) {
    const T zero(0.0f), half(0.5f);
    const T more = square_root((T(1.0f) + magnitude(cosine)) * half), less = magnitude(sine) * half / more;
    const auto ahead = cosine >= zero;
    const T across = select(ahead, less, more);
    return {select(ahead, more, less), select(sine < zero, -across, across)};
}

// Roughness of the narrower axis, direction of the wider one and strength, as KHR_materials_anisotropy stores them.
template <class T>
struct Lines {
    T narrow, strength;
    Pair<T> direction;
};

template <class R, class T>
MIPBAKE_INLINE Lines<T> lines_of(const Statistics<R, T>& found, const T& roughness, const T& share,
                                 const Pair<T>& free) {
    const T zero(0.0f), one(1.0f), half(0.5f);
    const T quartic = bounded_exponential((found.log_roughness + found.to_quartic) * T(4.0f));
    const Pair<T> ratio = found.axes * (found.slopes / (quartic + found.slopes));
    const T length = larger(square_root(square_length(ratio)), T(1e-6f));
    const T lean = area_hyperbolic_tangent(smaller(length, T(kMostRatio))) * half / length;
    const Pair<T> vector = ratio * (share * lean) + free * (T(kFree) * found.freedom);
    const T squared = square_length(vector);
    const auto stretched = squared > T(kLeast);
    const T size = square_root(select(stretched, squared, one));
    const T cosine = select(stretched, vector.x / size, one), sine = select(stretched, vector.y / size, zero);
    Lines<T> out;
    out.direction = half_turned(cosine, sine);
    const T bend = select(stretched, size, zero) * half;
    out.narrow = larger(roughness * exponential(-bend), smaller(roughness, T(kMinRoughness)));
    const T across = out.narrow * out.narrow;
    const T along = smaller(roughness * roughness * exponential(select(stretched, size, zero)), one);
    const T wider = (along - across) / larger(one - across, T(1e-4f));
    const auto wide = wider > T(kLeast);
    out.strength = smaller(select(wide, square_root(select(wide, wider, one)), zero), one);
    return out;
}

// The stored channels of a texel.
template <class M, class T>
MIPBAKE_FUNCTION void put_channels(const Statistics<typename M::Read, T>& found,
                                   const Outputs<typename M::Read, T>& said, const Added<typename M::Read, T>& added,
                                   Means<T> stretch_said, const Limits& limits, Walk<T> out) {
    using R = typename M::Read;
    const T zero(0.0f), one(1.0f);
    // Shares of the lobe for all texels, and for the bright ones by either weight.
    const T second = T(kDecision) * said.choice.x - T(kCaution), third = T(kDecision) * said.choice.y - T(kCaution);
    const T most = larger(larger(second, third), zero);
    const T of_all = bounded_exponential(-most), of_tall = bounded_exponential(second - most),
            of_upward = bounded_exponential(third - most);
    const T sum = one / (of_all + of_tall + of_upward);
    const T kept = of_all * sum, tall = of_tall * sum, upward = of_upward * sum;

    T change =
        said.to_lean * found.to_lean + said.to_widened * found.to_widened + said.to_geometric * found.to_geometric;
    change = kept * (change + said.to_quartic * found.to_quartic) + tall * found.to_tall + upward * found.to_upward;
    const T freedom = kept * found.freedom + tall * found.tall_freedom + upward * found.upward_freedom;
    change += freedom * softly(said.roughness);
    const T shaded = larger(found.roughness, T(limits.least_roughness));
    // What lies below the roughness that is shaded is kept beside the change, so that a change of nothing changes
    // nothing.
    const T below = found.roughness - shaded;
    const T least = found.to_narrowest - T(kNarrower) * freedom;
    const T factor = bounded_exponential(smaller(larger(change, least), T(kMostChange)));
    const T roughness = clamp(shaded * factor + below + added.roughness, 0.0, limits.most_roughness);
    Pair<T> tilt = found.normal * (one + freedom * softly(said.tilt)) + found.lean_normal * (kept * said.lean_normal);
    tilt = tilt + found.tall_normal * tall + found.upward_normal * upward;
    // A highlight is lost when it moves by its own width, however far the texels spread.
    const T reach = smaller(square_root(found.spread), T(kFarthestTurn) * roughness * roughness);
    Pair<T> xy = tilt + Pair<T>{softly(said.normal.x), softly(said.normal.y)} * reach + added.normal;
    xy = xy * (one / square_root(larger(square_length(xy) * T(1 / kMaxLength2), one)));

    put_colours(found, said, added, out);
    if constexpr (R::tensor) {
        const T share = lean_share(stretch_said.take() * T(kStep));
        const T first = softly(stretch_said.take() * T(kStep)), other = softly(stretch_said.take() * T(kStep));
        const Pair<T> free = Pair<T>{first, other} * (T(2 * kFree) * found.freedom);
        const Pair<T> stretch = found.stretch + found.lean_stretch * share + free + added.stretch;
        out.put(xy.x);
        out.put(xy.y);
        const T log_roughness = natural_logarithm(larger(roughness, T(limits.least_roughness)));
        put_tensor(log_roughness, stretch, 4 * limits.least_log_roughness, out);
        if constexpr (R::gamma) {
            const T peak = found.log_gamma + T(kMostPeak) * freedom * softly(said.log_gamma) + added.log_gamma;
            out.put(clamp(peak, -kMaxLogGamma, kMaxLogGamma));
        }
    } else {
        const T height = square_root(larger(one - square_length(xy), T(kMinHeight2)));
        const T unit = one / square_root(square_length(xy) + height * height);
        const auto put_normal = [&] {
            out.put(xy.x * unit);
            out.put(xy.y * unit);
            out.put(height * unit);
        };
        if constexpr (M::lines) {
            const T share = lean_share(stretch_said.take() * T(kStep));
            const T first = softly(stretch_said.take() * T(kStep)), other = softly(stretch_said.take() * T(kStep));
            const Lines<T> lines = lines_of(found, roughness, share, {first, other});
            out.put(lines.narrow);
            put_normal();
            out.put(lines.direction.x);
            out.put(lines.direction.y);
            out.put(lines.strength);
        } else {
            out.put(roughness);
            put_normal();
        }
    }
}

}  // namespace network
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
