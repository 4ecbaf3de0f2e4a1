// The shading kernels, compiled once per instruction set.
#include "cpu/shading_kernel.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

template <class S>
void make_pairs(const ShadeArgs& args, std::int64_t b, std::int64_t k0, std::int64_t k1, Pair<S>* pairs) {
    const auto vector = [&](const StridedDirections& a, std::int64_t k) {
        const S* const v = row<S>(a, b, k);
        const std::int64_t s = a.strides[2];
        return Vec3<S>{v[0], v[s], v[2 * s]};
    };
    const TurnedAway rule = TurnedAway::rule(args.black);
    for (std::int64_t k = k0; k < k1; ++k)
        pairs[k - k0] = Pair<S>::of(vector(args.light, k), vector(args.view, k), rule);
}

}  // namespace

std::int64_t shade_pair_bytes(bool is_double) { return is_double ? sizeof(Pair<double>) : sizeof(Pair<float>); }

void shade_make_pairs(const ShadeArgs& args, std::int64_t b, std::int64_t k0, std::int64_t k1, void* pairs) {
    if (args.is_double) {
        make_pairs(args, b, k0, k1, static_cast<Pair<double>*>(pairs));
    } else {
        make_pairs(args, b, k0, k1, static_cast<Pair<float>*>(pairs));
    }
}

void shade_tile(const ShadeArgs& args, const ShadeTile& tile, const void* pairs, void* radiance) {
    specialise(args, [&](auto model, auto scalar) {
        using S = decltype(scalar);
        using K = Kernel<decltype(model), S>;
        auto* const out = static_cast<S*>(radiance);
        if (args.per_texel()) {
            K::forward(args, tile, typename K::TexelPairs{args, tile}, out);
        } else {
            K::forward(args, tile, typename K::SharedPairs{static_cast<const Pair<S>*>(pairs)}, out);
        }
    });
}

void shade_backward_tile(const ShadeArgs& args, const ShadeTile& tile, const void* pairs, const void* grad_radiance,
                         void* grad_material) {
    specialise(args, [&](auto model, auto scalar) {
        using S = decltype(scalar);
        using K = Kernel<decltype(model), S>;
        const auto* const g = static_cast<const S*>(grad_radiance);
        auto* const out = static_cast<S*>(grad_material);
        const typename K::SharedPairs shared{static_cast<const Pair<S>*>(pairs)};
        const typename K::TexelPairs of_texels{args, tile};
        if constexpr (decltype(model)::has_adjoint) {
            if (args.per_texel()) {
                K::backward(args, tile, of_texels, g, out);
            } else {
                K::backward(args, tile, shared, g, out);
            }
        } else {
            if (args.per_texel()) {
                K::backward_duals(args, tile, of_texels, g, out);
            } else {
                K::backward_duals(args, tile, shared, g, out);
            }
        }
    });
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
