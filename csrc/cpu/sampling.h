// Between the schedule of a lookup (sampling.cpp, compiled once) and its kernels (sampling_kernels.cpp, compiled once
// per instruction set). Lookups are numbered batch item by batch item.
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops.h"

namespace mipbake {

// Texel gradients are summed bin by bin. A bin is a band of 2^shift rows of one level, small enough for a cache, and
// owned by one thread; the bands of a level are numbered consecutively from first[level].
struct SampleBins {
    std::int64_t first[max_levels + 1];
    int shift[max_levels];
};

MIPBAKE_FOR_EACH_ISA(
    // Lookups [begin, end).
    template <class T> void sample_range(const SampleArgs<T>& args, T* out, std::int64_t begin, std::int64_t end);
    // Gradients of uv and lod of lookups [begin, end).
    template <class T> void sample_slopes_range(const SampleArgs<T>& args, const SampleGrads<T>& grads,
                                                std::int64_t begin, std::int64_t end);
    // Adds the texel gradients of lookups [begin, end) to every level.
    template <class T>
    void scatter_range(const SampleArgs<T>& args, const SampleGrads<T>& grads, std::int64_t begin, std::int64_t end);
    // Counts the lookups of [begin, end) that touch each bin.
    template <class T> void bins_count(const SampleArgs<T>& args, const SampleBins& bins, std::int64_t begin,
                                       std::int64_t end, std::uint32_t* counts);
    // Writes each of them, as an offset from `origin`, where its bin's cursor stands.
    template <class T>
    void bins_fill(const SampleArgs<T>& args, const SampleBins& bins, std::int64_t begin, std::int64_t end,
                   std::int64_t origin, std::uint32_t* cursors, std::uint32_t* lookups);
    // Adds the texel gradients of `count` listed lookups to one bin of `level`: rows [row_begin, row_end).
    template <class T>
    void scatter_bin(const SampleArgs<T>& args, const SampleGrads<T>& grads, int level, int row_begin, int row_end,
                     const std::uint32_t* lookups, std::int64_t count, std::int64_t origin);)

}  // namespace mipbake
