#include <algorithm>
#include <cmath>
#include <cstring>

#include "blocks/bc7.h"
#include "blocks/ramp.h"
#include "blocks/uastc.h"
#include "cpu/blocks.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;
using P = typename Lanes<float>::Real;
constexpr int kLanes = Lanes<float>::count;

#ifdef MIPBAKE_WASM_BAKES
constexpr bool kEvery = false;  // the npm package's module is downloaded, and has UASTC alone
#else
constexpr bool kEvery = true;
#endif

// The numbers of a packet, as whole ones.
struct Whole {
    int lane[kLanes];
    explicit Whole(const P& p) {
        float numbers[kLanes];
        store_lanes(numbers, p);
        for (int i = 0; i < kLanes; ++i) lane[i] = static_cast<int>(numbers[i]);
    }
};

template <int C>
struct Texels {
    P value[C][kTexels], weight[C][kTexels];

    // Blocks from `first` on; lanes behind the last one hold it again, and texels beyond a border those at it.
    Texels(const BlockArgs& args, Index first, Index end) {
        constexpr float kLeast = 1e-12f;  // so that no division is by 0
        const Index columns = (args.width + 3) / 4;
        float values[C][kTexels][kLanes], weights[C][kTexels][kLanes];
        for (int lane = 0; lane < kLanes; ++lane) {
            const Index block = std::min(first + lane, end - 1), top = block / columns * 4, left = block % columns * 4;
            for (int i = 0; i < kTexels; ++i) {
                const Index y = std::min(top + i / 4, args.height - 1), x = std::min(left + i % 4, args.width - 1);
                const Index at = (y * args.width + x) * C;
                for (int c = 0; c < C; ++c) {
                    values[c][i][lane] = 255.0f * std::min(std::max(args.values[at + c], 0.0f), 1.0f);
                    weights[c][i][lane] = args.weights ? std::max(args.weights[at + c], kLeast) : 1.0f;
                }
            }
        }
        std::memcpy(value, values, sizeof values);
        std::memcpy(weight, weights, sizeof weights);
    }

    void of_lane(int lane, float (&out)[kTexels][C]) const {
        for (int c = 0; c < C; ++c)
            for (int i = 0; i < kTexels; ++i) {
                float lanes[kLanes];
                store_lanes(lanes, value[c][i]);
                out[i][c] = lanes[lane];
            }
    }
};

void put(const Ramp<P>& ramp, Index count, int stride, std::uint8_t* out) {
    const Whole first(ramp.first), second(ramp.second);
    Bits bits[kLanes];
    for (int lane = 0; lane < kLanes; ++lane) {
        bits[lane].put(static_cast<unsigned>(first.lane[lane]), 8);
        bits[lane].put(static_cast<unsigned>(second.lane[lane]), 8);
    }
    for (const P& code : ramp.code) {
        const Whole codes(code);
        for (int lane = 0; lane < kLanes; ++lane) bits[lane].put(static_cast<unsigned>(codes.lane[lane]), 3);
    }
    for (Index lane = 0; lane < count; ++lane) std::memcpy(out + lane * stride, bits[lane].bytes(), 8);
}

// BC1 with four colours, which the order of the endpoints means: the greater one first.
void put(const Line<P, 3>& line, Index count, std::uint8_t* out) {
    constexpr unsigned from_low[4] = {1, 3, 2, 0};  // codes of steps from the second endpoint to the first
    unsigned ends[2][kLanes] = {}, codes[kLanes] = {};
    for (int end = 0; end < 2; ++end)
        for (int c = 0; c < 3; ++c) {
            const Whole code(line.code[end][c]);
            for (int lane = 0; lane < kLanes; ++lane)
                ends[end][lane] = ends[end][lane] << (c == 1 ? 6 : 5) | static_cast<unsigned>(code.lane[lane]);
        }
    for (int i = 0; i < kTexels; ++i) {
        const Whole index(line.index[i]);
        for (int lane = 0; lane < kLanes; ++lane) {
            const int step = index.lane[lane];
            const bool turned = ends[0][lane] > ends[1][lane];
            const unsigned code = ends[0][lane] == ends[1][lane] ? 0 : from_low[turned ? 3 - step : step];
            codes[lane] |= code << 2 * i;
        }
    }
    for (Index lane = 0; lane < count; ++lane) {
        Bits bits;
        bits.put(std::max(ends[0][lane], ends[1][lane]), 16);
        bits.put(std::min(ends[0][lane], ends[1][lane]), 16);
        bits.put(codes[lane], 32);
        std::memcpy(out + lane * 8, bits.bytes(), 8);
    }
}

