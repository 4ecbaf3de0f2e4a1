// The encoder, the filters and the decoder of moment networks, compiled once per instruction set. Texels of a row go in
// packets. Every product of a layer keeps a block of outputs of some packets in registers while it runs over all
// inputs.
#include "core/packet.h"
#include "core/packet_series.h"
#include "cpu/network.h"
#include "network/corrections.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Lane = Lanes<float>;
using T = Lane::Real;
constexpr int lanes = Lane::count;

#if defined(__AVX512F__) || defined(__aarch64__) || !defined(MIPBAKE_VECTORS)
constexpr int kBlock = 8;  // 32 registers: 24 sums, 3 inputs, 1 weight
#else
constexpr int kBlock = 4;  // 16 registers: 12 sums, 3 inputs, 1 weight
#endif
constexpr int kPackets = 3;

constexpr float kSlope = 0.1f;  // of the rectifier below zero, as dense.py has it

MIPBAKE_INLINE T load(const float* at) {
    if constexpr (lanes == 1) {
        return T(*at);
    } else {
        return T::load(at);
    }
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
                        layer.rectified ? larger(sum, sum * T(kSlope)) : sum);
        }
}

// A layer for `count` texels of `rows` rows; at the end of a row it writes up to a packet more.
void apply(const PackedLayer& layer, const float* in, std::int64_t in_stride, float* out, std::int64_t out_stride,
           std::int64_t plane, int rows, int count) {
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

std::int64_t column_floats(int reach) { return rounded_up(kChunk + 2 * reach, kSlack) + kSlack; }

// Sum of taps * rows[k][x], or of taps * row[x + k].
template <class Row>
MIPBAKE_INLINE T filtered(const float* taps, int count, Row&& row) {
    T sum = load(row(0)) * T(taps[0]);
    for (int k = 1; k < count; ++k) sum += load(row(k)) * T(taps[k]);
    return sum;
}

template <class M>
struct Kernels {
    using Model = M;
    using R = typename M::Read;
    using Found = network::Statistics<R, T>;
    using Walk = network::Walk<T>;
    using Means = network::Means<T>;
    static constexpr int moments = network::moment_count<R>, detail = network::detail_count<R>;
    static constexpr int outputs = network::output_count<R>;

    static network::Limits limits(const MomentKernelNetwork& net) {
        const NetworkLimits& l = net.limits;
        return {l.least_roughness,    l.most_roughness, l.least_log_roughness,
                l.most_log_roughness, l.least_alpha2,   l.most_alpha2};
    }

    static void encode(const MomentKernelNetwork& net, const EncodeTile& tile, float* maps) {
        const network::Limits limit = limits(net);
        const int border = net.halo, high = tile.height + 2 * border, wide = tile.columns_count + 2 * border;
        for (int y = 0; y < high; ++y) {
            const float* const row = tile.stored + tile.rows[y] * tile.width * tile.read;
            const bool inside = y >= border && y < border + tile.height;
            for (int x = 0; x < wide; x += lanes) {
                float gathered[R::channels][lanes];
                for (int lane = 0; lane < lanes; ++lane) {
                    const float* const texel = row + tile.columns[x + lane < wide ? x + lane : wide - 1] * tile.read;
                    for (int c = 0; c < R::channels; ++c) gathered[c][lane] = texel[c];
                }
                const auto texel = network::Texel<R, T>::of([&](int c) { return load(gathered[c]); });
                network::put_inputs(texel, limit, Walk{maps + y * net.tile_stride + x, net.tile_plane});
                if (inside) {
                    // The halo to the left is no part of the latents: a packet that begins there is moved.
                    float shifted[moments][lanes];
                    network::put_moments(texel, limit, Walk{shifted[0], lanes});
                    const int from = x < border ? border - x : 0;
                    const int most = border + tile.columns_count - x, to = most < lanes ? most : lanes;
                    float* const out = tile.out[y - border] + x - border;
                    for (int z = 0; z < moments; ++z)
                        for (int lane = from; lane < to; ++lane) out[z * tile.plane + lane] = shifted[z][lane];
                }
            }
        }
        std::int64_t planes = network::input_count<R>;
        for (int i = 0; i < net.encoder_layers; ++i) {
            const int shrunk = i < net.convolutions ? i + 1 : net.convolutions;
            const std::int64_t at = shrunk * (net.tile_stride + 1);
            apply(net.encoder[i], maps + at, net.tile_stride, maps + planes * net.tile_plane + at, net.tile_stride,
                  net.tile_plane, high - 2 * shrunk, wide - 2 * shrunk);
            planes += net.encoder[i].outputs;
        }
        for (int y = 0; y < tile.height; ++y) {
            const float* const from = maps + border * (net.tile_stride + 1) + y * net.tile_stride;
            float* const to = maps + planes * net.tile_plane;
            apply(net.project, from, 0, to, 0, kTile + kSlack, 1, tile.columns_count);
            for (std::int64_t z = 0; z < net.learned; ++z) {
                float* const out = tile.out[y] + (moments + z) * tile.plane;
                for (int x = 0; x < tile.columns_count; ++x) out[x] = to[z * (kTile + kSlack) + x];
            }
        }
    }

    // `latents`: planes kChunk + kSlack apart, of moments, learned ones and detail, scaled.
    static void decode(const MomentKernelNetwork& net, const float* latents, int count, const float* bias, float* out,
                       float* scratch) {
        constexpr std::int64_t plane = kChunk + kSlack;
        const network::Limits limit = limits(net);
        float* const maps = scratch;
        Found found[kChunk / lanes];
        const std::int64_t features = network::feature_count<R>;
        for (int x = 0; x < count; x += lanes) {
            found[x / lanes] = network::statistics<R, T>(Means{latents + x, plane}, limit);
            network::put_features(found[x / lanes], Walk{maps + x, plane});
        }
        const std::int64_t learned = net.learned * plane;
        for (std::int64_t i = 0; i < learned; ++i) maps[features * plane + i] = latents[moments * plane + i];
        std::int64_t planes = features + net.learned;
        // What sharpening added stands before what the layers make, so that only the last one reads it there.
        for (std::int64_t i = 0; i < detail * plane; ++i)
            maps[planes * plane + i] = latents[(moments + net.learned) * plane + i];
        const float* const added = maps + planes * plane;
        planes += detail;
        for (int i = 0; i < net.decoder_layers; ++i) {
            PackedLayer layer = net.decoder[i];
            layer.bias = bias;
            apply(layer, maps, 0, maps + planes * plane, 0, plane, 1, count);
            bias += layer.outputs;
            if (i + 1 < net.decoder_layers) planes += layer.outputs;
        }
        const float* const said = maps + planes * plane;
        for (int x = 0; x < count; x += lanes) {
            const auto outputs_of = network::Outputs<R, T>::of(Means{said + x, plane});
            const auto more =
                network::Added<R, T>::of(Means{added + x, plane}, Means{said + outputs * plane + x, plane});
            float channels[M::channels][lanes];
            network::put_channels<M>(found[x / lanes], outputs_of, more,
                                     Means{said + (outputs + network::kCrisp) * plane + x, plane}, limit,
                                     Walk{channels[0], lanes});
            const int some = count - x < lanes ? count - x : lanes;
            for (int lane = 0; lane < some; ++lane)
                for (int c = 0; c < M::channels; ++c) out[(x + lane) * M::channels + c] = channels[c][lane];
        }
    }

    static std::int64_t decoder_planes(const MomentKernelNetwork& net) {
        std::int64_t planes = network::feature_count<R> + net.learned + detail;
        for (int i = 0; i < net.decoder_layers; ++i) planes += net.decoder[i].outputs;
        return planes;
    }

    static std::int64_t decode_floats(const MomentKernelNetwork& net) {
        return (decoder_planes(net) + moments + net.learned + detail) * (kChunk + kSlack);
    }

    static void top(const MomentKernelNetwork& net, const TopTile& tile, float* scratch) {
        constexpr std::int64_t plane = kChunk + kSlack;
        float* const latents = scratch;
        float* const column = latents + (moments + net.learned + detail) * plane;
        float* const plain = column + column_floats(tile.reach);
        float* const rest = plain + column_floats(tile.reach);
        const int taps = 2 * tile.reach + 1, wide = tile.count + 2 * tile.reach;
        for (std::int64_t z = 0; z < moments + net.learned; ++z) {
            const bool told = z < detail;
            for (int x = 0; x < wide; x += lanes) {
                const auto at = [&](int k) { return tile.around[k] + z * tile.plane + tile.from + x; };
                store_lanes(column + x, filtered(tile.sharp, taps, at));
                if (told) store_lanes(plain + x, filtered(tile.plain, taps - 2, [&](int k) { return at(k + 1); }));
            }
            for (int x = 0; x < tile.count; x += lanes) {
                const T sharp = filtered(tile.sharp, taps, [&](int k) { return column + x + k; });
                store_lanes(latents + z * plane + x, sharp);
                if (told) {
                    const T smooth = filtered(tile.plain, taps - 2, [&](int k) { return plain + x + k + 1; });
                    store_lanes(latents + (moments + net.learned + z) * plane + x,
                                (sharp - smooth) * T(network::kDetailScale));
                }
            }
        }
        decode(net, latents, tile.count, tile.bias, tile.out, rest);
    }

    static void across(const MomentKernelNetwork& net, const AcrossTile& tile, float* scratch) {
        constexpr std::int64_t plane = kChunk + kSlack;
        const std::int64_t latent = moments + net.learned, all = latent + (tile.out != nullptr ? detail : 0);
        float* const latents = scratch;
        float* const rest = latents + (latent + detail) * plane;
        for (int x = 0; x < tile.count; ++x) {
            const std::int32_t* const index = tile.index + static_cast<std::int64_t>(x) * tile.taps;
            const float* const sharp = tile.sharp + static_cast<std::int64_t>(x) * tile.taps;
            const float* const plain = tile.plain + static_cast<std::int64_t>(x) * tile.taps;
            for (std::int64_t z = 0; z < all; z += lanes) {
                // The packet in which sharp channels end has both kinds.
                T sum(0.0f), smooth(0.0f);
                for (int k = 0; k < tile.taps; ++k) {
                    const T seen = load(tile.row + index[k] * tile.stride + z);
                    sum += seen * T(sharp[k]);
                    if (z + lanes > latent) smooth += seen * T(plain[k]);
                }
                float sums[lanes], smooths[lanes];
                store_lanes(sums, sum);
                store_lanes(smooths, smooth);
                const std::int64_t some = all - z < lanes ? all - z : lanes;
                if (tile.out == nullptr) {
                    for (std::int64_t i = 0; i < some; ++i) tile.latents[(z + i) * tile.plane + x] = sums[i];
                } else {
                    for (std::int64_t i = 0; i < some; ++i)
                        latents[(z + i) * plane + x] = z + i < latent ? sums[i] : smooths[i];
                }
            }
        }
        if (tile.out == nullptr) return;
        for (std::int64_t z = 0; z < detail; ++z)
            for (int x = 0; x < tile.count; ++x) {
                float& each = latents[(latent + z) * plane + x];
                each = (latents[z * plane + x] - each) * network::kDetailScale;
            }
        // What lies behind the last texel must be numbers.
        for (std::int64_t z = 0; z < latent + detail; ++z)
            for (int x = tile.count; x < rounded_up(tile.count, lanes); ++x)
                latents[z * plane + x] = latents[z * plane + tile.count - 1];
        decode(net, latents, tile.count, tile.bias, tile.out, rest);
    }
};

// Calls f(Kernels<M>()) for the model that is made.
template <class F>
decltype(auto) visit(int made, F&& f) {
    using namespace network;
    switch (made) {
        case 0:
            return f(Kernels<Made<ReadGltf, false>>());
        case 1:
            return f(Kernels<Made<ReadGltf, true>>());
        case 2:
            return f(Kernels<Made<ReadGgx, false>>());
        default:
            return f(Kernels<Made<ReadBeckmann, false>>());
    }
}

}  // namespace

