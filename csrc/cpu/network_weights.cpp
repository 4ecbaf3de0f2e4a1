#include "cpu/network_weights.h"

#include <algorithm>
#include <memory>
#include <stdexcept>

namespace mipbake {

using Index = std::int64_t;

namespace {

PackedMemory packed(const NetworkLayer& given, std::vector<std::int32_t> offsets, bool rectified) {
    const Index block = MIPBAKE_DISPATCH(network_block)(), blocks = (given.outputs + block - 1) / block;
    const Index inputs = given.inputs * given.taps;
    PackedMemory out = {Floats(blocks * block * inputs), Floats(blocks * block), std::move(offsets), {}};
    // Inputs with their taps side by side: (outputs, inputs, taps) as they are.
    MIPBAKE_DISPATCH(network_pack)(given.weight, given.outputs, inputs, blocks, out.weight.data());
    std::copy_n(given.bias, given.outputs, out.bias.data());
    out.packed = {out.weight.data(), out.bias.data(), out.offsets.data(), blocks * block, inputs, rectified};
    return out;
}

void check(const NetworkLayer& layer, Index inputs) {
    if (layer.inputs != inputs || layer.outputs < 1) throw std::invalid_argument("layers of a network do not fit");
}

}  // namespace

Network::Network(const NetworkArgs& args) : counts(network_counts(args.kind, args.read, args.made)) {
    Index convolutions = 0;
    for (int i = 0; i < args.encoder_layers; ++i) convolutions += args.encoder[i].taps == 9 ? 1 : 0;
    kernel.kind = args.kind;
    kernel.read = args.read;
    kernel.made = args.made;
    kernel.limits = args.limits;
    kernel.moments = counts.moments;
    kernel.learned = args.project.outputs;
    kernel.detail = counts.detail;
    kernel.channels = counts.made;
    kernel.halo = static_cast<int>(convolutions);
    kernel.convolutions = kernel.halo;
    kernel.tile_stride = rounded_up(kTile + 2 * kernel.halo, kSlack) + 2 * kSlack;
    kernel.tile_plane = (kBand + 2 * kernel.halo) * kernel.tile_stride + kSlack;
    // Planes of the encoder: the inputs, whitened ones, then what each layer adds, whole blocks of it.
    std::vector<Index> seen;
    for (Index i = 0; i < counts.inputs; ++i) seen.push_back(i);
    const auto offsets = [&](int taps) {
        std::vector<std::int32_t> out;
        for (const Index plane : seen)
            for (int tap = 0; tap < taps; ++tap) {
                const Index moved = taps == 1 ? 0 : (tap / 3 - 1) * kernel.tile_stride + tap % 3 - 1;
                out.push_back(static_cast<std::int32_t>(plane * kernel.tile_plane + moved));
            }
        return out;
    };
    Index planes = counts.inputs;
    if (args.kind == NetworkKind::latents) {
        check(args.whiten, counts.inputs);
        whiten_ = packed(args.whiten, offsets(1), false);
        kernel.whiten = whiten_.packed;
        for (Index i = 0; i < counts.inputs; ++i) seen[static_cast<std::size_t>(i)] = planes + i;
        planes += whiten_.packed.outputs;
    }
    for (int i = 0; i < args.encoder_layers; ++i) {
        const NetworkLayer& layer = args.encoder[i];
        check(layer, static_cast<Index>(seen.size()));
        layers_.push_back(packed(layer, offsets(layer.taps), true));
        for (Index g = 0; g < layer.outputs; ++g) seen.push_back(planes + g);
        planes += layers_.back().packed.outputs;
    }
    check(args.project, static_cast<Index>(seen.size()));
    layers_.push_back(packed(args.project, offsets(1), false));
    const auto first_of_decoder = layers_.size();
    // Planes of the decoder: features, learned latents, what sharpening added, then what each layer adds.
    constexpr Index plane = kChunk + kSlack;
    std::vector<std::int32_t> maps;
    const Index known = counts.features + kernel.learned;
    for (Index i = 0; i < known; ++i) maps.push_back(static_cast<std::int32_t>(i * plane));
    planes = known + counts.detail;
    for (int i = 0; i < args.decoder_layers; ++i) {
        const bool last = i + 1 == args.decoder_layers;
        if (last)
            for (Index d = 0; d < counts.detail; ++d) maps.push_back(static_cast<std::int32_t>((known + d) * plane));
        check(args.decoder[i], static_cast<Index>(maps.size()));
        layers_.push_back(packed(args.decoder[i], maps, !last));
        for (Index g = 0; g < args.decoder[i].outputs; ++g)
            maps.push_back(static_cast<std::int32_t>((planes + g) * plane));
        planes += layers_.back().packed.outputs;
        biases_.push_back({args.decoder[i].outputs, layers_.back().packed.outputs});
    }
    if (args.decoder[args.decoder_layers - 1].outputs < counts.outputs + (args.kind == NetworkKind::moments ? 3 : 0))
        throw std::invalid_argument("the last layer of a decoder makes too few numbers");
    for (const PackedMemory& layer : layers_) packed_.push_back(layer.packed);
    kernel.encoder = packed_.data();
    kernel.encoder_layers = args.encoder_layers;
    kernel.project = packed_[first_of_decoder - 1];
    kernel.decoder = packed_.data() + first_of_decoder;
    kernel.decoder_layers = args.decoder_layers;
}

std::vector<float> Network::padded(const float* bias) const {
    std::vector<float> out;
    for (const auto& [own, whole] : biases_) {
        out.insert(out.end(), bias, bias + own);
        out.insert(out.end(), static_cast<std::size_t>(whole - own), 0.0f);
        bias += own;
    }
    return out;
}

NetworkCounts network_counts(NetworkKind kind, int read, int made) {
    return MIPBAKE_DISPATCH(network_kernel_counts)(kind, read, made);
}

std::shared_ptr<const Network> packed_network(const NetworkArgs& args) { return std::make_shared<const Network>(args); }

}  // namespace mipbake
