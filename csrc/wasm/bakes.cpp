// What bakes in JavaScript need of the core, as functions of C. Structures are those of ops.h, as wasm32 lays them out.
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <stdexcept>

#include "ops/blocks.h"
#include "ops/networks.h"
#include "ops/resample.h"

#define MIPBAKE_EXPORT(name) extern "C" __attribute__((export_name(#name)))

using NetworkHandle = std::shared_ptr<const mipbake::Network>;

// Memory for an array, aligned for every type; null where there is none left.
MIPBAKE_EXPORT(take) void* mipbake_take(std::size_t size) { return std::malloc(size); }
MIPBAKE_EXPORT(give) void mipbake_give(void* memory) { std::free(memory); }

MIPBAKE_EXPORT(network_begin) NetworkHandle* mipbake_network_begin(const mipbake::NetworkArgs* args) {
    if (args->kind != mipbake::NetworkKind::moments || args->made < 0 || args->made > 2)
        throw std::invalid_argument("this module has moment networks for gltf, gltf-anisotropic and ggx alone");
    return std::make_unique<NetworkHandle>(mipbake::packed_network(*args)).release();
}
MIPBAKE_EXPORT(network_end) void mipbake_network_end(NetworkHandle* network) {
    const std::unique_ptr<NetworkHandle> owned(network);
}

// Floats of the latents of so many texels of a row.
MIPBAKE_EXPORT(row_floats) std::int32_t mipbake_row_floats(const NetworkHandle* network, std::int32_t texels) {
    return static_cast<std::int32_t>(mipbake::NetworkBake::row_floats(**network, texels));
}

// What the arguments point to must live until bake_end, but for the network.
MIPBAKE_EXPORT(bake_begin)
mipbake::NetworkBake* mipbake_bake_begin(const NetworkHandle* network, const mipbake::NetworkBakeArgs* args,
                                         const mipbake::NetworkPart* part) {
    return std::make_unique<mipbake::NetworkBake>(*network, *args, *part).release();
}
// Bakes the next rows; gives how many rows of level 0 are done.
MIPBAKE_EXPORT(bake_advance) std::int32_t mipbake_bake_advance(mipbake::NetworkBake* bake) {
    bake->advance();
    return static_cast<std::int32_t>(bake->rows_done());
}
MIPBAKE_EXPORT(bake_end) void mipbake_bake_end(mipbake::NetworkBake* bake) {
    const std::unique_ptr<mipbake::NetworkBake> owned(bake);
}

MIPBAKE_EXPORT(resample) void mipbake_resample(const mipbake::ResampleArgs<float>* args, float* out) {
    mipbake::resample_cpu(*args, out);
}

MIPBAKE_EXPORT(encode_blocks) void mipbake_encode_blocks(const mipbake::BlockArgs* args, std::uint8_t* blocks) {
    if (args->format != mipbake::BlockFormat::uastc) throw std::invalid_argument("this module has UASTC alone");
    mipbake::encode_blocks_cpu(*args, blocks);
}
