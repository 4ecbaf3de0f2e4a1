// What the core offers for compressed blocks of texels.
#pragma once

#include <cstdint>

namespace mipbake {

enum class BlockFormat { bc1, bc2, bc3, bc4, bc5, bc7, uastc };

// Of a block, and of the texels that it is made of and gives.
constexpr int bytes_of(BlockFormat format) { return format == BlockFormat::bc1 || format == BlockFormat::bc4 ? 8 : 16; }
constexpr int channels_of(BlockFormat format) {
    return format == BlockFormat::bc4 ? 1 : format == BlockFormat::bc5 ? 2 : 4;
}

// Values are finite, what a file holds from 0 to 1. Weights, of at least 0, are what a squared error of each counts;
// all count the same where there are none.
struct BlockArgs {
    BlockFormat format;  // bc1, bc4, bc5, bc7 or uastc
    std::int64_t height, width;
    const float* values;   // (height, width, channels_of(format))
    const float* weights;  // as many, or null
};

// Blocks of 4 x 4 texels, row by row. Texels beyond the borders repeat those at them. Endpoints and indices are sought
// for the least sum of weighted squared errors of what decoders give. bc1 leaves alpha out; bc7 and uastc keep the
// alpha of opaque blocks. bc4 and bc5 count on decoders that do not round to 8 bits.
void encode_blocks_cpu(const BlockArgs& args, std::uint8_t* blocks);

// `values` (height, width, channels_of(format)): what graphics cards give, from 0 to 1.
void decode_blocks_cpu(BlockFormat format, std::int64_t height, std::int64_t width, const std::uint8_t* blocks,
                       float* values);

}  // namespace mipbake
