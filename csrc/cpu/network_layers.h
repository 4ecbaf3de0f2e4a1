// Layers of networks on planes of texels, for the files that are compiled once per instruction set. Texels of a row go
// in packets. A product keeps a block of outputs of some packets in registers while it runs over all inputs.
#pragma once

#include "core/packet.h"
#include "core/packet_series.h"
#include "cpu/network.h"
#include "network/models.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace layers {

using Lane = Lanes<float>;
using T = Lane::Real;
constexpr int lanes = Lane::count;

#if defined(__AVX512F__) || defined(__aarch64__) || !defined(MIPBAKE_VECTORS)
constexpr int kBlock = 8;  // 32 registers: 24 sums, 3 inputs, 1 weight
#else
constexpr int kBlock = 4;  // 16 registers: 12 sums, 3 inputs, 1 weight
#endif
#ifdef __wasm__
constexpr int kPackets = 2;  // engines of WebAssembly keep some of 16 registers for themselves
#else
constexpr int kPackets = 3;
#endif

MIPBAKE_INLINE T load(const float* at) {
#ifdef MIPBAKE_VECTORS
    return T::load(at);
#else
    return *at;
#endif
}

template <int P>
MIPBAKE_INLINE void block_of(const PackedLayer& layer, std::int64_t block, const float* in, float* out,
                             std::int64_t plane) {
    const float* weight = layer.weight + block * kBlock * layer.inputs;
    T sums[kBlock][P];
    for (int g = 0; g < kBlock; ++g)
        for (T& sum : sums[g]) sum = T(layer.bias[block * kBlock + g]);
    for (std::int64_t k = 0; k < layer.inputs; ++k, weight += kBlock) {
        const float* const at = in + layer.offsets[k];
        T seen[P];
        for (int p = 0; p < P; ++p) seen[p] = load(at + p * lanes);
        for (int g = 0; g < kBlock; ++g) {
            const T each(weight[g]);
            for (int p = 0; p < P; ++p) sums[g][p] += each * seen[p];
        }
    }
    for (int g = 0; g < kBlock; ++g)
        for (int p = 0; p < P; ++p) {
            const T& sum = sums[g][p];
            store_lanes(out + (block * kBlock + g) * plane + p * lanes,
                        layer.rectified ? larger(sum, sum * T(network::kSlope)) : sum);
        }
}

// A layer for `count` texels of `rows` rows; at the end of a row it writes up to a packet more.
inline void apply(const PackedLayer& layer, const float* in, std::int64_t in_stride, float* out,
                  std::int64_t out_stride, std::int64_t plane, int rows, int count) {
    for (std::int64_t block = 0; block < layer.outputs / kBlock; ++block)
        for (int row = 0; row < rows; ++row) {
            const float* const from = in + row * in_stride;
            float* const to = out + row * out_stride;
            int x = 0;
            for (; count - x > (kPackets - 1) * lanes; x += kPackets * lanes)
                block_of<kPackets>(layer, block, from + x, to + x, plane);
            if (count - x > lanes) {
                block_of<2>(layer, block, from + x, to + x, plane);
            } else if (count > x) {
                block_of<1>(layer, block, from + x, to + x, plane);
            }
        }
}

inline std::int64_t column_floats(int reach) { return rounded_up(kChunk + 2 * reach, kSlack) + kSlack; }

// Sum of taps * rows[k][x], or of taps * row[x + k].
template <class Row>
MIPBAKE_INLINE T filtered(const float* taps, int count, Row&& row) {
    T sum = load(row(0)) * T(taps[0]);
    for (int k = 1; k < count; ++k) sum += load(row(k)) * T(taps[k]);
    return sum;
}

}  // namespace layers
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
