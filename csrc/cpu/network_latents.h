// The kernels of latent networks (models/latent_network.py), whose latents are all learned. The first layer of
// their encoder whitens: it has one tap and is not rectified.
#pragma once

#include "cpu/network_tiles.h"
#include "network/parameters.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace layers {

template <class R, class M>
struct LatentKernels {
    using Walk = network::Walk<T>;
    static constexpr int moments = 0, detail = 0;
    static constexpr int inputs = network::parameter_count<R>, outputs = network::parameter_count<M>;

    static NetworkCounts counts() { return {R::channels, M::channels, inputs, 0, 0, 0, outputs}; }

    static std::int64_t encoder_planes(const KernelNetwork& net) { return inputs + net.whiten.outputs; }

    static std::int64_t decoder_planes(const KernelNetwork& net) { return net.learned; }

    static void encode(const KernelNetwork& net, const EncodeTile& tile, float* maps) {
        const int border = net.halo, high = tile.height + 2 * border, wide = tile.columns_count + 2 * border;
        for (int y = 0; y < high; ++y) {
            const float* const row = tile.stored + tile.rows[y] * tile.width * tile.read;
            for_packets<R::channels>(tile, row, wide, [&](int x, auto&& channel) {
                network::put_parameters<R, T>(channel, Walk{maps + y * net.tile_stride + x, net.tile_plane});
            });
        }
        apply(net.whiten, maps, net.tile_stride, maps + inputs * net.tile_plane, net.tile_stride, net.tile_plane, high,
              wide);
        encode_layers(net, tile, encoder_planes(net), 0, maps);
    }

    static void decode(const KernelNetwork& net, const float* latents, int count, const float* bias, float* out,
                       float* maps) {
        const network::Limits limits = limits_of(net);
        for (std::int64_t i = 0; i < net.learned * kPlane; ++i) maps[i] = latents[i];
        const float* const said = decode_layers(net, maps, net.learned, bias, count);
        for (int x = 0; x < count; x += lanes) {
            float channels[M::channels][lanes];
            network::put_stored<M, T>({said + x, kPlane}, limits, Walk{channels[0], lanes});
            store_texels(channels, count - x < lanes ? count - x : lanes, out + x * M::channels);
        }
    }
};

}  // namespace layers
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
