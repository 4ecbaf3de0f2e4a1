#include "cpu/rasterize.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/mutex.h"
#include "core/parallel.h"
#include "cpu/triangle_ids.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

// ---- Errors of the data ----

// Keeps the lowest of the indices that threads report.
class First {
  public:
    void report(Index index) {
        Index known = index_.load(std::memory_order_relaxed);
        while (index < known && !index_.compare_exchange_weak(known, index)) {
        }
    }
    bool any() const { return index_ != kNone; }
    Index get() const { return index_; }

  private:
    static constexpr Index kNone = std::numeric_limits<Index>::max();
    std::atomic<Index> index_{kNone};
};

// Python's spelling.
template <class T>
std::string number(T value) {
    if (std::isnan(value)) return "nan";
    if (std::isinf(value)) return value > 0 ? "inf" : "-inf";
    std::ostringstream out;
    out.precision(9);
    out << value;
    const std::string text = out.str();
    return text.find_first_of(".e") == std::string::npos ? text + ".0" : text;
}

constexpr Index kCheckGrain = 1 << 15;

template <class T>
void check_positions(const T* pos, bool instanced, Index items, Index vertices) {
    First bad;
    parallel_for(items * vertices * 4, 4 * kCheckGrain, [&](Index begin, Index end) {
        T sums[8] = {};  // stays 0 while all are finite
        Index i = begin;
        for (; i + 8 <= end; i += 8)
            for (int k = 0; k < 8; ++k) sums[k] += pos[i + k] * T(0);
        T sum = 0;
        for (const T s : sums) sum += s;
        for (; i < end; ++i) sum += pos[i] * T(0);
        if (sum == 0) return;
        for (i = begin; i < end; ++i)
            if (!std::isfinite(pos[i])) return bad.report(i / 4);
    });
    if (!bad.any()) return;
    const Index vertex = bad.get();
    const T* const p = pos + 4 * vertex;
    std::string text = "pos[";
    if (instanced) text += std::to_string(vertex / vertices) + ", ";
    text += std::to_string(vertex % vertices) + "] is (" + number(p[0]) + ", " + number(p[1]) + ", " + number(p[2]) +
            ", " + number(p[3]) + "): expected finite numbers";
    throw std::invalid_argument(text);
}

void check_indices(const std::int32_t* tri, Index triangles, Index vertices) {
    std::atomic<bool> beyond{false};
    const std::uint32_t limit =
        static_cast<std::uint32_t>(std::min<Index>(vertices, std::numeric_limits<std::int32_t>::max()));
    parallel_for(triangles * 3, 3 * kCheckGrain, [&](Index begin, Index end) {
        std::uint32_t largest = 0;  // negative indices are the largest
        for (Index i = begin; i < end; ++i) largest = std::max(largest, static_cast<std::uint32_t>(tri[i]));
        if (largest >= limit) beyond = true;
    });
    if (beyond) check_triangle_vertices(tri, triangles, vertices);
}

void check_ranges(const std::int32_t* ranges, Index batch, Index triangles) {
    for (Index i = 0; i < batch; ++i) {
        const Index start = ranges[2 * i], count = ranges[2 * i + 1];
        if (start >= 0 && count >= 0 && start + count <= triangles) continue;
        throw std::invalid_argument("ranges[" + std::to_string(i) + "] is (" + std::to_string(start) + ", " +
                                    std::to_string(count) + "): expected a start and a count within the " +
                                    std::to_string(triangles) + " triangles of tri");
    }
}

// ---- Scratch ----

// A vector whose new elements hold anything.
template <class V>
class Buffer {
  public:
    V* reserve(Index size) {
        if (size > size_) {
            data_.reset();
            data_.reset(new V[static_cast<std::size_t>(size)]);
            size_ = size;
        }
        return data_.get();
    }

  private:
    std::unique_ptr<V[]> data_;
    Index size_ = 0;
};

struct Scratch {
    Mutex busy;
    Buffer<PixelBox> boxes;
    Buffer<float> nearest;
    Buffer<std::uint32_t> cursors, list, sorted;
    std::vector<Index> first;
};

class Scratches {
  public:
    Index add() {
        const std::lock_guard<Mutex> lock(mutex_);
        all_[++last_] = std::make_shared<Scratch>();
        return last_;
    }
    void remove(Index handle) {
        const std::lock_guard<Mutex> lock(mutex_);
        all_.erase(handle);
    }
    std::shared_ptr<Scratch> find(Index handle) {
        const std::lock_guard<Mutex> lock(mutex_);
        const auto found = all_.find(handle);
        return found == all_.end() ? nullptr : found->second;
    }

