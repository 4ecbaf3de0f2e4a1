// What tiles of any network have in common: level 0 filtered from rows of latents, and rows of coarser levels from
// those that are summed up. K decodes: K::moments latents that are not learned, K::detail of them that sharpening is
// told by.
#pragma once

#include "cpu/network_layers.h"
#include "network/corrections.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace layers {

// Planes of a chunk of texels lie so many floats apart.
constexpr std::int64_t kPlane = kChunk + kSlack;

inline network::Limits limits_of(const KernelNetwork& net) {
    const NetworkLimits& l = net.limits;
    return {l.least_roughness,    l.most_roughness, l.least_log_roughness,
            l.most_log_roughness, l.least_alpha2,   l.most_alpha2};
}

template <class K>
void top_tile(const KernelNetwork& net, const TopTile& tile, float* scratch) {
    const std::int64_t latent = K::moments + net.learned;
    float* const latents = scratch;
    float* const column = latents + (latent + K::detail) * kPlane;
    float* const plain = column + column_floats(tile.reach);
    float* const rest = plain + column_floats(tile.reach);
    const int taps = 2 * tile.reach + 1, wide = tile.count + 2 * tile.reach;
    for (std::int64_t z = 0; z < latent; ++z) {
        const bool told = z < K::detail;
        for (int x = 0; x < wide; x += lanes) {
            const auto at = [&](int k) { return tile.around[k] + z * tile.plane + tile.from + x; };
            store_lanes(column + x, filtered(tile.sharp, taps, at));
            if (told) store_lanes(plain + x, filtered(tile.plain, taps - 2, [&](int k) { return at(k + 1); }));
        }
        for (int x = 0; x < tile.count; x += lanes) {
            const T sharp = filtered(tile.sharp, taps, [&](int k) { return column + x + k; });
            store_lanes(latents + z * kPlane + x, sharp);
            if (told) {
                const T smooth = filtered(tile.plain, taps - 2, [&](int k) { return plain + x + k + 1; });
                store_lanes(latents + (latent + z) * kPlane + x, (sharp - smooth) * T(network::kDetailScale));
            }
        }
    }
    K::decode(net, latents, tile.count, tile.bias, tile.out, rest);
}

template <class K>
void across_tile(const KernelNetwork& net, const AcrossTile& tile, float* scratch) {
    const std::int64_t latent = K::moments + net.learned, all = latent + (tile.out != nullptr ? K::detail : 0);
    float* const latents = scratch;
    float* const rest = latents + (latent + K::detail) * kPlane;
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
            for (std::int64_t i = 0; i < some; ++i)
                latents[(z + i) * kPlane + x] = z + i < latent ? sums[i] : smooths[i];
        }
    }
    if (tile.latents != nullptr)
        for (std::int64_t z = 0; z < latent; ++z)
            for (int x = 0; x < tile.count; ++x) tile.latents[z * tile.plane + x] = latents[z * kPlane + x];
    if (tile.out == nullptr) return;
    for (std::int64_t z = 0; z < K::detail; ++z)
        for (int x = 0; x < tile.count; ++x) {
            float& each = latents[(latent + z) * kPlane + x];
            each = (latents[z * kPlane + x] - each) * network::kDetailScale;
        }
    // What lies behind the last texel must be numbers.
    for (std::int64_t z = 0; z < latent + K::detail; ++z)
        for (int x = tile.count; x < rounded_up(tile.count, lanes); ++x)
            latents[z * kPlane + x] = latents[z * kPlane + tile.count - 1];
    K::decode(net, latents, tile.count, tile.bias, tile.out, rest);
}

// Floats of scratch beside what K::decode takes.
template <class K>
std::int64_t tile_floats(const KernelNetwork& net, int reach) {
    return (K::moments + net.learned + K::detail) * kPlane + 2 * column_floats(reach);
}

// The channels of the texels of a row, in packets: f(x, channel) where channel(c) is the packet of channel c at texels
// x and on. C channels are read; what lies behind the last texel repeats it.
template <int C, class F>
MIPBAKE_INLINE void for_packets(const EncodeTile& tile, const float* row, int wide, F&& f) {
    for (int x = 0; x < wide; x += lanes) {
        float gathered[C][lanes];
        for (int lane = 0; lane < lanes; ++lane) {
            const float* const texel = row + tile.columns[x + lane < wide ? x + lane : wide - 1] * tile.read;
            for (int c = 0; c < C; ++c) gathered[c][lane] = texel[c];
        }
        f(x, [&](int c) { return load(gathered[c]); });
    }
}

// The dense layers of an encoder and the projection to latents, behind `moments` others; `planes` of `maps` are there.
inline void encode_layers(const KernelNetwork& net, const EncodeTile& tile, std::int64_t planes, std::int64_t moments,
                          float* maps) {
    const int border = net.halo, high = tile.height + 2 * border, wide = tile.columns_count + 2 * border;
    for (int i = 0; i < net.encoder_layers; ++i) {
        const int shrunk = i < net.convolutions ? i + 1 : net.convolutions;
        const std::int64_t at = shrunk * (net.tile_stride + 1);
        apply(net.encoder[i], maps + at, net.tile_stride, maps + planes * net.tile_plane + at, net.tile_stride,
              net.tile_plane, high - 2 * shrunk, wide - 2 * shrunk);
        planes += net.encoder[i].outputs;
    }
    float* const projected = maps + planes * net.tile_plane;
    for (int y = 0; y < tile.height; ++y) {
        const float* const from = maps + border * (net.tile_stride + 1) + y * net.tile_stride;
        apply(net.project, from, 0, projected, 0, kPlane, 1, tile.columns_count);
        for (std::int64_t z = 0; z < net.learned; ++z) {
            float* const out = tile.out[y] + (moments + z) * tile.plane;
            for (int x = 0; x < tile.columns_count; ++x) out[x] = projected[z * kPlane + x];
        }
    }
}

// Floats of scratch of `encode_layers`, with those of the planes that are there.
inline std::int64_t encode_floats(const KernelNetwork& net, std::int64_t planes) {
    for (int i = 0; i < net.encoder_layers; ++i) planes += net.encoder[i].outputs;
    return planes * net.tile_plane + net.project.outputs * kPlane + kSlack;
}

// The layers of a decoder, whose first planes are there; gives what the last one made.
inline const float* decode_layers(const KernelNetwork& net, float* maps, std::int64_t planes, const float* bias,
                                  int count) {
    for (int i = 0; i < net.decoder_layers; ++i) {
        PackedLayer layer = net.decoder[i];
        layer.bias = bias;
        apply(layer, maps, 0, maps + planes * kPlane, 0, kPlane, 1, count);
        bias += layer.outputs;
        if (i + 1 < net.decoder_layers) planes += layer.outputs;
    }
    return maps + planes * kPlane;
}

inline std::int64_t decode_floats(const KernelNetwork& net, std::int64_t planes) {
    for (int i = 0; i < net.decoder_layers; ++i) planes += net.decoder[i].outputs;
    return planes * kPlane;
}

// Some texels of C channels, from packets to side by side.
template <int C>
MIPBAKE_INLINE void store_texels(const float (&channels)[C][lanes], int count, float* out) {
    for (int lane = 0; lane < count; ++lane)
        for (int c = 0; c < C; ++c) out[lane * C + c] = channels[c][lane];
}

}  // namespace layers
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
