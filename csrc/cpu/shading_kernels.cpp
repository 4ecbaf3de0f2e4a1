// The shading kernels, compiled once per instruction set.
#include "cpu/shading_kernel.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

template <class S>
void make_pairs(const ShadeArgs& args, std::int64_t b, std::int64_t k0, std::int64_t k1, Pair<S>* pairs) {
    const auto vector = [&](const StridedArray3& a, std::int64_t k) {
        const S* const v = row<S>(a, b, k);
        const std::int64_t s = a.strides[2];
        return Vec3<double>{static_cast<double>(v[0]), static_cast<double>(v[s]), static_cast<double>(v[2 * s])};
    };
    for (std::int64_t k = k0; k < k1; ++k) pairs[k - k0] = Pair<S>::of(vector(args.light, k), vector(args.view, k));
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
        Kernel<decltype(model), S>::forward(args, tile, static_cast<const Pair<S>*>(pairs), static_cast<S*>(radiance));
    });
}

void shade_backward_tile(const ShadeArgs& args, const ShadeTile& tile, const void* pairs, const void* grad_radiance,
                         void* grad_material) {
    specialise(args, [&](auto model, auto scalar) {
        using S = decltype(scalar);
        using K = Kernel<decltype(model), S>;
        const auto* const p = static_cast<const Pair<S>*>(pairs);
        const auto* const g = static_cast<const S*>(grad_radiance);
        if constexpr (decltype(model)::has_adjoint) {
            K::backward(args, tile, p, g, static_cast<S*>(grad_material));
        } else {
            K::backward_duals(args, tile, p, g, static_cast<S*>(grad_material));
        }
    });
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
