// Which texels of blocks go together: of some partitions into two subsets, the one whose subsets are nearest to lines.
#pragma once

#include <cstdint>
#include <cstring>

#include "blocks/line.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// The variance of a subset, less that along its greatest axis; of the sums of the weight, of 4 channels and of their 10
// products.
template <class P>
P variance_across(const P* sums) {
    constexpr int kPowers = 3;
    const P inverse = P(1.0f) / larger(sums[0], P(1e-20f));
    P moments[4][4], axis[4], trace(0.0f), most(-1.0f);
    int k = 5;
    for (int a = 0; a < 4; ++a)
        for (int b = 0; b <= a; ++b, ++k) moments[a][b] = moments[b][a] = sums[k] - sums[1 + a] * sums[1 + b] * inverse;
    for (int a = 0; a < 4; ++a) {
        trace = trace + moments[a][a];
        const auto more = moments[a][a] > most;
        most = select(more, moments[a][a], most);
        for (int c = 0; c < 4; ++c) axis[c] = a == 0 ? moments[0][c] : select(more, moments[a][c], axis[c]);
    }
    P along(0.0f);
    for (int round = 0; round < kPowers; ++round) {
        P next[4], squares(1e-30f), product(0.0f);
        for (int a = 0; a < 4; ++a) {
            next[a] = P(0.0f);
            for (int c = 0; c < 4; ++c) next[a] = next[a] + moments[a][c] * axis[c];
            squares = squares + axis[a] * axis[a];
            product = product + axis[a] * next[a];
        }
        along = product / squares;
        const P scale = P(1.0f) / larger(trace, P(1e-20f));
        for (int a = 0; a < 4; ++a) axis[a] = next[a] * scale;
    }
    return trace - along;
}

// The index of the partition that fits best; `inside` is 1 for texels of its second subset, else 0. Bit i of a
// partition says which subset texel i is in.
template <class P>
P best_partition(const P (&value)[4][kTexels], const P (&weight)[4][kTexels], const std::uint16_t* partitions,
                 int count, P (&inside)[kTexels]) {
    constexpr int kSums = 15, kLanes = Lanes<float>::count;
    P sums[kTexels][kSums], whole[kSums], scale[4], total(1e-20f);
    for (int c = 0; c < 4; ++c) {
        scale[c] = P(0.0f);
        for (int i = 0; i < kTexels; ++i) scale[c] = scale[c] + weight[c][i];
        total = total + scale[c];
    }
    for (P& each : scale) each = square_root(each / total);
    for (P& each : whole) each = P(0.0f);
    for (int i = 0; i < kTexels; ++i) {
        P at[4], counts(0.0f);
        for (int c = 0; c < 4; ++c) {
            counts = counts + weight[c][i];
            at[c] = (value[c][i] - value[c][0]) * scale[c];
        }
        int k = 0;
        sums[i][k++] = counts;
        for (int a = 0; a < 4; ++a) sums[i][k++] = counts * at[a];
        for (int a = 0; a < 4; ++a)
            for (int b = 0; b <= a; ++b) sums[i][k++] = counts * at[a] * at[b];
        for (k = 0; k < kSums; ++k) whole[k] = whole[k] + sums[i][k];
    }
    P least(1e30f), found(0.0f);
    for (int partition = 0; partition < count; ++partition) {
        P one[kSums], other[kSums];
        for (P& each : one) each = P(0.0f);
        for (int i = 0; i < kTexels; ++i)
            if (partitions[partition] >> i & 1)
                for (int k = 0; k < kSums; ++k) one[k] = one[k] + sums[i][k];
        for (int k = 0; k < kSums; ++k) other[k] = whole[k] - one[k];
        const P error = variance_across(one) + variance_across(other);
        const auto less = least > error;
        least = select(less, error, least);
        found = select(less, P(static_cast<float>(partition)), found);
    }
    float lanes[kLanes], mask[kTexels][kLanes];
    store_lanes(lanes, found);
    for (int lane = 0; lane < kLanes; ++lane)
        for (int i = 0; i < kTexels; ++i)
            mask[i][lane] = static_cast<float>(partitions[static_cast<int>(lanes[lane])] >> i & 1);
    for (int i = 0; i < kTexels; ++i) std::memcpy(&inside[i], mask[i], sizeof inside[i]);
    return found;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
