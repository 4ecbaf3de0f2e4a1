// The schedule and the loops of antialiasing. Compiled once: all but the copies is branches and bytes.
#include <algorithm>
#include <atomic>
#include <cstring>
#include <limits>
#include <vector>

#include "core/parallel.h"
#include "cpu/triangle_ids.h"
#include "cpu/vertex_bins.h"
#include "ops/raster.h"
#include "raster/silhouette.h"
#include "raster/triangle_id.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

// The silhouette edges of every triangle, a byte each: for every batch item, or once where all share their positions.
// Place 0 of an item is for empty pixels, so that a pixel's id is its place.
class Silhouettes {
  public:
    template <class T>
    explicit Silhouettes(const AntialiasArgs<T>& args)
        : item_size_(static_cast<std::size_t>(args.triangles) + 1), shared_(args.pos_batch_stride == 0) {
        constexpr Index grain = 8192;
        const Index items = shared_ ? 1 : args.batch, chunks = (args.triangles + grain - 1) / grain;
        edges_.resize(item_size_ * static_cast<std::size_t>(items));
        std::vector<std::int8_t> facings(static_cast<std::size_t>(items * args.triangles));
        std::atomic<bool> valid{true};
        parallel_for(items * chunks, 1, [&](Index chunk, Index) {
            const Index item = chunk / chunks, begin = chunk % chunks * grain;
            const Index end = std::min(args.triangles, begin + grain);
            const T* const pos = args.pos + item * args.pos_batch_stride;
            std::int8_t* const own = facings.data() + item * args.triangles;
            const auto vertices = static_cast<std::uint64_t>(args.vertices);
            for (Index t = begin; t < end; ++t) {
                const std::int32_t* const v = args.tri + 3 * t;
                if (std::uint64_t(v[0]) < vertices && std::uint64_t(v[1]) < vertices && std::uint64_t(v[2]) < vertices)
                    own[t] = static_cast<std::int8_t>(facing(pos, v));
                else
                    valid.store(false, std::memory_order_relaxed);
            }
        });
        if (!valid.load()) check_triangle_vertices(args.tri, args.triangles, args.vertices);
        parallel_for(items * chunks, 1, [&](Index chunk, Index) {
            const Index item = chunk / chunks, begin = chunk % chunks * grain;
            const Index end = std::min(args.triangles, begin + grain);
            const std::int8_t* const known = facings.data() + item * args.triangles;
            std::uint8_t* const edges = edges_.data() + static_cast<std::size_t>(item) * item_size_ + 1;
            for (Index t = begin; t < end; ++t)
                edges[t] = static_cast<std::uint8_t>(
                    silhouette_edges(t, args.tri, args.next, [&](Index other) { return int(known[other]); }));
        });
    }

    const std::uint8_t* of_item(Index item) const {
        return edges_.data() + (shared_ ? 0 : static_cast<std::size_t>(item) * item_size_);
    }

  private:
    std::size_t item_size_;
    bool shared_;
    std::vector<std::uint8_t> edges_;
};

// The ids of a row of pixels and the silhouette edges of their triangles.
struct Row {
    std::int32_t* ids;
    std::uint8_t* edges;
    bool any;  // whether there is an edge among them
};

class Rows {
  public:
    explicit Rows(int width) : ids_(2 * size(width)), edges_(2 * size(width)) {
        for (std::size_t i = 0; i < 2; ++i)
            rows_[i] = {ids_.data() + i * size(width), edges_.data() + i * size(width), false};
    }
    Row& at(int y) { return rows_[y & 1]; }

  private:
    static std::size_t size(int width) { return static_cast<std::size_t>(width) + 8; }  // read 8 bytes at a time
    std::vector<std::int32_t> ids_;
    std::vector<std::uint8_t> edges_;
    Row rows_[2];
};

template <class T>
void load_row(const T* pixels, int count, Index triangles, const std::uint8_t* silhouettes, Row& row, bool& valid) {
    const T last = triangle_id<T>(triangles);
    unsigned any = 0;
    for (int x = 0; x < count; ++x) {
        const std::int32_t id = triangle_of(pixels[4 * x + 3], last, valid) + 1;
        row.ids[x] = id;
        row.edges[x] = silhouettes[id];
        any |= row.edges[x];
    }
    row.any = any != 0;
}

bool eight_zeros(const std::uint8_t* bytes) {
    std::uint64_t word;
    std::memcpy(&word, bytes, sizeof word);
    return word == 0;
}

// Two neighbouring pixels that a silhouette edge passes between.
struct Blend {
    Index first, second;  // pixels of the batch
    PixelPair pair;
    double d;
    std::int32_t a, b;  // the vertices of the edge
};

