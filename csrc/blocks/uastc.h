// UASTC LDR 4x4: blocks that readers of KTX 2 files turn into ASTC, BC7 or others (Basis Universal, "UASTC LDR 4x4
// Texture Specification").
//
// Written are modes of one line, of a line and a channel alone, and of two subsets; modes of three subsets, of BC7's
// partitions in three, and of luminance with alpha are read alone.
#pragma once

#include <cstdint>

#include "blocks/choice.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct UastcMode {
    unsigned prefix;
    int prefix_bits, channels, subsets, planes, index_bits;
    int range;  // of kAstcRanges
    int bc1_hints, bias_bits;
};
constexpr int kUastcSolid = 8, kUastcModes = 19;
constexpr UastcMode kUastc[kUastcModes] = {
    {1, 4, 3, 1, 1, 4, 6, 2, 5},  {53, 6, 3, 1, 1, 2, 7, 2, 5}, {29, 5, 3, 2, 1, 3, 1, 2, 5},
    {3, 5, 3, 3, 1, 2, 0, 2, 5},  {19, 5, 3, 2, 1, 2, 3, 2, 5}, {11, 5, 3, 1, 1, 3, 7, 2, 5},
    {27, 5, 3, 1, 2, 2, 5, 2, 5}, {7, 5, 3, 2, 1, 2, 3, 2, 5},  {23, 5, 4, 1, 1, 0, 7, 0, 0},
    {15, 5, 4, 2, 1, 2, 1, 2, 5}, {2, 3, 4, 1, 1, 4, 4, 1, 0},  {0, 2, 4, 1, 2, 2, 4, 1, 0},
    {6, 3, 4, 1, 1, 3, 6, 1, 0},  {31, 5, 4, 1, 2, 1, 7, 2, 5}, {13, 5, 4, 1, 1, 2, 7, 2, 5},
    {5, 7, 2, 1, 1, 4, 7, 2, 5},  {21, 6, 2, 2, 1, 2, 7, 2, 5}, {37, 6, 2, 1, 2, 2, 7, 2, 5},
    {9, 4, 3, 1, 1, 5, 2, 2, 5}};

// Which of two subsets texels belong to, which of three (two bits a texel), and which of two in mode 7.
constexpr std::uint16_t kUastcHalves[30] = {52428, 34952, 4369,  60616, 14207, 65260, 311,   4991,  51200, 19,
                                            65152, 6143,  23,    255,   65520, 4095,  65393, 36607, 2254,  140,
                                            29456, 52991, 29489, 2188,  52975, 26214, 61455, 21845, 3855,  14025};
constexpr std::uint32_t kUastcThirds[11] = {2779054080, 2852148565, 2852126805, 43605,      623191333, 2492765332,
                                            1482184792, 1448477186, 2459079314, 1437204565, 2689618080};
constexpr std::uint16_t kUastcOtherHalves[19] = {240,   17476, 307, 52352, 61695, 8738, 65480, 52430, 15363, 238,
                                                 30464, 12291, 206, 65408, 28671, 4915, 4607,  4972,  239};

inline int uastc_subset(int mode, int partition, int texel) {
    if (mode == 3) return static_cast<int>(kUastcThirds[partition] >> 2 * texel & 3);
    if (kUastc[mode].subsets == 1) return 0;
    return (mode == 7 ? kUastcOtherHalves : kUastcHalves)[partition] >> texel & 1;
}
// Whether a texel is the first of its subset, whose indices lack their highest bit.
inline bool is_uastc_anchor(int mode, int partition, int texel) {
    const int subset = uastc_subset(mode, partition, texel);
    for (int i = 0; i < texel; ++i)
        if (uastc_subset(mode, partition, i) == subset) return false;
    return true;
}

// How many bits so many trits or quints take, besides the whole groups of five or three.
inline int bits_of_digits(int count, bool quints) {
    constexpr int trit_bits[5] = {0, 2, 4, 5, 7}, quint_bits[3] = {0, 3, 5};
    return quints ? quint_bits[count] : trit_bits[count];
}

template <class P>
class UastcFitter : Chooser<P> {
  public:
    // Rows of `weight` are changed.
    UastcFitter(const P (&value)[4][kTexels], P (&weight)[4][kTexels]) : Chooser<P>(value, weight) {}

    const BlockChoice<P>& fit() {
        solid();
        // What is opaque has no error of alpha, so the modes without alpha win by their precision.
        for (int mode : {0, 18, 5})
            if (this->any_needs_more()) this->template try_one_line<3>(mode, line_of(mode));
        if (any(this->opaque_error_ > P(0.0f)))
            for (int mode : {10, 12, 14}) this->template try_one_line<4>(mode, line_of(mode));
        if (this->any_needs_more()) {
            for (int alone = 0; alone < 3; ++alone) this->template try_alone<3>(6, alone, line_of(6), line_of(6));
            this->divide(kUastcHalves, 30);
            for (int mode : {2, 4}) this->template try_two_subsets<3>(mode, line_of(mode));
            if (any(this->opaque_error_ > P(0.0f))) {
                for (int alone = 0; alone < 4; ++alone)
                    for (int mode : {11, 13}) this->template try_alone<4>(mode, alone, line_of(mode), line_of(mode));
                this->template try_two_subsets<4>(9, line_of(9));
            }
        }
        return this->best_;
    }

  private:
    static LineFormat line_of(int mode) {
        return LineFormat::astc(kAstcLevels[kUastc[mode].range], kUastc[mode].index_bits);
    }

    // One colour for all texels: their weighted mean.
    void solid() {
        P error(0.0f), code[4];
        for (int c = 0; c < 4; ++c) {
            P sum(0.0f), total(0.0f);
            for (int i = 0; i < kTexels; ++i) {
                sum = sum + this->value_[c][i] * this->weight_[c][i];
                total = total + this->weight_[c][i];
            }
            code[c] = nearest(sum / total);
            for (int i = 0; i < kTexels; ++i)
                error = error + square(code[c] - this->value_[c][i]) * this->weight_[c][i];
        }
        const auto better = this->better_than(error, kUastcSolid);
        for (int c = 0; c < 4; ++c) this->best_.code[0][0][c] = select(better, code[c], this->best_.code[0][0][c]);
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
