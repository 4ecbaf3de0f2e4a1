#include "cpu/blocks.h"

#include <algorithm>
#include <cstring>

#include "blocks/astc_levels.h"
#include "blocks/layout.h"
#include "blocks/uastc.h"
#include "core/parallel.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

constexpr Index kBlocksAtOnce = 256;  // a part of the loop: some tenths of a millisecond

// 4 x 4 texels of up to four channels, from 0 to 255.
using Texels = float[kTexels][4];

void decode_ramp(const std::uint8_t* block, int channel, Texels& out) {
    const float first = block[0], second = block[1];
    std::uint64_t codes = 0;
    for (int i = 0; i < 6; ++i) codes |= static_cast<std::uint64_t>(block[2 + i]) << 8 * i;
    const int steps = block[0] > block[1] ? 7 : 5;
    for (int i = 0; i < kTexels; ++i) {
        const int code = static_cast<int>(codes >> 3 * i & 7);
        float value = code == 0 ? first : second;
        if (code > steps)
            value = code == 6 ? 0.0f : 255.0f;
        else if (code > 1)
            value = (first * static_cast<float>(steps + 1 - code) + second * static_cast<float>(code - 1)) /
                    static_cast<float>(steps);
        out[i][channel] = value;
    }
}

// The colours of BC1, and of BC2 and BC3, which always have four.
void decode_colours(const std::uint8_t* block, bool always_four, Texels& out) {
    const unsigned ends[2] = {block[0] | block[1] * 256u, block[2] | block[3] * 256u};
    float colour[4][4] = {};
    for (int end = 0; end < 2; ++end) {
        const unsigned r = ends[end] >> 11, g = ends[end] >> 5 & 63, b = ends[end] & 31;
        colour[end][0] = static_cast<float>(r << 3 | r >> 2);
        colour[end][1] = static_cast<float>(g << 2 | g >> 4);
        colour[end][2] = static_cast<float>(b << 3 | b >> 2);
    }
    const bool four = always_four || ends[0] > ends[1];
    for (int c = 0; c < 3; ++c) {
        const float a = colour[0][c], b = colour[1][c];
        colour[2][c] = four ? (2 * a + b) / 3 : (a + b) / 2;
        colour[3][c] = four ? (a + 2 * b) / 3 : 0;
    }
    for (int code = 0; code < 4; ++code) colour[code][3] = code == 3 && !four ? 0.0f : 255.0f;
    for (int i = 0; i < kTexels; ++i) std::memcpy(out[i], colour[block[4 + i / 4] >> 2 * (i % 4) & 3], sizeof out[i]);
}

// Bits that make eight.
int whole_byte(unsigned code, int bits) {
    const unsigned high = code << (8 - bits);
    return static_cast<int>(high | high >> bits);
}

void decode_bc7(const std::uint8_t* block, Texels& out) {
    Bits bits;
    std::memcpy(bits.bytes(), block, 16);
    int number = 0;
    while (number < 8 && bits.take(1) == 0) ++number;
    if (number == 8) {  // no mode: transparent black
        std::memset(out, 0, sizeof out);
        return;
    }
    const Mode& mode = kModes[number];
    const int partition = static_cast<int>(bits.take(mode.partition_bits));
    const int rotation = static_cast<int>(bits.take(mode.rotation_bits));
    const bool selector = bits.take(mode.selector_bits) != 0;
    unsigned code[3][2][4] = {};
    const int channels = mode.alpha_bits ? 4 : 3;
    for (int c = 0; c < channels; ++c)
        for (int s = 0; s < mode.subsets; ++s)
            for (int end = 0; end < 2; ++end) code[s][end][c] = bits.take(c == 3 ? mode.alpha_bits : mode.colour_bits);
    int ends[3][2][4];
    for (int s = 0; s < mode.subsets; ++s) {
        unsigned parity = 0;
        for (int end = 0; end < 2; ++end) {
            if (mode.parity == Parity::each || (mode.parity == Parity::shared && end == 0)) parity = bits.take(1);
            for (int c = 0; c < 4; ++c) {
                const int stored = c == 3 ? mode.alpha_bits : mode.colour_bits;
                const bool has = mode.parity != Parity::none;
                ends[s][end][c] = stored == 0 ? 255
                                  : has       ? whole_byte(code[s][end][c] << 1 | parity, stored + 1)
                                              : whole_byte(code[s][end][c], stored);
            }
        }
    }
    int index[2][kTexels] = {};
    for (int i = 0; i < kTexels; ++i)
        index[0][i] = static_cast<int>(bits.take(mode.index_bits - is_anchor(mode.subsets, partition, i)));
    if (mode.second_bits)
        for (int i = 0; i < kTexels; ++i) index[1][i] = static_cast<int>(bits.take(mode.second_bits - (i == 0)));
    for (int i = 0; i < kTexels; ++i) {
        const auto& range = ends[subset_of(mode.subsets, partition, i)];
        for (int c = 0; c < 4; ++c) {
            const int list = mode.second_bits && (c == 3) != selector ? 1 : 0;
            const int share = share_of(index[list][i], list ? mode.second_bits : mode.index_bits);
            out[i][c] = static_cast<float>((range[0][c] * (64 - share) + range[1][c] * share + 32) >> 6);
        }
        if (rotation > 0) std::swap(out[i][rotation - 1], out[i][3]);
    }
}