// Calls f(blend) for each blend that has at least one pixel in the tile, in a fixed order. Returns whether every id
// belonged to a triangle.
template <class T, class F>
bool for_each_blend(const AntialiasArgs<T>& args, const std::uint8_t* silhouettes, const PixelTile& tile, Rows& rows,
                    F&& f) {
    const Index origin = tile.item * args.height * args.width;
    const T* const pos = args.pos + tile.item * args.pos_batch_stride;
    const int x0 = std::max(0, tile.x0 - 1), x1 = std::min(args.width, tile.x1 + 1);
    const int y0 = std::max(0, tile.y0 - 1), y1 = std::min(args.height, tile.y1 + 1);
    const auto depth = [&](std::int32_t id, Index pixel) {
        return id == 0 ? std::numeric_limits<T>::infinity() : args.rast[4 * pixel + 2];
    };
    const auto visit = [&](bool horizontal, int y, int x, const Row& row, int at, const Row& other_row, int other_at) {
        const std::int32_t id = row.ids[at], other_id = other_row.ids[other_at];
        if (id == other_id) return;
        const Index first = origin + Index(y) * args.width + x, second = first + (horizontal ? 1 : args.width);
        const bool first_is_nearer = depth(id, first) <= depth(other_id, second);
        const int edges = first_is_nearer ? row.edges[at] : other_row.edges[other_at];
        if (edges == 0) return;
        const std::int32_t* const v = args.tri + 3 * (Index(first_is_nearer ? id : other_id) - 1);
        const T* const corners[3] = {pos + 4 * Index(v[0]), pos + 4 * Index(v[1]), pos + 4 * Index(v[2])};
        const PixelPair pair = pixel_pair(horizontal, y, x, args.height, args.width);
        const Crossing crossing = find_crossing(pair, corners, edges);
        if (crossing.edge < 0) return;
        f(Blend{first, second, pair, crossing.d, v[crossing.edge], v[crossing.edge == 2 ? 0 : crossing.edge + 1]});
    };
    bool valid = true;
    for (int y = y0; y < y1; ++y) {
        Row &row = rows.at(y), &above = rows.at(y + 1);  // `above` holds row y - 1
        load_row(args.rast + 4 * (origin + Index(y) * args.width + x0), x1 - x0, args.triangles, silhouettes, row,
                 valid);
        if (y > y0 && (row.any || above.any))
            for (int x = tile.x0; x < tile.x1; ++x) {
                const int at = x - x0;
                if (x + 8 <= tile.x1 && eight_zeros(row.edges + at) && eight_zeros(above.edges + at))
                    x += 7;
                else if ((row.edges[at] | above.edges[at]) != 0)
                    visit(false, y - 1, x, above, at, row, at);
            }
        if (y >= tile.y0 && y < tile.y1 && row.any)
            for (int x = x0; x + 1 < x1; ++x) {
                const int at = x - x0;
                if (x + 8 < x1 && eight_zeros(row.edges + at) && row.edges[at + 8] == 0)
                    x += 7;
                else if ((row.edges[at] | row.edges[at + 1]) != 0)
                    visit(true, y, x, row, at, row, at + 1);
            }
    }
    return valid;
}

bool contains(const PixelTile& tile, int height, int width, Index pixel) {
    const int x = static_cast<int>(pixel % width), y = static_cast<int>(pixel / width % height);
    return x >= tile.x0 && x < tile.x1 && y >= tile.y0 && y < tile.y1;
}

constexpr Index rows_per_band = 16;

// Calls f(tile) on bands of whole rows, in parallel.
template <class T, class F>
void for_each_band(const AntialiasArgs<T>& args, F&& f) {
    const Index bands = (args.height + rows_per_band - 1) / rows_per_band;
    parallel_for(args.batch * bands, 1, [&](Index band, Index) {
        const Index y = band % bands * rows_per_band;
        const PixelTile tile{band / bands, static_cast<int>(y),
                             static_cast<int>(std::min<Index>(args.height, y + rows_per_band)), 0, args.width};
        f(tile);
    });
}

template <class T>
void copy_tile(const AntialiasArgs<T>& args, const PixelTile& tile, const T* from, T* to) {
    const std::size_t count = static_cast<std::size_t>(tile.x1 - tile.x0) * static_cast<std::size_t>(args.channels);
    for (int y = tile.y0; y < tile.y1; ++y) {
        const Index start = ((tile.item * args.height + y) * args.width + tile.x0) * args.channels;
        std::memcpy(to + start, from + start, count * sizeof(T));
    }
}

