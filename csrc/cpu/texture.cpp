// How lookups are shared among threads. Outputs and slopes are independent per lookup; sums into texels are not, and
// each texel is always summed by one thread in the order of the lookups, so that results never depend on the schedule:
//
// - small stacks with an item for every thread: a task is a batch item;
// - otherwise the rows of every level are cut into bins, the lookups are sorted by bin (core/bins.h), and a task is a
//   bin. Random lookups in a large texture then accumulate in cache.
#include "cpu/texture.h"

#include <algorithm>
#include <vector>

#include "core/bins.h"
#include "core/parallel.h"

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace mipbake {
namespace {

using Index = std::int64_t;

constexpr Index lookups_per_task = 2048;
constexpr Index taps_per_sort = Index(1) << 18;  // lookups of up to 16 taps each
constexpr Index bin_bytes = Index(1) << 18;
constexpr Index small_stack_bytes = Index(1) << 19;
constexpr int max_bands = 1024;
constexpr int min_bands = 8;  // of a level with rows enough, so that small levels occupy more than one thread
constexpr int min_band_shift = 2;

// Asks for large pages, as NumPy does for its own arrays: a large result is memory that was never touched, and faulting
// it in by 4 KB takes longer than filling it.
void prefer_large_pages(void* data, Index bytes) {
#if defined(__linux__) && defined(MADV_HUGEPAGE)
    constexpr std::uintptr_t large_page = std::uintptr_t(1) << 21;
    if (bytes < static_cast<Index>(2 * large_page)) return;
    const std::uintptr_t begin = reinterpret_cast<std::uintptr_t>(data),
                         end = begin + static_cast<std::uintptr_t>(bytes);
    const std::uintptr_t first = (begin + large_page - 1) & ~(large_page - 1), last = end & ~(large_page - 1);
    if (first < last) madvise(reinterpret_cast<void*>(first), last - first, MADV_HUGEPAGE);
#else
    static_cast<void>(data);
    static_cast<void>(bytes);
#endif
}

template <class T>
Index rows_of(const TextureArgs<T>& args, int level) {
    return Index(args.heights[level]) * (args.boundary_u == Boundary::cube ? 6 : 1);
}

template <class T>
Index size_of(const TextureArgs<T>& args, int level) {
    return rows_of(args, level) * args.widths[level] * args.channels;
}

// The levels that a filter reads; the gradients of the others are zeros.
template <class T>
int used_levels(const TextureArgs<T>& args) {
    return args.filter == Filter::nearest || args.filter == Filter::linear ? 1 : args.level_count;
}

// Bands for the levels whose gradients have `level_batch` items.
template <class T>
TextureBins choose_bins(const TextureArgs<T>& args, const TextureGrads<T>& grads, Index level_batch) {
    TextureBins bins{};
    for (int l = 0; l < args.level_count; ++l) {
        const Index row_bytes = Index(args.widths[l]) * args.channels * Index(sizeof(T)), rows = rows_of(args, l);
        int shift = 0;
        while ((row_bytes << (shift + 1)) <= bin_bytes && (rows >> shift) > 1) ++shift;
        while (shift > min_band_shift && (rows >> shift) < min_bands) --shift;
        while ((rows >> shift) > max_bands) ++shift;
        bins.shift[l] = shift;
        bins.first[l + 1] = bins.first[l] + (grads.level_batch[l] == level_batch ? ((rows - 1) >> shift) + 1 : 0);
    }
    return bins;
}

// Sums the texel gradients of lookups [begin, end) into the levels of `bins`.
template <class T>
void scatter_binned(const TextureArgs<T>& args, const TextureGrads<T>& grads, const TextureBins& bins, Index item,
                    Index begin, Index end) {
    BinLimits limits;
    if (args.filter == Filter::anisotropic) limits.items_per_sort = taps_per_sort;
    for_each_bin(
        end - begin, bins.first[args.level_count],
        [&](Index from, Index to, std::uint32_t* counts) {
            MIPBAKE_DISPATCH(texture_bins_count<T>)(args, bins, begin + from, begin + to, counts);
        },
        [&](Index from, Index to, std::uint32_t* cursors, std::uint32_t* entries, Index origin) {
            MIPBAKE_DISPATCH(texture_bins_fill<T>)
            (args, bins, begin + from, begin + to, begin + origin, cursors, entries);
        },
        [&](Index bin, const std::uint32_t* entries, Index count, Index origin) {
            int level = 0;
            while (bin >= bins.first[level + 1]) ++level;
            const Index row_begin = (bin - bins.first[level]) << bins.shift[level];
            const Index row_end = std::min(rows_of(args, level), row_begin + (Index(1) << bins.shift[level]));
            if (origin == 0) {
                const Index row = Index(args.widths[level]) * args.channels;
                T* const target = grads.levels[level] + item * size_of(args, level);
                std::fill(target + row_begin * row, target + row_end * row, T(0));
            }
            MIPBAKE_DISPATCH(texture_scatter_bin<T>)
            (args, grads, level, row_begin, row_end, BinList{entries, count, begin + origin});
        },
        limits);
}

template <class T>
void scatter(const TextureArgs<T>& args, const TextureGrads<T>& grads) {
    const Index lookups = args.batch * args.points;
    Index bytes = 0;
    bool is_own = true;  // whether every item has gradients of its own
    for (int l = 0; l < args.level_count; ++l) {
        bytes += size_of(args, l) * Index(sizeof(T));
        is_own = is_own && grads.level_batch[l] == args.batch;
    }
    if (is_own && args.batch >= num_threads() && bytes <= small_stack_bytes) {
        parallel_for(args.batch, 1, [&](Index item, Index) {
            for (int l = 0; l < args.level_count; ++l)
                std::fill_n(grads.levels[l] + item * size_of(args, l), size_of(args, l), T(0));
            MIPBAKE_DISPATCH(texture_scatter_range<T>)(args, grads, item * args.points, (item + 1) * args.points);
        });
        return;
    }
    for (int l = 0; l < args.level_count; ++l)
        prefer_large_pages(grads.levels[l], grads.level_batch[l] * size_of(args, l) * Index(sizeof(T)));
    if (args.batch > 1) {
        const TextureBins own = choose_bins(args, grads, args.batch);
        for (Index item = 0; item < args.batch && own.first[args.level_count] > 0; ++item)
            scatter_binned(args, grads, own, item, item * args.points, (item + 1) * args.points);
    }
    const TextureBins shared = choose_bins(args, grads, Index(1));
    if (shared.first[args.level_count] > 0) scatter_binned(args, grads, shared, 0, 0, lookups);
}

template <class T>
std::vector<T> zero_texel(const TextureArgs<T>& args) {
    return std::vector<T>(static_cast<std::size_t>(args.channels), T(0));  // zeros in every storage type
}

}  // namespace

template <class T>
void texture_cpu(const TextureArgs<T>& args, T* out) {
    const std::vector<T> zeros = zero_texel(args);
    prefer_large_pages(out, args.batch * args.points * args.channels * Index(sizeof(T)));
    parallel_for(args.batch * args.points, lookups_per_task, [&](Index begin, Index end) {
        MIPBAKE_DISPATCH(texture_range<T>)(args, zeros.data(), out, begin, end);
    });
}

void texture_taps_cpu(const TextureArgs<float>& args, Index* texels, float* fractions) {
    parallel_for(args.points, lookups_per_task, [&](Index begin, Index end) {
        MIPBAKE_DISPATCH(texture_taps_range)(args, begin, end, texels, fractions);
    });
}

void texture_quads_cpu(const TexelQuads& quads, float* out) {
    parallel_for(quads.points, lookups_per_task,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(texture_quads_range)(quads, begin, end, out); });
}

