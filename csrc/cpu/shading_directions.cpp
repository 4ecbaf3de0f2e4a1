// The gradient of shading by lights and views, on dual numbers of six inputs. Compiled once, for the baseline, as
// shading_duals.cpp is.
#include "core/parallel.h"
#include "cpu/shading_kernel.h"

namespace mipbake {
namespace {

// Directions are of unit length, so what a gradient has along its direction means nothing, and is taken away.
template <class T>
Vec3<T> across(const Vec3<T>& gradient, const Vec3<T>& direction) {
    return gradient - direction * dot(gradient, direction);
}

template <class Model, class S>
struct DirectionKernel {
    using K = Kernel<Model, S>;
    using T = typename K::T;
    using W = typename K::W;
    using DT = Dual<T, 6>;
    using DW = Dual<W, 6, T>;
    static constexpr int C = K::C, lanes = K::lanes;

    static Vec3<T> load(const StridedDirections& a, const ShadeTile& tile, std::int64_t k, std::int64_t n) {
        const S* const first = row<S>(a, tile.b, k);
        S triples[3 * lanes];
        for (int lane = 0; lane < lanes; ++lane) {
            const S* const v = first + std::min(n + lane, tile.n1 - 1) * a.texel;
            for (int i = 0; i < 3; ++i) triples[3 * lane + i] = v[i * a.strides[2]];
        }
        return load_interleaved(triples, T());
    }

    static void store(const Vec3<T>& gradient, std::int64_t count, S* out) {
        S buffer[3 * lanes];
        store_interleaved(buffer, gradient);
        std::copy_n(buffer, 3 * std::min<std::int64_t>(count, lanes), out);
    }

    static void run(const ShadeArgs& args, const ShadeTile& tile, const S* grad_radiance, S* grad_light, S* grad_view) {
        for (std::int64_t n = tile.n0; n < tile.n1; n += lanes) {
            W channels[C];
            K::load_material(args, tile, n, channels);
            DW constants[C];
            for (int c = 0; c < C; ++c) {
                constants[c] = DW(0.0);
                constants[c].v = channels[c];
            }
            const auto surface = K::P::template surface<DW, DT>(constants);
            for (std::int64_t k = 0; k < args.K; ++k) {
                const Vec3<T> l = load(args.light, tile, k, n), v = load(args.view, tile, k, n);
                const auto pair = Pair<S, DW, DT>::of({DT::input(l.x, 0), DT::input(l.y, 1), DT::input(l.z, 2)},
                                                      {DT::input(v.x, 3), DT::input(v.y, 4), DT::input(v.z, 5)},
                                                      TurnedAway::rule(args.black));
                const Vec3<DT> f = Model::evaluate(surface, pair);
                const std::int64_t at = ((tile.b * args.K + k) * args.N + n) * 3;
                const Vec3<T> g = K::load_gradient(grad_radiance + at, tile.n1 - n);
                T by[6];
                for (int i = 0; i < 6; ++i) by[i] = g.x * f.x.d[i] + g.y * f.y.d[i] + g.z * f.z.d[i];
                store(across({by[0], by[1], by[2]}, l), tile.n1 - n, grad_light + at);
                store(across({by[3], by[4], by[5]}, v), tile.n1 - n, grad_view + at);
            }
        }
    }
};

}  // namespace

void shade_directions_backward_cpu(const ShadeArgs& args, const void* grad_radiance, void* grad_light,
                                   void* grad_view) {
    const std::int64_t blocks = (args.N + kTexelBlock - 1) / kTexelBlock;
    specialise(args, [&](auto model, auto scalar) {
        using S = decltype(scalar);
        parallel_for(args.B * blocks, 1, [&](std::int64_t begin, std::int64_t end) {
            for (std::int64_t i = begin; i < end; ++i) {
                const std::int64_t n0 = i % blocks * kTexelBlock;
                const ShadeTile tile{i / blocks, n0, std::min(args.N, n0 + kTexelBlock), 0, args.K};
                DirectionKernel<decltype(model), S>::run(args, tile, static_cast<const S*>(grad_radiance),
                                                         static_cast<S*>(grad_light), static_cast<S*>(grad_view));
            }
        });
    });
}

}  // namespace mipbake