  private:
    Mutex mutex_;
    std::map<Index, std::shared_ptr<Scratch>> all_;
    Index last_ = 0;
};

Scratches& scratches() {
    static Scratches all;
    return all;
}

// ---- Drawing ----

// What is drawn at once: bounds the scratch.
constexpr Index kTrianglesAtOnce = Index(1) << 22, kTilesAtOnce = Index(1) << 16;

struct Tiling {
    int rows, columns;
    Index per_item() const { return Index(rows) * columns; }
};

// Draws items [b0, b1). Their triangles are sorted by tiles, stably: a chunk of triangles counts its triangles in each
// tile, the counts become places in the list, and each chunk fills its own.
template <class T>
void draw_items(const RasterizeArgs<T>& args, Index b0, Index b1, const Tiling& tiling, Scratch& scratch) {
    const auto start_of = [&](Index b) { return args.ranges == nullptr ? 0 : Index(args.ranges[2 * b]); };
    const auto count_of = [&](Index b) { return args.ranges == nullptr ? args.triangles : args.ranges[2 * b + 1]; };
    std::vector<Index> offsets(static_cast<std::size_t>(b1 - b0) + 1, 0);
    for (Index b = b0; b < b1; ++b)
        offsets[static_cast<std::size_t>(b - b0) + 1] = offsets[static_cast<std::size_t>(b - b0)] + count_of(b);
    const auto offset_of = [&](Index b) { return offsets[static_cast<std::size_t>(b - b0)]; };
    const Index total = offsets.back(), tiles = tiling.per_item(), bins = (b1 - b0) * tiles;
    const Index grain = std::max<Index>(1024, (total + 63) / 64), chunks = (total + grain - 1) / grain;
    PixelBox* const boxes = scratch.boxes.reserve(total);
    float* const nearest = scratch.nearest.reserve(total);
    std::uint32_t* const cursors = scratch.cursors.reserve(chunks * bins);
    std::fill(cursors, cursors + chunks * bins, 0u);

    // f(item, begin, end) on the triangles of each item that a chunk meets.
    const auto for_items = [&](Index begin, Index end, auto&& f) {
        Index b = std::upper_bound(offsets.begin(), offsets.end(), begin) - offsets.begin() - 1 + b0;
        for (; b < b1 && offset_of(b) < end; ++b) {
            const Index from = std::max(begin, offset_of(b)), to = std::min(end, offset_of(b + 1));
            if (from < to) f(b, from - offset_of(b), to - offset_of(b));
        }
    };
    const auto find_boxes = MIPBAKE_DISPATCH(raster_boxes<T>);
    parallel_for(total, grain, [&](Index begin, Index end) {
        std::uint32_t* const touched = cursors + begin / grain * bins;
        for_items(begin, end, [&](Index b, Index from, Index to) {
            find_boxes(args, {b, start_of(b), from, to, boxes + offset_of(b), nearest + offset_of(b),
                              touched + (b - b0) * tiles});
        });
    });

    std::vector<Index>& first = scratch.first;
    first.resize(static_cast<std::size_t>(bins) + 1);
    Index pairs = 0;
    for (Index bin = 0; bin < bins; ++bin) {
        first[static_cast<std::size_t>(bin)] = pairs;
        std::uint32_t within = 0;  // cursors count from the bin's beginning, so the list may be longer than 2^32
        for (Index chunk = 0; chunk < chunks; ++chunk) {
            std::uint32_t& cursor = cursors[chunk * bins + bin];
            const std::uint32_t size = cursor;
            cursor = within;
            within += size;
        }
        pairs += within;
    }
    first[static_cast<std::size_t>(bins)] = pairs;
    std::uint32_t* const list = scratch.list.reserve(pairs);
    std::uint32_t* const sorted = scratch.sorted.reserve(pairs);
    parallel_for(total, grain, [&](Index begin, Index end) {
        std::uint32_t* const chunk_cursors = cursors + begin / grain * bins;
        for_items(begin, end, [&](Index b, Index from, Index to) {
            std::uint32_t* const places = chunk_cursors + (b - b0) * tiles;
            const Index* const starts = first.data() + (b - b0) * tiles;
            const PixelBox* const own = boxes + offset_of(b);
            for (Index t = from; t < to; ++t) {
                const PixelBox box = own[t];
                if (box.x1 < box.x0) continue;
                for (int row = box.y0 / kRasterTile; row <= box.y1 / kRasterTile; ++row)
                    for (int column = box.x0 / kRasterTile; column <= box.x1 / kRasterTile; ++column) {
                        const Index tile = Index(row) * tiling.columns + column;
                        list[starts[tile] + places[tile]++] = static_cast<std::uint32_t>(t);
                    }
            }
        });
    });

    const auto draw = MIPBAKE_DISPATCH(raster_tile<T>);
    parallel_for(bins, 1, [&](Index bin, Index) {
        const Index b = b0 + bin / tiles, tile = bin % tiles;
        const int x = static_cast<int>(tile % tiling.columns) * kRasterTile;
        const int y = static_cast<int>(tile / tiling.columns) * kRasterTile;
        const Index from = first[static_cast<std::size_t>(bin)], to = first[static_cast<std::size_t>(bin) + 1];
        draw(args, {b, start_of(b), x, y, std::min(args.width, x + kRasterTile), std::min(args.height, y + kRasterTile),
                    list + from, sorted + from, to - from, boxes + offset_of(b), nearest + offset_of(b)});
    });
}

}  // namespace

