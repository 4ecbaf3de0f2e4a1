// Sums of many contributions into shared places, reproducible bit for bit whatever the number of threads.
//
// The places are cut into bins, small enough for a cache. The items that contribute are sorted by the bins they touch
// (a stable counting sort, an item in every bin it touches), and then one thread at a time owns a bin and takes its
// items in their order. Random contributions to a large array then accumulate in cache.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/parallel.h"

namespace mipbake {

struct BinLimits {
    std::int64_t items_per_sort = std::int64_t(1) << 22;  // bounds the scratch: 4 bytes for each bin an item touches
    std::int64_t items_per_chunk = 2048;                  // at least, of the two passes of a sort
    std::int64_t chunks_per_sort = 64;                    // at most; each has a counter per bin
};

// Calls
//     count(begin, end, counts)                ++counts[bin] for every bin that items [begin, end) touch
//     fill(begin, end, cursors, list, origin)  list[cursors[bin]++] = item - origin for each of them, in their order
//     work(bin, list, size, origin)            adds what the `size` listed items contribute to the bin
//
// `work` is called for every bin, also where no item touches it, once for each sort: with origin 0 first, so that this
// is where a bin sets its places to zero. The three run in parallel on disjoint ranges and bins, and must not throw.
template <class Count, class Fill, class Work>
void for_each_bin(std::int64_t items, std::int64_t bins, Count&& count, Fill&& fill, Work&& work,
                  const BinLimits& limits = {}) {
    using Index = std::int64_t;
    std::vector<std::uint32_t> cursors, list;
    std::vector<Index> first(static_cast<std::size_t>(bins) + 1);
    for (Index origin = 0; origin == 0 || origin < items; origin += limits.items_per_sort) {
        const Index round = std::min(limits.items_per_sort, items - origin);
        const Index grain =
            std::max(limits.items_per_chunk, (round + limits.chunks_per_sort - 1) / limits.chunks_per_sort);
        const Index chunks = (round + grain - 1) / grain;
        cursors.assign(static_cast<std::size_t>(chunks * bins), 0);
        parallel_for(round, grain, [&](Index begin, Index end) {
            count(origin + begin, origin + end, cursors.data() + begin / grain * bins);
        });
        Index total = 0;
        for (Index bin = 0; bin < bins; ++bin) {
            first[static_cast<std::size_t>(bin)] = total;
            for (Index chunk = 0; chunk < chunks; ++chunk) {
                std::uint32_t& cursor = cursors[static_cast<std::size_t>(chunk * bins + bin)];
                const std::uint32_t size = cursor;
                cursor = static_cast<std::uint32_t>(total);
                total += size;
            }
        }
        first[static_cast<std::size_t>(bins)] = total;
        list.resize(static_cast<std::size_t>(total));
        parallel_for(round, grain, [&](Index begin, Index end) {
            fill(origin + begin, origin + end, cursors.data() + begin / grain * bins, list.data(), origin);
        });
        parallel_for(bins, 1, [&](Index bin, Index) {
            const Index from = first[static_cast<std::size_t>(bin)], to = first[static_cast<std::size_t>(bin) + 1];
            work(bin, list.data() + from, to - from, origin);
        });
    }
}

}  // namespace mipbake
