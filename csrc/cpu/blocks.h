// Between the schedule of block compression (blocks.cpp, compiled once) and its kernels (blocks_kernels.cpp, compiled
// once per instruction set).
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops.h"

namespace mipbake {

constexpr int bytes_of(BlockFormat format) { return format == BlockFormat::bc1 || format == BlockFormat::bc4 ? 8 : 16; }
constexpr int channels_of(BlockFormat format) {
    return format == BlockFormat::bc4 ? 1 : format == BlockFormat::bc5 ? 2 : 4;
}

MIPBAKE_FOR_EACH_ISA(
    // Blocks [begin, end), row by row.
    void encode_blocks(const BlockArgs& args, std::int64_t begin, std::int64_t end, std::uint8_t* blocks);)

}  // namespace mipbake