// Numbers as put_numbers of blocks_kernels.cpp stores them.
void take_numbers(const AstcRange& range, int* codes, int count, Bits& bits) {
    const unsigned base = range.trits ? 3 : 5;
    const int group = range.trits ? 5 : 3;
    std::fill(codes, codes + count, 0);
    if (range.trits || range.quints)
        for (int first = 0; first < count; first += group) {
            const int last = std::min(first + group, count);
            unsigned sum = bits.take(last - first == group ? (range.trits ? 8 : 7)
                                                           : bits_of_digits(last - first, range.quints != 0));
            for (int i = first; i < last; ++i, sum /= base) codes[i] = static_cast<int>(sum % base) << range.bits;
        }
    for (int i = 0; i < count; ++i) codes[i] |= static_cast<int>(bits.take(range.bits));
}

void decode_uastc(const std::uint8_t* block, Texels& out) {
    Bits bits;
    std::memcpy(bits.bytes(), block, 16);
    int number = 0;
    const unsigned start = block[0];
    while (number < kUastcModes && (start & ((1u << kUastc[number].prefix_bits) - 1)) != kUastc[number].prefix)
        ++number;
    if (number == kUastcModes) {  // no mode: transparent black
        std::memset(out, 0, sizeof out);
        return;
    }
    const UastcMode& mode = kUastc[number];
    bits.take(mode.prefix_bits);
    if (number == kUastcSolid) {
        float colour[4];
        for (float& each : colour) each = static_cast<float>(bits.take(8));
        for (auto& texel : out) std::memcpy(texel, colour, sizeof texel);
        return;
    }
    bits.take(mode.bc1_hints + 8 + mode.bias_bits);
    if (mode.channels != 3) bits.take(8);
    int partition = 0, alone = 4;
    if (mode.subsets > 1) partition = static_cast<int>(bits.take(number == 3 ? 4 : 5));
    const int partitions = number == 3 ? 11 : number == 7 ? 19 : 30;
    partition = std::min(partition, partitions - 1);  // broken blocks name others
    if (mode.planes == 2) alone = mode.channels == 2 ? 1 : static_cast<int>(bits.take(2));
    int codes[18], value[3][4][2] = {}, at = 0;
    take_numbers(kAstcRanges[mode.range], codes, 2 * mode.channels * mode.subsets, bits);
    for (int s = 0; s < mode.subsets; ++s)
        for (int c = 0; c < mode.channels; ++c)
            for (int end = 0; end < 2; ++end) value[s][c][end] = astc_value(kAstcRanges[mode.range], codes[at++]);
    for (int i = 0; i < kTexels; ++i) {
        const auto& ends = value[uastc_subset(number, partition, i)];
        int share[2] = {};
        for (int plane = 0; plane < mode.planes; ++plane) {
            const int index = static_cast<int>(bits.take(mode.index_bits - is_uastc_anchor(number, partition, i)));
            int whole = 0;  // its bits, repeated to six
            for (int shift = 6 - mode.index_bits; shift > -mode.index_bits; shift -= mode.index_bits)
                whole |= shift >= 0 ? index << shift : index >> -shift;
            share[plane] = whole > 32 ? whole + 1 : whole;
        }
        for (int c = 0; c < 4; ++c) {
            const int from = mode.channels == 2 ? (c == 3 ? 1 : 0) : c;  // luminance and alpha
            if (from >= mode.channels) {
                out[i][c] = 255;
                continue;
            }
            const int part = share[from == alone ? 1 : 0];
            out[i][c] =
                static_cast<float>(((257 * (ends[from][0] * (64 - part) + ends[from][1] * part) + 32) >> 6) >> 8);
        }
    }
}

void decode_block(BlockFormat format, const std::uint8_t* block, Texels& out) {
    switch (format) {
        case BlockFormat::bc1:
            decode_colours(block, false, out);
            break;
        case BlockFormat::bc2:
            decode_colours(block + 8, true, out);
            for (int i = 0; i < kTexels; ++i) out[i][3] = 17.0f * static_cast<float>(block[i / 2] >> 4 * (i % 2) & 15);
            break;
        case BlockFormat::bc3:
            decode_colours(block + 8, true, out);
            decode_ramp(block, 3, out);
            break;
        case BlockFormat::bc4:
            decode_ramp(block, 0, out);
            break;
        case BlockFormat::bc5:
            decode_ramp(block, 0, out);
            decode_ramp(block + 8, 1, out);
            break;
        case BlockFormat::bc7:
            decode_bc7(block, out);
            break;
        case BlockFormat::uastc:
            decode_uastc(block, out);
            break;
    }
}

}  // namespace

void encode_blocks_cpu(const BlockArgs& args, std::uint8_t* blocks) {
    const Index count = (args.height + 3) / 4 * ((args.width + 3) / 4);
    parallel_for(count, kBlocksAtOnce,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(encode_blocks)(args, begin, end, blocks); });
}

void decode_blocks_cpu(BlockFormat format, Index height, Index width, const std::uint8_t* blocks, float* values) {
    const Index columns = (width + 3) / 4, channels = channels_of(format);
    parallel_for((height + 3) / 4 * columns, kBlocksAtOnce, [&](Index begin, Index end) {
        for (Index block = begin; block < end; ++block) {
            Texels texels;
            decode_block(format, blocks + block * bytes_of(format), texels);
            const Index top = block / columns * 4, left = block % columns * 4;
            for (Index y = top; y < std::min(top + 4, height); ++y)
                for (Index x = left; x < std::min(left + 4, width); ++x)
                    for (Index c = 0; c < channels; ++c)
                        values[(y * width + x) * channels + c] = texels[(y - top) * 4 + x - left][c] / 255.0f;
        }
    });
}

}  // namespace mipbake