int network_block() { return kBlock; }

MomentCounts network_counts(int made) {
    return visit(made, [](auto kernels) {
        using M = typename decltype(kernels)::Model;
        using R = typename M::Read;
        return MomentCounts{R::channels,
                            M::channels,
                            network::input_count<R>,
                            network::moment_count<R>,
                            network::detail_count<R>,
                            network::feature_count<R>,
                            network::output_count<R>};
    });
}

void network_pack(const float* weight, std::int64_t outputs, std::int64_t inputs, std::int64_t blocks, float* packed) {
    for (std::int64_t block = 0; block < blocks; ++block)
        for (std::int64_t k = 0; k < inputs; ++k)
            for (int g = 0; g < kBlock; ++g) {
                const std::int64_t row = block * kBlock + g;
                *packed++ = row < outputs ? weight[row * inputs + k] : 0.0f;
            }
}

std::int64_t network_encode_scratch(const MomentKernelNetwork& net) {
    std::int64_t planes = visit(net.made, [](auto kernels) {
        return static_cast<std::int64_t>(network::input_count<typename decltype(kernels)::R>);
    });
    for (int i = 0; i < net.encoder_layers; ++i) planes += net.encoder[i].outputs;
    return planes * net.tile_plane + net.project.outputs * (kTile + kSlack) + kSlack;
}

