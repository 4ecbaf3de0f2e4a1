// Between the schedule of texture lookups (texture.cpp, compiled once) and their kernels (texture_*_kernels.cpp,
// compiled once per instruction set). Lookups are numbered batch item by batch item.
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops/texture.h"

namespace mipbake {

// Texel gradients are summed bin by bin. A bin is a band of 2^shift rows of one level, small enough for a cache, and
// owned by one thread; the bands of a level are numbered consecutively from first[level]. The rows of a cube's faces
// count on from face to face. A level that another pass sums has no bands.
struct TextureBins {
    std::int64_t first[max_levels + 1];
    int shift[max_levels];
};

// One entry of a bin's list: the lookup's offset from the sort's origin, times `taps`, plus the number of the tap.
struct BinList {
    const std::uint32_t* entries;
    std::int64_t count, origin;  // origin: the first lookup of the sort
};

MIPBAKE_FOR_EACH_ISA(
    // Lookups [begin, end). `zeros` is a texel of zeros.
    template <class T>
    void texture_range(const TextureArgs<T>& args, const void* zeros, T* out, std::int64_t begin, std::int64_t end);
    // The two steps of lookups [begin, end), which are all of one batch item.
    void texture_taps_range(const TextureArgs<float>& args, std::int64_t begin, std::int64_t end, std::int64_t* texels,
                            float* fractions);
    void texture_quads_range(const TexelQuads& quads, std::int64_t begin, std::int64_t end, float* out);
    // Gradients of uv, uv_da and bias of lookups [begin, end).
    template <class T> void texture_slopes_range(const TextureArgs<T>& args, const void* zeros,
                                                 const TextureGrads<T>& grads, std::int64_t begin, std::int64_t end);
    // Adds the texel gradients of lookups [begin, end) to every level.
    template <class T> void texture_scatter_range(const TextureArgs<T>& args, const TextureGrads<T>& grads,
                                                  std::int64_t begin, std::int64_t end);
    // Counts the lookups (or taps) of [begin, end) that touch each bin.
    template <class T> void texture_bins_count(const TextureArgs<T>& args, const TextureBins& bins, std::int64_t begin,
                                               std::int64_t end, std::uint32_t* counts);
    // Writes each of them where its bin's cursor stands.
    template <class T>
    void texture_bins_fill(const TextureArgs<T>& args, const TextureBins& bins, std::int64_t begin, std::int64_t end,
                           std::int64_t origin, std::uint32_t* cursors, std::uint32_t* entries);
    // Adds the texel gradients of a list to rows [row_begin, row_end) of `level`.
    template <class T> void texture_scatter_bin(const TextureArgs<T>& args, const TextureGrads<T>& grads, int level,
                                                std::int64_t row_begin, std::int64_t row_end, const BinList& list);
    // Rows [begin, end) of the output, counted on from image to image.
    void mip_rows(const MipShape& shape, Storage storage, const void* level, void* out, std::int64_t begin,
                  std::int64_t end);
    // Adds to rows [begin, end) of the finer level's gradient.
    template <class T>
    void mip_backward_rows(const MipShape& shape, const T* grad_out, T* grad, std::int64_t begin, std::int64_t end);)

}  // namespace mipbake
