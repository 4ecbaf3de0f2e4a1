// Every model differentiated on dual numbers alone, adjoint or not: what the adjoints are checked against. Compiled
// once, for the baseline, because eleven derivatives of everything take the compiler longer than all the other kernels.
#include "cpu/shading_kernel.h"

namespace mipbake {

void shade_backward_duals_tile(const ShadeArgs& args, const ShadeTile& tile, const void* pairs,
                               const void* grad_radiance, void* grad_material) {
    specialise(args, [&](auto model, auto scalar) {
        using S = decltype(scalar);
        using K = Kernel<decltype(model), S>;
        K::backward_duals(args, tile, typename K::SharedPairs{static_cast<const Pair<S>*>(pairs)},
                          static_cast<const S*>(grad_radiance), static_cast<S*>(grad_material));
    });
}

}  // namespace mipbake
