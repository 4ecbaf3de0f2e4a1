// Between the dispatch in shading.cpp, compiled once, and the kernels in shading_kernels.cpp, compiled per instruction
// set.
#pragma once

#include "core/isa.h"
#include "ops/shading.h"

namespace mipbake {

// Texels [n0, n1) of batch element b, for pairs [k0, k1). Alignment of n0: kTexelBlock.
struct ShadeTile {
    std::int64_t b, n0, n1, k0, k1;
};

// Texels that a kernel prepares before it runs over the pairs: whole packets for every instruction set.
constexpr int kTexelBlock = 64;

// `pairs` points to the pairs of the tile's batch element: Pair<S>[K], shade_pair_bytes each, laid out alike in every
// instruction set. It is not read where texels have directions of their own.
MIPBAKE_FOR_EACH_ISA(std::int64_t shade_pair_bytes(bool is_double);
                     void shade_make_pairs(const ShadeArgs&, std::int64_t b, std::int64_t k0, std::int64_t k1,
                                           void* pairs);
                     void shade_tile(const ShadeArgs&, const ShadeTile&, const void* pairs, void* radiance);
                     void shade_backward_tile(const ShadeArgs&, const ShadeTile&, const void* pairs,
                                              const void* grad_radiance, void* grad_material);)

// shade_backward_tile on dual numbers, for the baseline alone.
void shade_backward_duals_tile(const ShadeArgs& args, const ShadeTile& tile, const void* pairs,
                               const void* grad_radiance, void* grad_material);

}  // namespace mipbake
