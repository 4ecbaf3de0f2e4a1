// How lookups are shared among threads. Outputs and slopes are independent per lookup; sums into texels are not, and
// each texel is always summed by one thread in the order of the lookups, so that results never depend on the schedule:
//
// - small stacks with an item for every thread: a task is a batch item;
// - otherwise the rows of every level are cut into bins, the lookups are sorted by bin (a stable counting sort), and a
//   task is a bin. Random lookups in a large texture then accumulate in cache.
#include "cpu/sampling.h"

#include <algorithm>
#include <vector>

#include "core/parallel.h"

#ifdef __linux__
#include <sys/mman.h>
#endif

namespace mipbake {
namespace {

using Index = std::int64_t;

constexpr Index lookups_per_task = 2048;
constexpr Index lookups_per_sort = Index(1)
                                   << 22;  // bounds the memory of the sort: 16 MB for each bin a lookup touches
constexpr Index chunks_per_sort = 64;
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
Index texel_count(const TextureLevel<T>& level) {
    return Index(level.height) * level.width;
}

template <class T>
SampleBins choose_bins(const SampleArgs<T>& args) {
    SampleBins bins{};
    for (int l = 0; l < args.level_count; ++l) {
        const Index row_bytes = Index(args.levels[l].width) * args.channels * Index(sizeof(T));
        const int height = args.levels[l].height;
        int shift = 0;
        while ((row_bytes << (shift + 1)) <= bin_bytes && (height >> shift) > 1) ++shift;
        while (shift > min_band_shift && (height >> shift) < min_bands) --shift;
        while ((height >> shift) > max_bands) ++shift;
        bins.shift[l] = shift;
        bins.first[l + 1] = bins.first[l] + ((Index(height) - 1) >> shift) + 1;
    }
    return bins;
}

// Adds the texel gradients of lookups [begin, end) to the levels, bin by bin.
template <class T>
void scatter_binned(const SampleArgs<T>& args, const SampleGrads<T>& grads, Index begin, Index end) {
    const SampleBins bins = choose_bins(args);
    const Index bin_count = bins.first[args.level_count];
    std::vector<std::uint32_t> cursors, lookups;
    std::vector<Index> bin_begin(static_cast<std::size_t>(bin_count) + 1);
    for (Index origin = begin; origin < end; origin += lookups_per_sort) {
        const Index count = std::min(lookups_per_sort, end - origin);
        const Index grain = std::max(lookups_per_task, (count + chunks_per_sort - 1) / chunks_per_sort);
        const Index chunks = (count + grain - 1) / grain;
        cursors.assign(static_cast<std::size_t>(chunks * bin_count), 0);
        parallel_for(count, grain, [&](Index from, Index to) {
            MIPBAKE_DISPATCH(bins_count<T>)
            (args, bins, origin + from, origin + to, cursors.data() + from / grain * bin_count);
        });
        Index total = 0;
        for (Index bin = 0; bin < bin_count; ++bin) {
            bin_begin[static_cast<std::size_t>(bin)] = total;
            for (Index chunk = 0; chunk < chunks; ++chunk) {
                std::uint32_t& cursor = cursors[static_cast<std::size_t>(chunk * bin_count + bin)];
                const std::uint32_t size = cursor;
                cursor = static_cast<std::uint32_t>(total);
                total += size;
            }
        }
        bin_begin[static_cast<std::size_t>(bin_count)] = total;
        lookups.resize(static_cast<std::size_t>(total));
        parallel_for(count, grain, [&](Index from, Index to) {
            MIPBAKE_DISPATCH(bins_fill<T>)
            (args, bins, origin + from, origin + to, origin, cursors.data() + from / grain * bin_count, lookups.data());
        });
        parallel_for(bin_count, 1, [&](Index bin, Index) {
            int level = 0;
            while (bin >= bins.first[level + 1]) ++level;
            const Index row_begin = (bin - bins.first[level]) << bins.shift[level];
            const Index row_end =
                std::min<Index>(args.levels[level].height, row_begin + (Index(1) << bins.shift[level]));
            if (origin == begin) {
                const Index item = grads.level_batch > 1 ? begin / args.points : 0;
                const Index row = Index(args.levels[level].width) * args.channels;
                T* const target = grads.levels[level] + item * args.levels[level].height * row;
                std::fill(target + row_begin * row, target + row_end * row, T(0));
            }
            const Index first = bin_begin[static_cast<std::size_t>(bin)];
            const Index listed = bin_begin[static_cast<std::size_t>(bin) + 1] - first;
            MIPBAKE_DISPATCH(scatter_bin<T>)
            (args, grads, level, static_cast<int>(row_begin), static_cast<int>(row_end), lookups.data() + first, listed,
             origin);
        });
    }
}

template <class T>
void scatter_item(const SampleArgs<T>& args, const SampleGrads<T>& grads, Index item, Index begin, Index end) {
    for (int l = 0; l < args.level_count; ++l) {
        const Index size = texel_count(args.levels[l]) * args.channels;
        std::fill_n(grads.levels[l] + item * size, size, T(0));
    }
    MIPBAKE_DISPATCH(scatter_range<T>)(args, grads, begin, end);
}

template <class T>
void scatter(const SampleArgs<T>& args, const SampleGrads<T>& grads) {
    const Index items = grads.level_batch, lookups_per_item = args.batch * args.points / items;
    Index bytes = 0;
    for (int l = 0; l < args.level_count; ++l) bytes += texel_count(args.levels[l]) * args.channels * Index(sizeof(T));
    const bool whole_items = items >= num_threads() || lookups_per_item < 2 * lookups_per_task;
    if ((bytes <= small_stack_bytes && whole_items) || lookups_per_item == 0) {
        parallel_for(items, 1, [&](Index item, Index) {
            scatter_item(args, grads, item, item * lookups_per_item, (item + 1) * lookups_per_item);
        });
    } else {
        for (int l = 0; l < args.level_count; ++l)
            prefer_large_pages(grads.levels[l], items * texel_count(args.levels[l]) * args.channels * Index(sizeof(T)));
        for (Index item = 0; item < items; ++item)
            scatter_binned(args, grads, item * lookups_per_item, (item + 1) * lookups_per_item);
    }
}

}  // namespace

template <class T>
void sample_cpu(const SampleArgs<T>& args, T* out) {
    prefer_large_pages(out, args.batch * args.points * args.channels * Index(sizeof(T)));
    parallel_for(args.batch * args.points, lookups_per_task,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(sample_range<T>)(args, out, begin, end); });
}

template <class T>
void sample_backward_cpu(const SampleArgs<T>& args, const SampleGrads<T>& grads) {
    if (grads.levels[0] != nullptr) scatter(args, grads);
    if (grads.uv == nullptr && grads.lod == nullptr) return;
    parallel_for(args.batch * args.points, lookups_per_task,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(sample_slopes_range<T>)(args, grads, begin, end); });
}

template void sample_cpu<float>(const SampleArgs<float>&, float*);
template void sample_cpu<double>(const SampleArgs<double>&, double*);
template void sample_backward_cpu<float>(const SampleArgs<float>&, const SampleGrads<float>&);
template void sample_backward_cpu<double>(const SampleArgs<double>&, const SampleGrads<double>&);

}  // namespace mipbake
