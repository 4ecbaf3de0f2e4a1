// Between the schedule of splats (splats.cpp, compiled once) and their kernel (splats_kernels.cpp, compiled once per
// instruction set).
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops/splats.h"

namespace mipbake {

constexpr int splat_tile_width = 16, splat_tile_height = 8;  // pixels; the width is that of the widest register
constexpr float least_alpha = 1 / 255.0f;                    // what is fainter is not drawn, and not listed

// The pixels that a splat may reach: columns [left, right), rows [bottom, top).
struct SplatBox {
    int left, right, bottom, top;
};

MIPBAKE_FOR_EACH_ISA(
    // The tile whose first pixel is (row, column), of `count` splats, nearest first; boxes are those of all splats.
    void draw_splats(const SplatArgs& args, const SplatBox* boxes, const std::int32_t* splats, std::int64_t count,
                     int row, int column);)

}  // namespace mipbake