void network_encode(const MomentKernelNetwork& net, const EncodeTile& tile, float* scratch) {
    visit(net.made, [&](auto kernels) { kernels.encode(net, tile, scratch); });
}

std::int64_t network_decode_scratch(const MomentKernelNetwork& net, int reach) {
    return visit(net.made, [&](auto kernels) { return kernels.decode_floats(net); }) + 2 * column_floats(reach) +
           kSlack;
}

void network_top(const MomentKernelNetwork& net, const TopTile& tile, float* scratch) {
    visit(net.made, [&](auto kernels) { kernels.top(net, tile, scratch); });
}

void network_across(const MomentKernelNetwork& net, const AcrossTile& tile, float* scratch) {
    visit(net.made, [&](auto kernels) { kernels.across(net, tile, scratch); });
}

void network_add(const AddRow& add, std::int64_t channels, std::int64_t detail, std::int64_t begin, std::int64_t end) {
    for (std::int64_t z = 0; z < channels + detail; ++z) {
        const float* const row = add.row + (z < channels ? z : z - channels) * add.row_plane;
        float* const into = add.into + z * add.into_plane;
        const T weight(z < channels ? add.sharp : add.plain);
        std::int64_t x = begin;
        if (add.first) {
            for (; x + lanes <= end; x += lanes) store_lanes(into + x, load(row + x) * weight);
        } else {
            for (; x + lanes <= end; x += lanes) store_lanes(into + x, load(into + x) + load(row + x) * weight);
        }
        const float single = z < channels ? add.sharp : add.plain;
        for (; x < end; ++x) into[x] = (add.first ? 0.0f : into[x]) + row[x] * single;
    }
}

void network_transpose(const float* planes, std::int64_t plane, std::int64_t channels, std::int64_t begin,
                       std::int64_t end, float* out, std::int64_t stride) {
    constexpr std::int64_t some = 16;
    for (std::int64_t x0 = begin; x0 < end; x0 += some) {
        const std::int64_t x1 = x0 + some < end ? x0 + some : end;
        for (std::int64_t z = 0; z < channels; ++z)
            for (std::int64_t x = x0; x < x1; ++x) out[x * stride + z] = planes[z * plane + x];
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
