// The endpoints of ASTC: numbers of bits and of a trit or a quint, and what they stand for (Khronos Data Format
// Specification 1.3, section 23.13).
#pragma once

#include <cstdint>

namespace mipbake {
inline namespace MIPBAKE_ISA {

// A range of numbers. `factor` is the specification's C. `places` are the nine digits of its B: a letter for a bit.
struct AstcRange {
    int bits, trits, quints, factor;
    const char* places;
};

// Numbers from the least to the greatest value: values, and the codes that are stored.
struct AstcLevels {
    int count = 0;
    std::uint8_t value[256] = {}, code[256] = {};
};

constexpr int astc_value(const AstcRange& range, int code) {
    const int low = code & ((1 << range.bits) - 1), digit = code >> range.bits;
    if (range.factor == 0) {  // bits alone, repeated to eight
        int value = 0;
        for (int shift = 8 - range.bits; shift > -range.bits; shift -= range.bits)
            value |= shift >= 0 ? low << shift : low >> -shift;
        return value;
    }
    const int all = low & 1 ? 511 : 0;
    int spread = 0;
    for (int i = 0; i < 9; ++i)
        spread = spread << 1 | (range.places[i] == '0' ? 0 : low >> (range.places[i] - 'a') & 1);
    return (all & 128) | (((digit * range.factor + spread) ^ all) >> 2);
}

constexpr AstcLevels astc_levels(const AstcRange& range) {
    AstcLevels levels;
    const int count = (range.trits ? 3 : range.quints ? 5 : 1) << range.bits;
    int at[256] = {};  // code plus one of each value
    for (int code = 0; code < count; ++code) at[astc_value(range, code)] = code + 1;
    for (int value = 0; value < 256; ++value)
        if (at[value]) {
            levels.value[levels.count] = static_cast<std::uint8_t>(value);
            levels.code[levels.count++] = static_cast<std::uint8_t>(at[value] - 1);
        }
    return levels;
}

// Those that UASTC has.
constexpr AstcRange kAstcRanges[] = {
    {2, 1, 0, 93, "b000b0bb0"}, {4, 0, 0, 0, ""},          {5, 0, 0, 0, ""},          {3, 0, 1, 26, "cb0000cbc"},
    {4, 1, 0, 22, "dcb000dcb"}, {5, 0, 1, 6, "edcb0000e"}, {6, 1, 0, 5, "fedcb000f"}, {8, 0, 0, 0, ""}};
constexpr AstcLevels kAstcLevels[] = {
    astc_levels(kAstcRanges[0]), astc_levels(kAstcRanges[1]), astc_levels(kAstcRanges[2]), astc_levels(kAstcRanges[3]),
    astc_levels(kAstcRanges[4]), astc_levels(kAstcRanges[5]), astc_levels(kAstcRanges[6]), astc_levels(kAstcRanges[7])};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
