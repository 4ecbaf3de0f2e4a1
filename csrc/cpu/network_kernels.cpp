// The encoders, the filters and the decoders of networks, compiled once per instruction set.
#include "cpu/network_latents.h"
#include "cpu/network_moments.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

#ifdef MIPBAKE_WASM_BAKES

// Calls f(K()) with the kernels for a network. The npm package's module is downloaded, so it has only the networks that
// csrc/wasm/bakes.cpp lets in: those that correct averages, of models with a GGX lobe.
template <class F>
decltype(auto) visit(const KernelNetwork& net, F&& f) {
    switch (net.made) {
        case 0:
            return f(layers::MomentKernels<network::Made<network::ReadGltf, false>>());
        case 1:
            return f(layers::MomentKernels<network::Made<network::ReadGltf, true>>());
        default:
            return f(layers::MomentKernels<network::Made<network::ReadGgx, false>>());
    }
}

#else

// Calls f(K()) with the kernels for a network.
template <class F>
decltype(auto) visit_latents(const KernelNetwork& net, F&& f) {
    return network::visit_model(net.read, [&](auto read) {
        return network::visit_model(
            net.made, [&](auto made) { return f(layers::LatentKernels<decltype(read), decltype(made)>()); });
    });
}

template <class F>
decltype(auto) visit(const KernelNetwork& net, F&& f) {
    if (net.kind == NetworkKind::latents) return visit_latents(net, f);
    return network::visit_model(net.made, [&](auto made) { return f(layers::MomentKernels<decltype(made)>()); });
}

#endif

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

namespace {

// P packets of a channel, which stay in registers while all taps are added.
template <int P, float AddTap::* weight>
MIPBAKE_INLINE void add_packets(const AddRow& add, std::int64_t at, const float* from, float* into) {
    T sums[P];
    const AddTap* tap = add.taps;
    if (from == nullptr) {
        for (int p = 0; p < P; ++p) sums[p] = load(tap->row + at + p * lanes) * T(tap->*weight);
        ++tap;
    } else {
        for (int p = 0; p < P; ++p) sums[p] = load(from + p * lanes);
    }
    for (; tap != add.taps + add.count; ++tap) {
        const T each(tap->*weight);
        for (int p = 0; p < P; ++p) sums[p] += load(tap->row + at + p * lanes) * each;
    }
    for (int p = 0; p < P; ++p) store_lanes(into + p * lanes, sums[p]);
}

// Columns of a channel: `at` is where they begin in the rows that are added.
template <float AddTap::* weight>
MIPBAKE_INLINE void add_channel(const AddRow& add, std::int64_t at, std::int64_t count, std::int64_t sums_at) {
    constexpr int some = 4;
    const float* const from = add.from == nullptr ? nullptr : add.from + sums_at;
    float* const into = add.into + sums_at;
    const auto behind = [from](std::int64_t x) { return from == nullptr ? nullptr : from + x; };
    std::int64_t x = 0;
    for (; x + some * lanes <= count; x += some * lanes) add_packets<some, weight>(add, at + x, behind(x), into + x);
    for (; x + lanes <= count; x += lanes) add_packets<1, weight>(add, at + x, behind(x), into + x);
    for (; x < count; ++x) {
        float sum = from == nullptr ? 0.0f : from[x];
        for (int k = 0; k < add.count; ++k) sum += add.taps[k].row[at + x] * (add.taps[k].*weight);
        into[x] = sum;
    }
}

}  // namespace

void network_add(const AddTile& tile) {
    for (const AddRow* row = tile.rows; row != tile.rows + tile.rows_count; ++row) {
        for (std::int64_t z = 0; z < tile.channels; ++z)
            add_channel<&AddTap::sharp>(*row, z * tile.row_plane + tile.begin, tile.count,
                                        z * tile.sums_plane + tile.place);
        for (std::int64_t z = 0; z < tile.detail; ++z)
            add_channel<&AddTap::plain>(*row, z * tile.row_plane + tile.begin, tile.count,
                                        (tile.channels + z) * tile.sums_plane + tile.place);
    }
}

void network_transpose(const float* planes, std::int64_t plane, std::int64_t channels, std::int64_t count, float* out,
                       std::int64_t stride) {
    constexpr std::int64_t some = 16;
    for (std::int64_t x0 = 0; x0 < count; x0 += some) {
        const std::int64_t x1 = x0 + some < count ? x0 + some : count;
        for (std::int64_t z = 0; z < channels; ++z)
            for (std::int64_t x = x0; x < x1; ++x) out[x * stride + z] = planes[z * plane + x];
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
