// One shading kernel: a model in a precision. Texels go in packets; a block of them is prepared once, then run over the
// light-view pairs. For the files that are compiled into kernels, and no other.
#pragma once

#include <algorithm>

#include "core/dual.h"
#include "core/packet.h"
#include "core/packet_series.h"
#include "cpu/shading.h"
#include "shading/models.h"
#include "shading/prepare.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
template <class S, class Array>
const S* row(const Array& a, std::int64_t i, std::int64_t j) {
    return static_cast<const S*>(a.data) + i * a.strides[0] + j * a.strides[1];
}

// One model in one precision.
template <class Model, class S>
struct Kernel {
    using P = Prepare<Model>;
    using T = typename Lanes<S>::Real;
    using W = typename Lanes<S>::Wide;
    static constexpr int C = Model::channels;
    static constexpr int lanes = Lanes<S>::count;
    static constexpr int packets = kTexelBlock / lanes;
    static_assert(kTexelBlock % lanes == 0, "a block is a whole number of packets");
    template <class A, class B>
    using Surface = typename Model::template Surface<A, B>;

    // The stored channels of the lanes from texel n on; lanes past the tile repeat its last texel.
    static void load_material(const ShadeArgs& args, const ShadeTile& tile, std::int64_t n, W (&channels)[C]) {
        S planes[C][lanes];
        const std::int64_t stride = args.material.strides[2];
        for (int lane = 0; lane < lanes; ++lane) {
            const S* const texel = row<S>(args.material, tile.b, n + lane < tile.n1 ? n + lane : tile.n1 - 1);
            for (int c = 0; c < C; ++c) planes[c][lane] = texel[c * stride];
        }
        for (int c = 0; c < C; ++c) channels[c] = load_widened(planes[c], W());
    }

    static void store_gradient(const ShadeArgs& args, const ShadeTile& tile, std::int64_t n, const T (&gradient)[C],
                               S* grad_material) {
        S planes[C][lanes];
        for (int c = 0; c < C; ++c) store_lanes(planes[c], gradient[c]);
        S* const out = grad_material + (tile.b * args.N + n) * C;
        const std::int64_t left = tile.n1 - n;
        for (int lane = 0; lane < lanes && lane < left; ++lane)
            for (int c = 0; c < C; ++c) out[lane * C + c] = planes[c][lane];
    }

    static Vec3<T> load_gradient(const S* data, std::int64_t texels) {
        if (texels >= lanes) return load_interleaved(data, T());
        S buffer[3 * lanes] = {};
        for (std::int64_t i = 0; i < 3 * texels; ++i) buffer[i] = data[i];
        return load_interleaved(buffer, T());
    }

    // A packet's triples of the next pair, a whole row of texels away, which no hardware foresees. Past the end it is
    // harmless.
    template <int for_writing>
    static MIPBAKE_INLINE void prefetch(const S* data) {
        for (std::size_t i = 0; i < 3 * lanes * sizeof(S); i += 64)
            MIPBAKE_PREFETCH_AT(reinterpret_cast<const char*>(data) + i, for_writing);
    }

    // Where the pair of a packet of texels comes from: one of all texels, worked out beforehand,
    struct SharedPairs {
        const Pair<S>* pairs;
        MIPBAKE_INLINE const Pair<S>& operator()(std::int64_t k, std::int64_t) const { return pairs[k]; }
    };
    // or the pair of each texel, worked out on the way. Lanes past the tile repeat its last texel.
    struct TexelPairs {
        const ShadeArgs& args;
        const ShadeTile& tile;
        MIPBAKE_INLINE Pair<S, W, T> operator()(std::int64_t k, std::int64_t n) const {
            return Pair<S, W, T>::of(load(args.light, k, n), load(args.view, k, n), TurnedAway::rule(args.black));
        }

      private:
        MIPBAKE_INLINE Vec3<T> load(const StridedDirections& a, std::int64_t k, std::int64_t n) const {
            const S* const first = row<S>(a, tile.b, k) + n * a.texel;
            const std::int64_t c = a.strides[2];
            if (a.texel == 3 && c == 1 && n + lanes <= tile.n1) {
                prefetch<0>(first + a.strides[1]);
                return load_interleaved(first, T());
            }
            S triples[3 * lanes];
            for (int lane = 0; lane < lanes; ++lane) {
                const S* const v = first + std::min<std::int64_t>(lane, tile.n1 - 1 - n) * a.texel;
                for (int i = 0; i < 3; ++i) triples[3 * lane + i] = v[i * c];
            }
            return load_interleaved(triples, T());
        }
    };