std::int64_t raster_scratch() { return scratches().add(); }

void raster_scratch_free(std::int64_t handle) { scratches().remove(handle); }

template <class T>
void check_mesh(const T* pos, bool instanced, std::int64_t items, std::int64_t vertices, const std::int32_t* tri,
                std::int64_t triangles, const std::int32_t* ranges, std::int64_t batch) {
    if (tri != nullptr) check_indices(tri, triangles, vertices);
    if (pos != nullptr) check_positions(pos, instanced, items, vertices);
    if (ranges != nullptr) check_ranges(ranges, batch, triangles);
}

template <class T>
void rasterize_cpu(const RasterizeArgs<T>& args, std::int64_t scratch) {
    if (args.batch == 0 || args.height == 0 || args.width == 0) return;
    if (args.height > max_resolution || args.width > max_resolution)
        throw std::invalid_argument("resolution is (" + std::to_string(args.height) + ", " +
                                    std::to_string(args.width) + "): expected at most " +
                                    std::to_string(max_resolution) + " pixels along an axis");
    const std::shared_ptr<Scratch> kept = scratch == 0 ? nullptr : scratches().find(scratch);
    std::unique_lock<Mutex> using_kept;
    if (kept != nullptr) using_kept = std::unique_lock<Mutex>(kept->busy, std::try_to_lock);
    Scratch own;
    Scratch& memory = using_kept.owns_lock() ? *kept : own;

    const Tiling tiling{(args.height + kRasterTile - 1) / kRasterTile, (args.width + kRasterTile - 1) / kRasterTile};
    for (Index b0 = 0, b1 = 0; b0 < args.batch; b0 = b1) {
        Index triangles = 0;
        do {
            triangles += args.ranges == nullptr ? args.triangles : args.ranges[2 * b1 + 1];
            ++b1;
        } while (b1 < args.batch && triangles < kTrianglesAtOnce && (b1 - b0) * tiling.per_item() < kTilesAtOnce);
        draw_items(args, b0, b1, tiling, memory);
    }
}

template <class T>
void rasterize_backward_cpu(const RasterizeBackwardArgs<T>& args) {
    std::atomic<bool> wrong{false};
    const auto backward = MIPBAKE_DISPATCH(raster_backward_tile<T>);
    sum_into_vertices<double>({args.batch, args.height, args.width}, args.vertices, args.shared, 4, args.grad_pos,
                              [&](const PixelTile& tile, TileSums<double>& sums) {
                                  if (backward(args, tile, sums) >= 0) wrong = true;
                              });
    if (wrong) check_triangle_ids(args.rast, args.batch, args.height, args.width, args.triangles);
}

template void check_mesh<float>(const float*, bool, std::int64_t, std::int64_t, const std::int32_t*, std::int64_t,
                                const std::int32_t*, std::int64_t);
template void check_mesh<double>(const double*, bool, std::int64_t, std::int64_t, const std::int32_t*, std::int64_t,
                                 const std::int32_t*, std::int64_t);
template void rasterize_cpu<float>(const RasterizeArgs<float>&, std::int64_t);
template void rasterize_cpu<double>(const RasterizeArgs<double>&, std::int64_t);
template void rasterize_backward_cpu<float>(const RasterizeBackwardArgs<float>&);
template void rasterize_backward_cpu<double>(const RasterizeBackwardArgs<double>&);

}  // namespace mipbake
