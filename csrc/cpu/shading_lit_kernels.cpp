// Points of a surface under directional lights, compiled once per instruction set. Points go in packets. Of each packet
// the surfaces are prepared once and stay in registers and the first cache while it runs over the lights; nothing of
// points times lights is ever stored.
#include "core/packet.h"
#include "core/packet_series.h"
#include "cpu/shading_lit.h"
#include "shading/models.h"
#include "shading/prepare.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

// Lights whose cosines are worked out before any is shaded.
constexpr int kLightsAtOnce = 64;

template <class Model, class S>
struct LitKernel {
    using P = Prepare<Model>;
    using T = typename Lanes<S>::Real;
    using W = typename Lanes<S>::Wide;
    using Seen = typename Model::template Seen<W, T>;
    static constexpr int C = Model::channels;
    static constexpr int lanes = Lanes<S>::count;

    // The points of the lanes from n on; lanes past n1 repeat the last one.
    static Seen load(const ShadeLitArgs& args, std::int64_t b, std::int64_t n, std::int64_t n1) {
        S material[C][lanes], frame[9][lanes], view[3][lanes];
        for (int lane = 0; lane < lanes; ++lane) {
            const std::int64_t at = n + lane < n1 ? n + lane : n1 - 1;
            const auto point = [&](const void* data, const std::int64_t* strides) {
                return static_cast<const S*>(data) + b * strides[0] + at * strides[1];
            };
            const S* const channels = point(args.material, args.material_strides);
            for (int c = 0; c < C; ++c) material[c][lane] = channels[c * args.material_strides[2]];
            const S* const axes = point(args.frame, args.frame_strides);
            for (int i = 0; i < 9; ++i)
                frame[i][lane] = axes[i / 3 * args.frame_strides[2] + i % 3 * args.frame_strides[3]];
            const S* const to_view = point(args.view, args.view_strides);
            for (int i = 0; i < 3; ++i) view[i][lane] = to_view[i * args.view_strides[2]];
        }
        W channels[C];
        for (int c = 0; c < C; ++c) channels[c] = load_widened(material[c], W());
        const auto vector = [](const S(*planes)[lanes]) {
            return Vec3<T>{load_lanes(planes[0]), load_lanes(planes[1]), load_lanes(planes[2])};
        };
        const Axes<T> axes = {vector(frame), vector(frame + 3), vector(frame + 6)};
        return Seen::of(P::template surface<W, T>(channels), axes, vector(view), TurnedAway::rule(args.black));
    }

    static T load_lanes(const S* data) {
        if constexpr (lanes == 1) {
            return T(*data);
        } else {
            return T::load(data);
        }
    }

    static Vec3<T> shade(const Seen& seen, const Light<S>* lights, std::int64_t count) {
        Vec3<T> sum = {T(0), T(0), T(0)};
        for (std::int64_t first = 0; first < count; first += kLightsAtOnce) {
            // About half of all lights are below the horizon of all the lanes. Those that are not are listed first,
            // without a branch, which would often be foreseen wrongly.
            const int some = static_cast<int>(count - first < kLightsAtOnce ? count - first : kLightsAtOnce);
            T cosines[kLightsAtOnce];
            int listed[kLightsAtOnce], used = 0;
            for (int i = 0; i < some; ++i) {
                const T cosine = seen.cosine(lights[first + i]);
                cosines[used] = cosine;
                listed[used] = i;
                used += any(Seen::lit(cosine)) ? 1 : 0;
            }
            for (int i = 0; i < used; ++i) seen.add(lights[first + listed[i]], cosines[i], sum);
        }
        return sum;
    }

    static void points(const ShadeLitArgs& args, std::int64_t b, std::int64_t n0, std::int64_t n1,
                       const Light<S>* lights, S* all) {
        S* const out = all + 3 * args.N * b;
        for (std::int64_t n = n0; n < n1; n += lanes) {
            const Vec3<T> sum = shade(load(args, b, n, n1), lights, args.K);
            if (n + lanes <= n1) {
                store_interleaved(out + 3 * n, sum);
            } else {
                S triples[3 * lanes];
                store_interleaved(triples, sum);
                for (std::int64_t i = 0; i < 3 * (n1 - n); ++i) out[3 * n + i] = triples[i];
            }
        }
    }
};

template <class S>
void make_lights(const ShadeLitArgs& args, Light<S>* lights) {
    for (std::int64_t k = 0; k < args.B * args.K; ++k) {
        const S* const l = static_cast<const S*>(args.light) + 3 * k;
        const S* const r = static_cast<const S*>(args.radiance) + 3 * k;
        lights[k].direction = {static_cast<double>(l[0]), static_cast<double>(l[1]), static_cast<double>(l[2])};
        lights[k].l = {l[0], l[1], l[2]};
        lights[k].radiance = {r[0], r[1], r[2]};
    }
}

}  // namespace

std::int64_t shade_light_bytes(bool is_double) { return is_double ? sizeof(Light<double>) : sizeof(Light<float>); }

void shade_make_lights(const ShadeLitArgs& args, void* lights) {
    if (args.is_double) {
        make_lights(args, static_cast<Light<double>*>(lights));
    } else {
        make_lights(args, static_cast<Light<float>*>(lights));
    }
}

void shade_points(const ShadeLitArgs& args, std::int64_t surface, std::int64_t n0, std::int64_t n1, const void* lights,
                  void* out) {
    Models::visit(args.model, [&](auto model) {
        using M = decltype(model);
        if (args.is_double) {
            LitKernel<M, double>::points(args, surface, n0, n1, static_cast<const Light<double>*>(lights),
                                         static_cast<double*>(out));
        } else {
            LitKernel<M, float>::points(args, surface, n0, n1, static_cast<const Light<float>*>(lights),
                                        static_cast<float*>(out));
        }
    });
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
