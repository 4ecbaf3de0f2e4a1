// The encoders, the filters and the decoders of networks, compiled once per instruction set.
#include "cpu/network_latents.h"
#include "cpu/network_moments.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

// Calls f(K()) with the kernels for a network.
template <class F>
decltype(auto) visit_latents(const KernelNetwork& net, F&& f) {
    return layers::visit_model(net.read, [&](auto read) {
        return layers::visit_model(
            net.made, [&](auto made) { return f(layers::LatentKernels<decltype(read), decltype(made)>()); });
    });
}

template <class F>
decltype(auto) visit(const KernelNetwork& net, F&& f) {
    if (net.kind == NetworkKind::latents) return visit_latents(net, f);
    return layers::visit_model(net.made, [&](auto made) { return f(layers::MomentKernels<decltype(made)>()); });
}

}  // namespace

using layers::lanes;
using layers::load;
using layers::T;

int network_block() { return layers::kBlock; }

NetworkCounts network_kernel_counts(NetworkKind kind, int read, int made) {
    KernelNetwork net{};
    net.kind = kind;
    net.read = read;
    net.made = made;
    return visit(net, [](auto kernels) { return decltype(kernels)::counts(); });
}

void network_pack(const float* weight, std::int64_t outputs, std::int64_t inputs, std::int64_t blocks, float* packed) {
    for (std::int64_t block = 0; block < blocks; ++block)
        for (std::int64_t k = 0; k < inputs; ++k)
            for (int g = 0; g < layers::kBlock; ++g) {
                const std::int64_t row = block * layers::kBlock + g;
                *packed++ = row < outputs ? weight[row * inputs + k] : 0.0f;
            }
}

std::int64_t network_encode_scratch(const KernelNetwork& net) {
    return visit(net, [&](auto kernels) { return layers::encode_floats(net, decltype(kernels)::encoder_planes(net)); });
}

void network_encode(const KernelNetwork& net, const EncodeTile& tile, float* scratch) {
    visit(net, [&](auto kernels) { kernels.encode(net, tile, scratch); });
}

std::int64_t network_decode_scratch(const KernelNetwork& net, int reach) {
    return visit(net, [&](auto kernels) {
        using K = decltype(kernels);
        return layers::tile_floats<K>(net, reach) + layers::decode_floats(net, K::decoder_planes(net)) + kSlack;
    });
}

void network_top(const KernelNetwork& net, const TopTile& tile, float* scratch) {
    visit(net, [&](auto kernels) { layers::top_tile<decltype(kernels)>(net, tile, scratch); });
}

void network_across(const KernelNetwork& net, const AcrossTile& tile, float* scratch) {
    visit(net, [&](auto kernels) { layers::across_tile<decltype(kernels)>(net, tile, scratch); });
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
