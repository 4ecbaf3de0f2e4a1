// Between the schedule of block compression (blocks.cpp, compiled once) and its kernels (blocks_kernels.cpp, compiled
// once per instruction set).
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops/blocks.h"

namespace mipbake {

MIPBAKE_FOR_EACH_ISA(
    // Blocks [begin, end), row by row.
    void encode_blocks(const BlockArgs& args, std::int64_t begin, std::int64_t end, std::uint8_t* blocks);)

}  // namespace mipbake