// The numbers of one block of a format with modes.
struct Block {
    int mode, partition, alone, selector;
    int code[2][2][4], index[kTexels], second[kTexels];
};

void spread(const BlockChoice<P>& choice, Block (&blocks)[kLanes]) {
    const auto to = [&](const P& numbers, auto&& field) {
        const Whole whole(numbers);
        for (int lane = 0; lane < kLanes; ++lane) field(blocks[lane]) = whole.lane[lane];
    };
    to(choice.mode, [](Block& b) -> int& { return b.mode; });
    to(choice.partition, [](Block& b) -> int& { return b.partition; });
    to(choice.alone, [](Block& b) -> int& { return b.alone; });
    to(choice.selector, [](Block& b) -> int& { return b.selector; });
    for (int s = 0; s < 2; ++s)
        for (int end = 0; end < 2; ++end)
            for (int c = 0; c < 4; ++c) to(choice.code[s][end][c], [=](Block& b) -> int& { return b.code[s][end][c]; });
    for (int i = 0; i < kTexels; ++i) {
        to(choice.index[i], [=](Block& b) -> int& { return b.index[i]; });
        to(choice.second[i], [=](Block& b) -> int& { return b.second[i]; });
    }
}

// Turns a line round, of channels that `is_of` names, where the index of the anchor of its subset has the highest bit,
// which is not stored.
template <class Subset, class Anchor, class Of>
void turn(Block& block, int subset, int* index, int bits, Subset&& subset_of_texel, Anchor&& is_anchor_texel,
          Of&& is_of) {
    const int most = (1 << bits) - 1;
    for (int i = 0; i < kTexels; ++i)
        if (subset_of_texel(i) == subset && is_anchor_texel(i) && 2 * index[i] < most) return;
    for (int i = 0; i < kTexels; ++i)
        if (subset_of_texel(i) == subset) index[i] = most - index[i];
    for (int c = 0; c < 4; ++c)
        if (is_of(c)) std::swap(block.code[subset][0][c], block.code[subset][1][c]);
}

void put_bc7(Block& block, std::uint8_t* out) {
    const Mode& mode = kModes[block.mode];
    const int parity = mode.parity == Parity::none ? 0 : 1, partition = mode.subsets == 1 ? 0 : block.partition;
    const bool apart = mode.second_bits != 0, selector = mode.selector_bits != 0 && block.selector != 0;
    const auto subset = [&](int i) { return subset_of(mode.subsets, partition, i); };
    const auto anchor = [&](int i) { return is_anchor(mode.subsets, partition, i); };
    for (int s = 0; s < mode.subsets; ++s)
        turn(block, s, block.index, selector ? mode.second_bits : mode.index_bits, subset, anchor,
             [&](int c) { return !apart || c != block.alone; });
    if (apart) {
        turn(block, 0, block.second, selector ? mode.index_bits : mode.second_bits, subset, anchor,
             [&](int c) { return c == block.alone; });
        for (auto& end : block.code[0]) std::swap(end[block.alone], end[3]);
    }
    Bits bits;
    bits.put(1u << block.mode, block.mode + 1);
    bits.put(static_cast<unsigned>(partition), mode.partition_bits);
    bits.put(static_cast<unsigned>((block.alone + 1) % 4), mode.rotation_bits);
    bits.put(selector ? 1 : 0, mode.selector_bits);
    for (int c = 0; c < (mode.alpha_bits ? 4 : 3); ++c)
        for (int s = 0; s < mode.subsets; ++s)
            for (int end = 0; end < 2; ++end)
                bits.put(static_cast<unsigned>(block.code[s][end][c] >> parity),
                         c == 3 ? mode.alpha_bits : mode.colour_bits);
    if (parity)
        for (int s = 0; s < mode.subsets; ++s)
            for (int end = 0; end < (mode.parity == Parity::each ? 2 : 1); ++end)
                bits.put(static_cast<unsigned>(block.code[s][end][0] & 1), 1);
    const int* const shorter = selector ? block.second : block.index;
    const int* const longer = selector ? block.index : block.second;
    for (int i = 0; i < kTexels; ++i) bits.put(static_cast<unsigned>(shorter[i]), mode.index_bits - anchor(i));
    if (apart)
        for (int i = 0; i < kTexels; ++i) bits.put(static_cast<unsigned>(longer[i]), mode.second_bits - (i == 0));
    std::memcpy(out, bits.bytes(), 16);
}

