// Between the dispatch in rasterize.cpp, compiled once, and the kernels in the files rasterize_*kernels.cpp, compiled
// per instruction set.
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "cpu/vertex_bins.h"
#include "ops/raster.h"
#include "raster/box.h"

namespace mipbake {

// The image is drawn in tiles that stay in a core's cache, with their depths and their triangles.
constexpr int kRasterTile = 64;

// Triangles [begin, end), counted from `first` in tri, of a batch item.
struct BoxTask {
    std::int64_t item, first, begin, end;
    PixelBox* boxes;         // of the item's triangles, from its first
    float* nearest;          // a lower bound of z/w over each
    std::uint32_t* touched;  // of each tile of the item: increased by the triangles whose boxes meet it
};

// Draws one tile of a batch item: `list` names the triangles whose boxes meet it, counted from `first`, in their order.
struct TileTask {
    std::int64_t item, first;
    int x0, y0, x1, y1;
    const std::uint32_t* list;
    std::uint32_t* sorted;  // scratch as long as the list
    std::int64_t size;
    const PixelBox* boxes;
    const float* nearest;
};

MIPBAKE_FOR_EACH_ISA(
    template <class T> void raster_boxes(const RasterizeArgs<T>&, const BoxTask&);
    template <class T> void raster_tile(const RasterizeArgs<T>&, const TileTask&);
    // Returns the first pixel of the tile, counted in all of rast, with a triangle that does not exist, or -1.
    template <class T>
    std::int64_t raster_backward_tile(const RasterizeBackwardArgs<T>&, const PixelTile&, TileSums<double>&);)

}  // namespace mipbake
