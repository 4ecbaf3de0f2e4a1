// Between the schedule of interpolation (interpolate.cpp, compiled once) and its kernels (interpolate_kernels.cpp,
// compiled once per instruction set).
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "cpu/vertex_bins.h"
#include "ops/raster.h"

namespace mipbake {

MIPBAKE_FOR_EACH_ISA(
    // Pixels [begin, end) of batch item `item`. Returns whether every id and every vertex index was within the mesh;
    // pixels where they are not count as empty.
    template <class T> bool interpolate_pixels(const InterpolateArgs<T>& args, T* out, T* out_da, std::int64_t item,
                                               std::int64_t begin, std::int64_t end);
    // The gradients of a tile's pixels, and their contributions to the attributes unless `sums` is null.
    template <class T> void interpolate_backward_tile(const InterpolateArgs<T>& args, const InterpolateGrads<T>& grads,
                                                      const PixelTile& tile, TileSums<double>* sums);)

}  // namespace mipbake