// How ETC1 is best made of the texels of a block: which halves have a colour of their own, whether their colours are
// stored as a difference, and how far texels lie from them.
struct EtcHints {
    unsigned flip = 0, difference = 1, tables[2] = {};
};

EtcHints etc_hints(const float (&texels)[kTexels][4]) {
    constexpr float steps[8][2] = {{2, 8}, {5, 17}, {9, 29}, {13, 42}, {18, 60}, {24, 80}, {33, 106}, {47, 183}};
    EtcHints best;
    float least = 1e30f;
    for (unsigned flip = 0; flip < 2; ++flip) {
        EtcHints hints;
        hints.flip = flip;
        float error = 0, mean[2][3] = {};
        const auto half = [&](int i) { return flip ? i / 8 : i % 4 / 2; };
        for (int i = 0; i < kTexels; ++i)
            for (int c = 0; c < 3; ++c) mean[half(i)][c] += texels[i][c] / 8;
        for (int c = 0; c < 3; ++c) {
            const float apart = std::round(mean[1][c] * (31 / 255.0f)) - std::round(mean[0][c] * (31 / 255.0f));
            if (apart < -4 || apart > 3) hints.difference = 0;
        }
        for (int side = 0; side < 2; ++side) {
            float nearest_table = 1e30f;
            for (unsigned table = 0; table < 8; ++table) {
                float sum = 0;
                for (int i = 0; i < kTexels; ++i) {
                    if (half(i) != side) continue;
                    float off = 0;
                    for (int c = 0; c < 3; ++c) off += (texels[i][c] - mean[side][c]) / 3;
                    const float size = std::abs(off);
                    sum += std::min(square(size - steps[table][0]), square(size - steps[table][1]));
                }
                if (sum < nearest_table) {
                    nearest_table = sum;
                    hints.tables[side] = table;
                }
            }
            error += nearest_table;
            for (int i = 0; i < kTexels; ++i)
                if (half(i) == side)
                    for (int c = 0; c < 3; ++c) error += square(texels[i][c] - mean[side][c]);
        }
        if (error < least) {
            least = error;
            best = hints;
        }
    }
    return best;
}

void put_hints(const UastcMode& mode, const float (&texels)[kTexels][4], Bits& bits) {
    constexpr unsigned kNoBias = 13, kTable = 2;  // a table of nearly even steps, 25 from the least to the greatest
    const EtcHints hints = etc_hints(texels);
    bits.put(0, mode.bc1_hints);
    bits.put(hints.flip, 1);
    bits.put(hints.difference, 1);
    for (unsigned table : hints.tables) bits.put(table, 3);
    bits.put(kNoBias, mode.bias_bits);
    if (mode.channels == 4) {
        float low = 255, high = 0;
        for (const auto& texel : texels) {
            low = std::min(low, texel[3]);
            high = std::max(high, texel[3]);
        }
        const unsigned factor = static_cast<unsigned>(std::min(std::max(std::round((high - low) / 25), 1.0f), 15.0f));
        bits.put(kTable | factor << 4, 8);
    }
}

void put_solid(const Block& block, Bits& bits) {
    const int* const colour = block.code[0][0];
    for (int c = 0; c < 4; ++c) bits.put(static_cast<unsigned>(colour[c]), 8);
    // Of ETC1: a difference of colours, the first table, its third step (2 of 255), and five bits of each colour.
    bits.put(1 | 0 << 1 | 2 << 4, 6);
    for (int c = 0; c < 3; ++c) {
        const float low = std::max(static_cast<float>(colour[c]) - 2, 0.0f);
        bits.put(static_cast<unsigned>(std::round(low * (31 / 255.0f))), 5);
    }
}

