// What the bits of compressed blocks of 4 x 4 texels mean (Khronos Data Format Specification 1.3, sections 18 to 20).
#pragma once

#include <cstdint>

namespace mipbake {
inline namespace MIPBAKE_ISA {

constexpr int kTexels = 16;  // of a block, row by row

// BC7. Which of two subsets each texel belongs to: bit i is texel i.
constexpr std::uint16_t kHalves[64] = {
    52428, 34952, 61166, 60616, 51328, 65260, 65224, 60544, 51200, 65516, 65152, 59392, 65512, 65280, 65520, 61440,
    63248, 142,   28928, 2254,  140,   29456, 12544, 36046, 2188,  12560, 26214, 13932, 6120,  4080,  29070, 14748,
    43690, 61680, 23130, 13260, 15420, 21930, 38550, 42330, 29646, 5064,  12876, 15324, 27030, 49980, 39270, 1632,
    626,   1252,  20032, 10016, 51510, 37740, 14790, 25500, 37686, 40134, 33150, 59160, 52464, 4044,  30532, 60962};

// The texel of the second half whose index has one bit less; in the first half it is texel 0.
constexpr std::uint8_t kHalfAnchors[64] = {15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15, 15,
                                           15, 2,  8,  2,  2,  8,  8,  15, 2,  8,  2,  2,  8,  8,  2,  2,
                                           15, 15, 6,  8,  2,  8,  15, 15, 2,  8,  2,  2,  2,  15, 15, 6,
                                           6,  2,  6,  8,  15, 15, 2,  2,  15, 15, 15, 15, 15, 2,  2,  15};

// Which of three subsets: two bits a texel.
constexpr std::uint32_t kThirds[64] = {
    2858963024, 1784303680, 1515864576, 1414570152, 2779054080, 2694860880, 1431675040, 1515868240,
    2857697280, 2857719040, 2863289600, 2425393296, 2492765332, 2762253476, 2846200912, 705315408,
    2777960512, 172118100,  2779096320, 1436590240, 2829603924, 1785348160, 2762231808, 437912832,
    5285028,    2862977168, 342452500,  1768494080, 2693105056, 2860651540, 1352967248, 1784283648,
    2846195712, 1351655592, 2829094992, 606348324,  11162880,   613566756,  608801316,  1352993360,
    1342874960, 2863285316, 1717960704, 2778768800, 1352683680, 1764256040, 1152035396, 1717986816,
    2856600644, 1420317864, 2508232064, 2526451200, 2824098984, 2157286784, 2853442580, 2526412800,
    2863272980, 2689618080, 2695210400, 2516582400, 1082146944, 2846402984, 2863311428, 709513812};

// Texels of the second and the third subset whose indices have one bit less.
constexpr std::uint8_t kThirdAnchors[64][2] = {
    {3, 15},  {3, 8},  {15, 8},  {15, 3}, {8, 15},  {3, 15}, {15, 3},  {15, 8}, {8, 15},  {8, 15}, {6, 15},
    {6, 15},  {6, 15}, {5, 15},  {3, 15}, {3, 8},   {3, 15}, {3, 8},   {8, 15}, {15, 3},  {3, 15}, {3, 8},
    {6, 15},  {10, 8}, {5, 3},   {8, 15}, {8, 6},   {6, 10}, {8, 15},  {5, 15}, {15, 10}, {15, 8}, {8, 15},
    {15, 3},  {3, 15}, {5, 10},  {6, 10}, {10, 8},  {8, 9},  {15, 10}, {15, 6}, {3, 15},  {15, 8}, {5, 15},
    {15, 3},  {15, 6}, {15, 6},  {15, 8}, {3, 15},  {15, 3}, {5, 15},  {5, 15}, {5, 15},  {8, 15}, {5, 15},
    {10, 15}, {5, 15}, {10, 15}, {8, 15}, {13, 15}, {15, 3}, {12, 15}, {3, 15}, {3, 8}};

enum class Parity { none, shared, each };  // least bits of endpoints, of both of a subset or of each

struct Mode {
    int subsets, partition_bits, rotation_bits, selector_bits;
    int colour_bits, alpha_bits;
    Parity parity;
    int index_bits, second_bits;  // the second indices are alpha's, or colour's where the selector is set
};
constexpr Mode kModes[8] = {{3, 4, 0, 0, 4, 0, Parity::each, 3, 0}, {2, 6, 0, 0, 6, 0, Parity::shared, 3, 0},
                            {3, 6, 0, 0, 5, 0, Parity::none, 2, 0}, {2, 6, 0, 0, 7, 0, Parity::each, 2, 0},
                            {1, 0, 2, 1, 5, 6, Parity::none, 2, 3}, {1, 0, 2, 0, 7, 8, Parity::none, 2, 2},
                            {1, 0, 0, 0, 7, 7, Parity::each, 4, 0}, {2, 6, 0, 0, 5, 5, Parity::each, 2, 0}};

inline int subset_of(int subsets, int partition, int texel) {
    if (subsets == 1) return 0;
    return subsets == 2 ? kHalves[partition] >> texel & 1 : static_cast<int>(kThirds[partition] >> 2 * texel & 3);
}

// Whether the index of a texel lacks its highest bit.
inline bool is_anchor(int subsets, int partition, int texel) {
    if (texel == 0) return true;
    if (subsets == 2) return texel == kHalfAnchors[partition];
    return subsets == 3 && (texel == kThirdAnchors[partition][0] || texel == kThirdAnchors[partition][1]);
}

// How far from the first endpoint an index of so many bits lies, in 64ths.
inline int share_of(int index, int bits) {
    const int last = (1 << bits) - 1;
    return (128 * index + last) / (2 * last);
}

// 128 bits, the least first.
class Bits {
  public:
    void put(unsigned value, int count) {
        for (int i = 0; i < count; ++i, ++at_)
            bytes_[at_ >> 3] = static_cast<std::uint8_t>(bytes_[at_ >> 3] | (value >> i & 1) << (at_ & 7));
    }
    unsigned take(int count) {
        unsigned value = 0;
        for (int i = 0; i < count; ++i, ++at_) value |= (bytes_[at_ >> 3] >> (at_ & 7) & 1u) << i;
        return value;
    }
    std::uint8_t* bytes() { return bytes_; }

  private:
    std::uint8_t bytes_[16] = {};
    int at_ = 0;
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