    template <class Pairs>
    static void forward(const ShadeArgs& args, const ShadeTile& tile, const Pairs& pair_of, S* radiance) {
        Surface<W, T> surfaces[packets];
        const int count = static_cast<int>((tile.n1 - tile.n0 + lanes - 1) / lanes);
        for (int i = 0; i < count; ++i) {
            W channels[C];
            load_material(args, tile, tile.n0 + i * lanes, channels);
            surfaces[i] = P::template surface<W, T>(channels);
        }
        const std::int64_t texels = tile.n1 - tile.n0;
        for (std::int64_t k = tile.k0; k < tile.k1; ++k) {
            S* const line = radiance + ((tile.b * args.K + k) * args.N + tile.n0) * 3;
            for (int i = 0; i < count; ++i) {
                prefetch<1>(line + args.N * 3 + i * lanes * 3);
                const auto& pair = pair_of(k, tile.n0 + i * lanes);
                const Vec3<T> f = Model::evaluate(surfaces[i], pair);
                if ((i + 1) * lanes <= texels) {
                    store_interleaved(line + i * lanes * 3, f);
                } else {
                    S buffer[3 * lanes];
                    store_interleaved(buffer, f);
                    for (std::int64_t j = 0; j < 3 * (texels - i * lanes); ++j) line[i * lanes * 3 + j] = buffer[j];
                }
            }
        }
    }

    template <class Pairs>
    static void backward(const ShadeArgs& args, const ShadeTile& tile, const Pairs& pair_of, const S* grad_radiance,
                         S* grad_material) {
        Surface<W, T> surfaces[packets];
        Surface<T, T> adjoints[packets];
        const int count = static_cast<int>((tile.n1 - tile.n0 + lanes - 1) / lanes);
        for (int i = 0; i < count; ++i) {
            W channels[C];
            load_material(args, tile, tile.n0 + i * lanes, channels);
            surfaces[i] = P::template surface<W, T>(channels);
            P::zip(adjoints[i], adjoints[i], [](T& a, T&) { a = T(0); });
        }
        const std::int64_t texels = tile.n1 - tile.n0;
        for (std::int64_t k = tile.k0; k < tile.k1; ++k) {
            const S* const line = grad_radiance + ((tile.b * args.K + k) * args.N + tile.n0) * 3;
            for (int i = 0; i < count; ++i) {
                prefetch<0>(line + args.N * 3 + i * lanes * 3);
                const Vec3<T> g = load_gradient(line + i * lanes * 3, texels - i * lanes);
                const auto& pair = pair_of(k, tile.n0 + i * lanes);
                Model::evaluate_adjoint(surfaces[i], pair, g, adjoints[i]);
            }
        }
        for (int i = 0; i < count; ++i) {
            W channels[C];
            T gradient[C];
            load_material(args, tile, tile.n0 + i * lanes, channels);
            P::pull_back(channels, adjoints[i], gradient);
            store_gradient(args, tile, tile.n0 + i * lanes, gradient, grad_material);
        }
    }

    template <class Pairs>
    static void backward_duals(const ShadeArgs& args, const ShadeTile& tile, const Pairs& pair_of,
                               const S* grad_radiance, S* grad_material) {
        using DW = Dual<W, C, T>;
        using DT = Dual<T, C, T>;
        for (std::int64_t n = tile.n0; n < tile.n1; n += lanes) {
            W channels[C];
            load_material(args, tile, n, channels);
            DW inputs[C];
            for (int c = 0; c < C; ++c) inputs[c] = DW::input(channels[c], c);
            const Surface<DW, DT> surface = P::template surface<DW, DT>(inputs);
            T gradient[C];
            for (T& g : gradient) g = T(0);
            for (std::int64_t k = tile.k0; k < tile.k1; ++k) {
                const S* const line = grad_radiance + ((tile.b * args.K + k) * args.N + n) * 3;
                const Vec3<T> g = load_gradient(line, tile.n1 - n);
                const Vec3<DT> f = Model::evaluate(surface, pair_of(k, n));
                for (int c = 0; c < C; ++c)
                    gradient[c] = gradient[c] + (g.x * f.x.d[c] + g.y * f.y.d[c] + g.z * f.z.d[c]);
            }
            store_gradient(args, tile, n, gradient, grad_material);
        }
    }
};

// Calls f(model, scalar) for the model and the precision of the call.
template <class F>
inline void specialise(const ShadeArgs& args, F f) {
    Models::visit(args.model, [&](auto model) {
        if (args.is_double) {
            f(model, double());
        } else {
            f(model, float());
        }
    });
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