template <class T>
void texture_backward_cpu(const TextureArgs<T>& args, const TextureGrads<T>& grads) {
    if (grads.levels[0] != nullptr) scatter(args, grads);
    if (grads.uv == nullptr && grads.uv_da == nullptr && grads.bias == nullptr) return;
    const std::vector<T> zeros = zero_texel(args);
    parallel_for(args.batch * args.points, lookups_per_task, [&](Index begin, Index end) {
        MIPBAKE_DISPATCH(texture_slopes_range<T>)(args, zeros.data(), grads, begin, end);
    });
}

void texture_mip_cpu(const MipShape& shape, Storage storage, const void* level, void* out) {
    const Index rows = shape.images * std::max(1, shape.height / 2);
    const Index row = Index(shape.width) * shape.channels;
    const Index elements = rows * std::max(1, shape.width / 2) * shape.channels;
    const Index bytes = storage == Storage::float64 ? 8 : storage == Storage::float32 ? 4 : 2;
    prefer_large_pages(out, elements * bytes);
    parallel_for(rows, std::max<Index>(1, (Index(1) << 15) / std::max<Index>(1, row)),
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(mip_rows)(shape, storage, level, out, begin, end); });
}

template <class T>
void texture_mip_backward_cpu(const MipShape& shape, const T* grad_out, T* grad) {
    const Index rows = shape.images * shape.height, row = Index(shape.width) * shape.channels;
    parallel_for(rows, std::max<Index>(1, (Index(1) << 15) / std::max<Index>(1, row)), [&](Index begin, Index end) {
        MIPBAKE_DISPATCH(mip_backward_rows<T>)(shape, grad_out, grad, begin, end);
    });
}

template void texture_cpu<float>(const TextureArgs<float>&, float*);
template void texture_cpu<double>(const TextureArgs<double>&, double*);
template void texture_backward_cpu<float>(const TextureArgs<float>&, const TextureGrads<float>&);
template void texture_backward_cpu<double>(const TextureArgs<double>&, const TextureGrads<double>&);
template void texture_mip_backward_cpu<float>(const MipShape&, const float*, float*);
template void texture_mip_backward_cpu<double>(const MipShape&, const double*, double*);

}  // namespace mipbake
