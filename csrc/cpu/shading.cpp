#include "cpu/shading.h"

#include <algorithm>
#include <vector>

#include "core/parallel.h"
#include "shading/models.h"

namespace mipbake {

int model_count() { return Models::size; }

ModelInfo model_info(int index) {
    ModelInfo info{"", 0};
    Models::visit(index, [&](auto model) { info = {model.name, model.channels}; });
    return info;
}

namespace {

// What a work item should hold, in evaluations: long against the cost of handing it out, short against the whole.
constexpr std::int64_t kEvaluationsPerItem = 16384;

// The pairs of every batch element, or of one where all share it. Computed here, once, because every texel needs them;
// none where texels have directions of their own.
class Pairs {
  public:
    explicit Pairs(const ShadeArgs& args) : bytes_(MIPBAKE_DISPATCH(shade_pair_bytes)(args.is_double)), K_(args.K) {
        shared_ = args.light.strides[0] == 0 && args.view.strides[0] == 0;
        if (args.per_texel()) return;
        const std::int64_t count = (shared_ ? 1 : args.B) * K_;
        storage_.resize(static_cast<std::size_t>(count * bytes_));
        const auto make = MIPBAKE_DISPATCH(shade_make_pairs);
        parallel_for(count, 4096, [&](std::int64_t begin, std::int64_t end) {
            for (std::int64_t i = begin; i < end;) {  // one batch element at a time
                const std::int64_t b = i / K_, k0 = i % K_, k1 = std::min(K_, k0 + end - i);
                make(args, b, k0, k1, storage_.data() + i * bytes_);
                i += k1 - k0;
            }
        });
    }

    const void* of(std::int64_t b) const {
        return storage_.empty() ? nullptr : storage_.data() + (shared_ ? 0 : b) * K_ * bytes_;
    }

  private:
    std::int64_t bytes_, K_;
    bool shared_;
    std::vector<unsigned char> storage_;
};

}  // namespace

void shade_cpu(const ShadeArgs& args, void* radiance) {
    if (args.B * args.K * args.N == 0) return;
    const Pairs pairs(args);
    // Few texels and many pairs are split over the pairs too; preparing a texel again costs as much as a few pairs.
    const std::int64_t chunk = std::max<std::int64_t>(256, kEvaluationsPerItem / std::min<std::int64_t>(args.N, 64));
    const std::int64_t blocks = (args.N + kTexelBlock - 1) / kTexelBlock, chunks = (args.K + chunk - 1) / chunk;
    const std::int64_t per_block = std::min<std::int64_t>(args.N, kTexelBlock) * std::min(args.K, chunk);
    const auto tile = MIPBAKE_DISPATCH(shade_tile);
    parallel_for(args.B * blocks * chunks, kEvaluationsPerItem / per_block, [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
            const std::int64_t k0 = i % chunks * chunk, n0 = i / chunks % blocks * kTexelBlock, b = i / chunks / blocks;
            const ShadeTile t{b, n0, std::min(args.N, n0 + kTexelBlock), k0, std::min(args.K, k0 + chunk)};
            tile(args, t, pairs.of(b), radiance);
        }
    });
}

void shade_backward_cpu(const ShadeArgs& args, const void* grad_radiance, void* grad_material, bool duals) {
    if (args.B * args.N == 0) return;
    const Pairs pairs(args);
    // A texel's sum over the pairs is never split, so its order, and with it every bit, is the same on any machine with
    // the same instruction set.
    const std::int64_t blocks = (args.N + kTexelBlock - 1) / kTexelBlock;
    const std::int64_t per_block = std::min<std::int64_t>(args.N, kTexelBlock) * std::max<std::int64_t>(args.K, 1);
    const auto tile = duals ? shade_backward_duals_tile : MIPBAKE_DISPATCH(shade_backward_tile);
    parallel_for(args.B * blocks, kEvaluationsPerItem / per_block, [&](std::int64_t begin, std::int64_t end) {
        for (std::int64_t i = begin; i < end; ++i) {
            const std::int64_t n0 = i % blocks * kTexelBlock, b = i / blocks;
            const ShadeTile t{b, n0, std::min(args.N, n0 + kTexelBlock), 0, args.K};
            tile(args, t, pairs.of(b), grad_radiance, grad_material);
        }
    });
}

}  // namespace mipbake