// Numbers of bits and trits or quints: digits first, five trits or three quints together, then bits.
void put_numbers(const AstcRange& range, const int* codes, int count, Bits& bits) {
    const int base = range.trits ? 3 : 5, group = range.trits ? 5 : 3;
    if (range.trits || range.quints)
        for (int first = 0; first < count; first += group) {
            const int last = std::min(first + group, count);
            unsigned sum = 0;
            for (int i = last; i-- > first;)
                sum = sum * static_cast<unsigned>(base) + static_cast<unsigned>(codes[i] >> range.bits);
            bits.put(sum,
                     last - first == group ? (range.trits ? 8 : 7) : bits_of_digits(last - first, range.quints != 0));
        }
    for (int i = 0; i < count; ++i) bits.put(static_cast<unsigned>(codes[i] & ((1 << range.bits) - 1)), range.bits);
}

void put_uastc(Block& block, const float (&texels)[kTexels][4], std::uint8_t* out) {
    const UastcMode& mode = kUastc[block.mode];
    Bits bits;
    bits.put(mode.prefix, mode.prefix_bits);
    if (block.mode == kUastcSolid) {
        put_solid(block, bits);
        std::memcpy(out, bits.bytes(), 16);
        return;
    }
    put_hints(mode, texels, bits);
    const auto subset = [&](int i) { return uastc_subset(block.mode, block.partition, i); };
    const auto anchor = [&](int i) { return is_uastc_anchor(block.mode, block.partition, i); };
    const bool apart = mode.planes == 2;
    if (mode.subsets == 2) bits.put(static_cast<unsigned>(block.partition), 5);
    if (apart) bits.put(static_cast<unsigned>(block.alone), 2);
    for (int s = 0; s < mode.subsets; ++s)
        turn(block, s, block.index, mode.index_bits, subset, anchor, [&](int c) { return !apart || c != block.alone; });
    if (apart) turn(block, 0, block.second, mode.index_bits, subset, anchor, [&](int c) { return c == block.alone; });
    int codes[16], count = 0;
    for (int s = 0; s < mode.subsets; ++s)
        for (int c = 0; c < mode.channels; ++c)
            for (int end = 0; end < 2; ++end) codes[count++] = kAstcLevels[mode.range].code[block.code[s][end][c]];
    put_numbers(kAstcRanges[mode.range], codes, count, bits);
    for (int i = 0; i < kTexels; ++i) {
        bits.put(static_cast<unsigned>(block.index[i]), mode.index_bits - anchor(i));
        if (apart) bits.put(static_cast<unsigned>(block.second[i]), mode.index_bits - anchor(i));
    }
    std::memcpy(out, bits.bytes(), 16);
}

}  // namespace

void encode_blocks(const BlockArgs& args, Index begin, Index end, std::uint8_t* blocks) {
    for (Index at = begin; at < end; at += kLanes) {
        const Index count = std::min<Index>(kLanes, end - at);
        std::uint8_t* const out = blocks + at * bytes_of(args.format);
        const bool bc7 = kEvery && args.format == BlockFormat::bc7;
        if (!kEvery || bc7 || args.format == BlockFormat::uastc) {
            Texels<4> texels(args, at, end);
            Block found[kLanes];
            if (bc7)
                spread(Bc7Fitter<P>(texels.value, texels.weight).fit(), found);
            else
                spread(UastcFitter<P>(texels.value, texels.weight).fit(), found);
            for (Index lane = 0; lane < count; ++lane) {
                if (bc7) {
                    put_bc7(found[lane], out + 16 * lane);
                } else {
                    float own[kTexels][4];
                    texels.of_lane(static_cast<int>(lane), own);
                    put_uastc(found[lane], own, out + 16 * lane);
                }
            }
        } else if (args.format == BlockFormat::bc1) {
            const Texels<4> texels(args, at, end);
            const Rows<P, 3> value{{texels.value[0], texels.value[1], texels.value[2]}};
            const Rows<P, 3> weight{{texels.weight[0], texels.weight[1], texels.weight[2]}};
            put(LineFitter<P, 3>(value, weight, LineFormat::bc1()).fit(), count, out);
        } else if (args.format == BlockFormat::bc5) {
            const Texels<2> texels(args, at, end);
            for (int c = 0; c < 2; ++c)
                put(RampFitter<P>(texels.value[c], texels.weight[c]).fit(), count, 16, out + 8 * c);
        } else {
            const Texels<1> texels(args, at, end);
            put(RampFitter<P>(texels.value[0], texels.weight[0]).fit(), count, 8, out);
        }
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