// The gradients of a tile's colours, and what the pairs whose first pixel lies in it contribute to the positions.
template <class T>
void backward_tile(const AntialiasArgs<T>& args, const AntialiasGrads<T>& grads, const std::uint8_t* silhouettes,
                   const PixelTile& tile, Rows& rows, TileSums<double>* sums) {
    if (grads.color != nullptr) copy_tile(args, tile, grads.out, grads.color);
    const T* const pos = args.pos + tile.item * args.pos_batch_stride;
    for_each_blend(args, silhouettes, tile, rows, [&](const Blend& blend) {
        const bool has_first = contains(tile, args.height, args.width, blend.first);
        const bool into_second = blends_into_second(blend.d);
        const Index into = into_second ? blend.second : blend.first, from = into_second ? blend.first : blend.second;
        const T* const grad = grads.out + into * args.channels;
        if (grads.color != nullptr) {
            const T weight = static_cast<T>(blend_weight(blend.d));
            const bool has_into = into_second ? contains(tile, args.height, args.width, into) : has_first;
            const bool has_from = into_second ? has_first : contains(tile, args.height, args.width, from);
            for (int c = 0; has_into && c < args.channels; ++c)
                grads.color[into * args.channels + c] -= weight * grad[c];
            for (int c = 0; has_from && c < args.channels; ++c)
                grads.color[from * args.channels + c] += weight * grad[c];
        }
        if (sums == nullptr || !has_first) return;
        const T* const first = args.color + blend.first * args.channels;
        const T* const second = args.color + blend.second * args.channels;
        double by_d = 0;
        for (int c = 0; c < args.channels; ++c) by_d += double(grad[c]) * (double(first[c]) - double(second[c]));
        const EndGradients ends = crossing_gradient(blend.pair, pos + 4 * Index(blend.a), pos + 4 * Index(blend.b),
                                                    blend.d, by_d * grads.boost);
        const std::uint16_t a = slot_of(*sums, blend.a), b = slot_of(*sums, blend.b);
        double *const into_a = sums_of(*sums, a), *const into_b = sums_of(*sums, b);
        constexpr int place[3] = {0, 1, 3};  // of x, y and w; nothing depends on z
        for (int i = 0; i < 3; ++i) into_a[place[i]] += ends.a[i];
        for (int i = 0; i < 3; ++i) into_b[place[i]] += ends.b[i];
    });
}

}  // namespace

template <class T>
void antialias_cpu(const AntialiasArgs<T>& args, T* out) {
    const Silhouettes silhouettes(args);
    std::atomic<bool> valid{true};
    for_each_band(args, [&](const PixelTile& tile) {
        Rows rows(args.width);
        copy_tile(args, tile, args.color, out);
        const bool good = for_each_blend(args, silhouettes.of_item(tile.item), tile, rows, [&](const Blend& blend) {
            const bool into_second = blends_into_second(blend.d);
            const Index into = into_second ? blend.second : blend.first;
            if (!contains(tile, args.height, args.width, into)) return;
            const Index from = into_second ? blend.first : blend.second;
            const T weight = static_cast<T>(blend_weight(blend.d));
            const T *const source = args.color + from * args.channels, *const own = args.color + into * args.channels;
            T* const target = out + into * args.channels;
            for (int c = 0; c < args.channels; ++c) target[c] += weight * (source[c] - own[c]);
        });
        if (!good) valid.store(false, std::memory_order_relaxed);
    });
    if (!valid.load()) check_triangle_ids(args.rast, args.batch, args.height, args.width, args.triangles);
}

template <class T>
void antialias_backward_cpu(const AntialiasArgs<T>& args, const AntialiasGrads<T>& grads) {
    const Silhouettes silhouettes(args);
    if (grads.pos == nullptr) {
        for_each_band(args, [&](const PixelTile& tile) {
            Rows rows(args.width);
            backward_tile(args, grads, silhouettes.of_item(tile.item), tile, rows, nullptr);
        });
        return;
    }
    const PixelGrid grid{args.batch, args.height, args.width};
    sum_into_vertices<double>(grid, args.vertices, args.pos_batch_stride == 0, 4, grads.pos,
                              [&](const PixelTile& tile, TileSums<double>& sums) {
                                  Rows rows(tile.x1 - tile.x0 + 2);
                                  backward_tile(args, grads, silhouettes.of_item(tile.item), tile, rows, &sums);
                              });
}

#define MIPBAKE_INSTANTIATE(T)                                   \
    template void antialias_cpu<T>(const AntialiasArgs<T>&, T*); \
    template void antialias_backward_cpu<T>(const AntialiasArgs<T>&, const AntialiasGrads<T>&);
MIPBAKE_INSTANTIATE(float)
MIPBAKE_INSTANTIATE(double)

}  // namespace mipbake
