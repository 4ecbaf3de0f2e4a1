// Between the pipeline in network.cpp, compiled once, and the kernels in network_kernels.cpp, compiled per instruction
// set. Planes: an image of some channels has one plane for each channel, rows of floats one after the other.
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops/networks.h"

namespace mipbake {

// Texels of a row that are decoded at once: a whole number of packets and of blocks of them in every instruction set.
constexpr int kChunk = 96;
// Rows of level 0 that are worked on together, and texels to a side of a tile of them: what the encoder holds of a tile
// stays in a core's second cache.
constexpr int kBand = 16, kTile = kChunk;
// Columns that are added up together: what a band has of them stays in a core's second cache.
constexpr int kColumns = 64;
// Floats that kernels may read and write behind the end of a row of a plane: one packet of any instruction set.
constexpr int kSlack = 16;

constexpr std::int64_t rounded_up(std::int64_t count, std::int64_t step) { return (count + step - 1) / step * step; }

// A layer, packed for the instruction set that is active: out = weight * in + bias.
struct PackedLayer {
    const float* weight;           // [block of outputs][input][output of the block]
    const float* bias;             // for all outputs of the blocks
    const std::int32_t* offsets;   // of each input from the place of a texel, in floats
    std::int64_t outputs, inputs;  // outputs of whole blocks; inputs with their taps
    bool rectified;
};

// What all kernels know of a network.
struct KernelNetwork {
    NetworkKind kind;
    int read, made;  // models, by their index
    NetworkLimits limits;
    std::int64_t moments, learned, detail, channels;
    int halo;
    // Planes of a tile: inputs, then what layers add. tile_stride: floats from row to row.
    std::int64_t tile_stride, tile_plane;
    const PackedLayer* encoder;
    int encoder_layers, convolutions;
    PackedLayer whiten, project;  // the former of latent networks alone
    const PackedLayer* decoder;   // the last of them makes what texels are corrected by
    int decoder_layers;
};

// Encodes rows [row, row + rows) and texels [column, column + columns) of level 0, which lie beyond its borders too.
struct EncodeTile {
    const float* stored;       // (H, W, R)
    std::int64_t width, read;  // W and R
    const std::int64_t* rows;  // the row of level 0 that stands at each row of the tile, halo included
    const std::int64_t* columns;
    int height, columns_count;  // without the halo
    float* const* out;          // a row of latents for each row of the tile: planes `plane` floats apart
    std::int64_t plane;
};

// Filters rows of latents around a row of level 0 and decodes a part of it.
struct TopTile {
    const float* const* around;  // 2 reach + 1 rows of latents
    std::int64_t from, plane;    // where in them the part begins, less reach
    const float *sharp, *plain;  // 2 reach + 1 and 2 reach - 1 taps
    int reach, count;            // texels
    const float* bias;           // of the decoder's layers, one after the other
    float* out;                  // (count, C)
};

// Texels of a coarser row from one whose channels lie side by side.
struct AcrossTile {
    const float* row;  // (n, stride)
    std::int64_t stride;
    const std::int32_t* index;   // (count, taps)
    const float *sharp, *plain;  // (count, taps)
    int taps, count;
    const float* bias;
    float* out;      // (count, C), decoded; or null, and
    float* latents;  // planes of latents, `plane` floats apart
    std::int64_t plane;
};

// A row of latents that is added to another: by `sharp`, and by `plain` to the further channels.
struct AddTap {
    const float* row;
    float sharp, plain;
};

// What taps add to a row of sums: `into` is `from`, or zeros where that is null, plus the taps in their order.
struct AddRow {
    const AddTap* taps;
    int count;
    const float* from;
    float* into;
};

// Columns of such rows. Channels [0, channels) are added by `sharp`, and `detail` further ones, of the first channels,
// by `plain`.
struct AddTile {
    const AddRow* rows;
    int rows_count;
    std::int64_t channels, detail, row_plane, sums_plane;
    std::int64_t begin, place, count;  // where the columns are in the rows that are added, and in the sums
};

MIPBAKE_FOR_EACH_ISA(NetworkCounts network_kernel_counts(NetworkKind kind, int read, int made);
                     // Outputs of a block, and the packed weights of a layer.
                     int network_block(); void network_pack(const float* weight, std::int64_t outputs,
                                                            std::int64_t inputs, std::int64_t blocks, float* packed);
                     std::int64_t network_encode_scratch(const KernelNetwork&);
                     void network_encode(const KernelNetwork&, const EncodeTile&, float* scratch);
                     std::int64_t network_decode_scratch(const KernelNetwork&, int reach);
                     void network_top(const KernelNetwork&, const TopTile&, float* scratch);
                     void network_across(const KernelNetwork&, const AcrossTile&, float* scratch);
                     void network_add(const AddTile&);
                     // (channels, plane) to (count, stride).
                     void network_transpose(const float* planes, std::int64_t plane, std::int64_t channels,
                                            std::int64_t count, float* out, std::int64_t stride);)

}  // namespace mipbake
