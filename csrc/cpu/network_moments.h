// The kernels of moment networks (models/moment_network.py).
#pragma once

#include "cpu/network_tiles.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace layers {

template <class M>
struct MomentKernels {
    using R = typename M::Read;
    using Walk = network::Walk<T>;
    using Means = network::Means<T>;
    static constexpr int moments = network::moment_count<R>, detail = network::detail_count<R>;
    static constexpr int inputs = network::input_count<R>, features = network::feature_count<R>;
    static constexpr int outputs = network::output_count<R>;

    static NetworkCounts counts() { return {R::channels, M::channels, inputs, moments, detail, features, outputs}; }

    static std::int64_t encoder_planes(const KernelNetwork&) { return inputs; }

    static std::int64_t decoder_planes(const KernelNetwork& net) { return features + net.learned + detail; }

    static void encode(const KernelNetwork& net, const EncodeTile& tile, float* maps) {
        const network::Limits limits = limits_of(net);
        const int border = net.halo, high = tile.height + 2 * border, wide = tile.columns_count + 2 * border;
        for (int y = 0; y < high; ++y) {
            const float* const row = tile.stored + tile.rows[y] * tile.width * tile.read;
            const bool inside = y >= border && y < border + tile.height;
            for_packets<R::channels>(tile, row, wide, [&](int x, auto&& channel) {
                const auto texel = network::Texel<R, T>::of(channel);
                network::put_inputs(texel, limits, Walk{maps + y * net.tile_stride + x, net.tile_plane});
                if (!inside) return;
                // The halo to the left is no part of the latents: a packet that begins there is moved.
                float found[moments][lanes];
                network::put_moments(texel, limits, Walk{found[0], lanes});
                const int from = x < border ? border - x : 0, most = border + tile.columns_count - x;
                const int to = most < lanes ? most : lanes;
                float* const out = tile.out[y - border] + x - border;
                for (int z = 0; z < moments; ++z)
                    for (int lane = from; lane < to; ++lane) out[z * tile.plane + lane] = found[z][lane];
            });
        }
        encode_layers(net, tile, inputs, moments, maps);
    }

    // `latents`: planes of moments, learned ones and detail, scaled.
    static void decode(const KernelNetwork& net, const float* latents, int count, const float* bias, float* out,
                       float* maps) {
        const network::Limits limits = limits_of(net);
        network::Statistics<R, T> found[kChunk / lanes];
        for (int x = 0; x < count; x += lanes) {
            found[x / lanes] = network::statistics<R, T>(Means{latents + x, kPlane}, limits);
            network::put_features(found[x / lanes], Walk{maps + x, kPlane});
        }
        // What sharpening added stands behind what was learned, so that only the last layer reads it.
        float* const seen = maps + features * kPlane;
        for (std::int64_t i = 0; i < (net.learned + detail) * kPlane; ++i) seen[i] = latents[moments * kPlane + i];
        const float* const added = seen + net.learned * kPlane;
        const float* const said = decode_layers(net, maps, features + net.learned + detail, bias, count);
        for (int x = 0; x < count; x += lanes) {
            const auto outputs_of = network::Outputs<R, T>::of(Means{said + x, kPlane});
            const float* const crisp = said + outputs * kPlane + x;
            const auto more = network::Added<R, T>::of(Means{added + x, kPlane}, Means{crisp, kPlane});
            float channels[M::channels][lanes];
            network::put_channels<M>(found[x / lanes], outputs_of, more,
                                     Means{crisp + network::kCrisp * kPlane, kPlane}, limits, Walk{channels[0], lanes});
            store_texels(channels, count - x < lanes ? count - x : lanes, out + x * M::channels);
        }
    }
};

}  // namespace layers
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
