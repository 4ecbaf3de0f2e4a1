// The rasteriser's kernels, compiled once per instruction set.
#include "cpu/raster_lanes.h"
#include "cpu/rasterize.h"
#include "raster/barycentric.h"
#include "raster/box.h"
#include "raster/triangle_id.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;

template <class T>
constexpr bool is_wide = sizeof(T) == sizeof(double);

template <class T>
const T* item_positions(const RasterizeArgs<T>& args, Index item) {
    return args.pos + (args.shared ? 0 : item) * args.vertices * 4;
}

}  // namespace

template <class T>
void raster_boxes(const RasterizeArgs<T>& args, const BoxTask& task) {
    const T* const pos = item_positions(args, task.item);
    const int columns = (args.width + kRasterTile - 1) / kRasterTile;
    for (Index t = task.begin; t < task.end; ++t) {
        const std::int32_t* const corners = args.tri + 3 * (task.first + t);
        float nearest = -1;
        const PixelBox box = box_of(pos + 4 * Index(corners[0]), pos + 4 * Index(corners[1]),
                                    pos + 4 * Index(corners[2]), args.width, args.height, nearest);
        task.boxes[t] = box;
        task.nearest[t] = nearest;
        if (box.x1 < box.x0) continue;
        for (int row = box.y0 / kRasterTile; row <= box.y1 / kRasterTile; ++row)
            for (int column = box.x0 / kRasterTile; column <= box.x1 / kRasterTile; ++column)
                ++task.touched[row * columns + column];
    }
}

// ---- Tiles ----

namespace {

constexpr int kStride = kRasterTile + kRun;  // a run may begin at any pixel of a row
constexpr int kBlock = 8, kBlocks = kRasterTile / kBlock;
constexpr int kMostBuckets = 256;
constexpr Index kSortedFrom = 64;   // triangles in a tile from which on the nearer are drawn first
constexpr int kRefreshAfter = 48;   // triangles drawn until the farthest depths of blocks are found again
constexpr int kLargeBox = 20 * 20;  // pixels from which on blocks are tested as a whole
constexpr int kCached = 256;        // triangles that a tile keeps when it is written out
constexpr std::int32_t kNoTriangle = 0x7fffffff;

// What the lanes of a run add to 2 * column.
constexpr double kSteps[kRun] = {0, 2, 4, 6, 8, 10, 12, 14};

template <class T>
struct TileBuffer {
    T depths[kRasterTile * kStride];
    std::int32_t triangles[kRasterTile * kStride];
    T floors[kRasterTile * kStride];  // of the layer before; only where there is one
    T farthest[kBlocks][kBlocks];     // of the depths of each block
    bool peels;
};

template <class T>
class TileRaster {
  public:
    TileRaster(const RasterizeArgs<T>& args, const TileTask& task, TileBuffer<T>& buffer)
        : args_(args), task_(task), tile_(buffer), pos_(item_positions(args, task.item)) {}

    void draw() {
        clear();
        if (task_.size < kSortedFrom) {
            for (Index i = 0; i < task_.size; ++i) draw(task_.list[i]);
            return;
        }
        // Nearer triangles first, roughly. A pixel's result depends on depths and names alone, never on the order.
        std::uint32_t ends[kMostBuckets];
        float limits[kMostBuckets];
        const int buckets = sort(ends, limits);
        int drawn = 0, area = 0;
        double farthest = 2;  // depth in the tile, when it was last looked for
        std::uint32_t i = 0;
        for (int bucket = 0; bucket < buckets; ++bucket)
            for (; i < ends[bucket]; ++i) {
                if (static_cast<double>(limits[bucket]) > farthest) return;
                const std::uint32_t triangle = task_.sorted[i];
                const double nearest = static_cast<double>(task_.nearest[triangle]);
                if (nearest > farthest || hidden(task_.boxes[triangle], nearest)) continue;
                area += draw(triangle);
                if (++drawn == kRefreshAfter || area >= kRasterTile * kRasterTile) {
                    drawn = area = 0;
                    farthest = static_cast<double>(find_farthest());
                }
            }
    }

    void write() const;

  private:
    void clear() {
        constexpr T nothing = T(2);  // beyond every depth
        tile_.peels = args_.previous != nullptr;
        for (int i = 0; i < kRasterTile * kStride; ++i) tile_.depths[i] = nothing;
        for (int i = 0; i < kRasterTile * kStride; ++i) tile_.triangles[i] = kNoTriangle;
        for (auto& row : tile_.farthest)
            for (T& far : row) far = nothing;
        if (!tile_.peels) return;
        for (int y = task_.y0; y < task_.y1; ++y)
            for (int x = task_.x0; x < task_.x1; ++x) {
                const T* const before = args_.previous + ((task_.item * args_.height + y) * args_.width + x) * 4;
                const int at = (y - task_.y0) * kStride + x - task_.x0;
                tile_.floors[at] = before[2];
                if (!(before[3] > 0)) tile_.depths[at] = T(-2);  // nothing is left behind nothing
            }
        // A run may begin at any pixel and end in a row's padding.
        for (int y = 0; y < task_.y1 - task_.y0; ++y)
            for (int x = task_.x1 - task_.x0; x < kStride; ++x) tile_.floors[y * kStride + x] = 0;
    }

    // Sorts the list into buckets of nearest depth: bucket b ends before sorted[ends[b]], and none of its triangles is
    // nearer than limits[b].
    int sort(std::uint32_t (&ends)[kMostBuckets], float (&limits)[kMostBuckets]) {
        float low = 2, high = -2;
        for (Index i = 0; i < task_.size; ++i) {
            const float z = task_.nearest[task_.list[i]];
            low = smaller(low, z);
            high = larger(high, z);
        }
        const int buckets = static_cast<int>(smaller<Index>(kMostBuckets, task_.size / 8));
        const float scale = high > low ? static_cast<float>(buckets) / (high - low) : 0.0f;
        const auto bucket_of = [&](std::uint32_t triangle) {
            return smaller(buckets - 1, static_cast<int>((task_.nearest[triangle] - low) * scale));
        };
        for (int b = 0; b < buckets; ++b) {
            ends[b] = 0;
            limits[b] = 2;
        }
        for (Index i = 0; i < task_.size; ++i) ++ends[bucket_of(task_.list[i])];
        std::uint32_t total = 0;
        for (int b = 0; b < buckets; ++b) {
            const std::uint32_t size = ends[b];
            ends[b] = total;
            total += size;
        }
        for (Index i = 0; i < task_.size; ++i) {
            const std::uint32_t triangle = task_.list[i];
            const int bucket = bucket_of(triangle);
            task_.sorted[ends[bucket]++] = triangle;
            limits[bucket] = smaller(limits[bucket], task_.nearest[triangle]);
        }
        return buckets;
    }

    // Whether every pixel of the box has something nearer than the depth. Boxes reach beyond the tile.
    bool hidden(const PixelBox& box, double nearest) const {
        const int x0 = larger<int>(box.x0, task_.x0) - task_.x0, x1 = smaller<int>(box.x1, task_.x1 - 1) - task_.x0;
        const int y0 = larger<int>(box.y0, task_.y0) - task_.y0, y1 = smaller<int>(box.y1, task_.y1 - 1) - task_.y0;
        for (int by = y0 / kBlock; by <= y1 / kBlock; ++by)
            for (int bx = x0 / kBlock; bx <= x1 / kBlock; ++bx)
                if (!(nearest > static_cast<double>(tile_.farthest[by][bx]))) return false;
        return true;
    }

    // The farthest depth of each block, and of all; pixels outside of the image do not count.
    T find_farthest() {
        T farthest = T(-2);
        const int width = task_.x1 - task_.x0, height = task_.y1 - task_.y0;
        for (int by = 0; by * kBlock < height; ++by)
            for (int bx = 0; bx * kBlock < width; ++bx) {
                T far = T(-2);
                const int y1 = smaller(height, (by + 1) * kBlock), x1 = smaller(width, (bx + 1) * kBlock);
                if (x1 == (bx + 1) * kBlock) {
                    T lanes[kBlock];
                    const T* row = tile_.depths + by * kBlock * kStride + bx * kBlock;
                    for (int i = 0; i < kBlock; ++i) lanes[i] = row[i];
                    for (int y = by * kBlock + 1; y < y1; ++y) {
                        row += kStride;
                        for (int i = 0; i < kBlock; ++i) lanes[i] = larger(lanes[i], row[i]);
                    }
                    for (const T lane : lanes) far = larger(far, lane);
                } else {
                    for (int y = by * kBlock; y < y1; ++y)
                        for (int x = bx * kBlock; x < x1; ++x) far = larger(far, tile_.depths[y * kStride + x]);
                }
                tile_.farthest[by][bx] = far;
                farthest = larger(farthest, far);
            }
        return farthest;
    }

    // Returns the pixels that it looked at, roughly.
    int draw(std::uint32_t index) {
        const PixelBox& box = task_.boxes[index];
        const std::int32_t name = static_cast<std::int32_t>(task_.first + index);
        Triangle t;
        load_triangle(pos_, args_.tri + 3 * Index(name), t.v);
        if (!prepare<is_wide<T>>(t, args_.width, args_.height)) return 0;
        const int x0 = larger<int>(box.x0, task_.x0), x1 = smaller<int>(box.x1, task_.x1 - 1);
        const int y0 = larger<int>(box.y0, task_.y0), y1 = smaller<int>(box.y1, task_.y1 - 1);
        lattice_ = kUnknown;
        const int area = (x1 - x0 + 1) * (y1 - y0 + 1);
        if (area < kLargeBox) {
            for (int x = x0; x <= x1; x += kRun) draw_rows(t, name, x, x1, y0, y1);
        } else {
            draw_blocks(t, name, x0, x1, y0, y1);
        }
        return area;
    }

    // Rows [y0, y1] of the run of columns that begins at x and ends at x1 or sooner.
    template <bool kInside = false>
    MIPBAKE_INLINE void draw_rows(const Triangle& t, std::int32_t name, int x, int x1, int y0, int y1) {
        const Run px = Run::load(kSteps) + Run(2 * x + 1 - args_.width);
        const Edges& e = t.edges;
        const Run e0 = Run(e.a[0]) * px, e1 = Run(e.a[1]) * px, e2 = Run(e.a[2]) * px, z0 = Run(t.depth.a) * px;
        const unsigned within = x1 - x + 1 >= kRun ? 0xffu : (1u << (x1 - x + 1)) - 1;
        for (int y = y0; y <= y1; ++y) {
            const double py = 2 * y + 1 - args_.height;
            unsigned covered = within;
            if (!kInside) {
                const Run least = lesser(e0 + Run(e.b[0] * py + e.c[0]),
                                         lesser(e1 + Run(e.b[1] * py + e.c[1]), e2 + Run(e.b[2] * py + e.c[2])));
                covered = at_least(least, -t.bound) & within;
                if (covered == 0) continue;
                unsigned unsure = covered & ~above(least, t.bound);
                for (int i = 0; unsure != 0; ++i, unsure >>= 1)
                    if ((unsure & 1) != 0 && !inside(t, 2 * (x + i) + 1 - args_.width, py)) covered &= ~(1u << i);
            }
            const Run z = z0 + Run(t.depth.b * py + t.depth.c);
            if (t.depth.clips) covered &= at_least(z, t.depth.nearest) & ~above(z, t.depth.farthest);
            const Run held = greater(lesser(z, Run(t.depth.high)), Run(t.depth.low));
            const int at = (y - task_.y0) * kStride + x - task_.x0;
            depth_test<T>(covered, held, name, tile_.peels ? tile_.floors + at : nullptr, tile_.depths + at,
                          tile_.triangles + at);
        }
    }

    // Blocks of 8 x 8 pixels: not touched where an edge keeps them out or what is there is nearer, drawn without tests
    // where they are inside.
    void draw_blocks(const Triangle& t, std::int32_t name, int x0, int x1, int y0, int y1) {
        constexpr double extent = 2 * (kBlock - 1);
        const Edges& e = t.edges;
        double least[3], most[3];  // of each edge function over a block, less its value at the first pixel
        for (int i = 0; i < 3; ++i) {
            least[i] = smaller(e.a[i] * extent, 0.0) + smaller(e.b[i] * extent, 0.0) - 2 * t.bound;
            most[i] = larger(e.a[i] * extent, 0.0) + larger(e.b[i] * extent, 0.0) + 2 * t.bound;
        }
        const double z_least = smaller(t.depth.a * extent, 0.0) + smaller(t.depth.b * extent, 0.0);
        const double z_most = larger(t.depth.a * extent, 0.0) + larger(t.depth.b * extent, 0.0);
        const int bx0 = (x0 - task_.x0) / kBlock, bx1 = (x1 - task_.x0) / kBlock;
        for (int by = (y0 - task_.y0) / kBlock; by <= (y1 - task_.y0) / kBlock; ++by)
            for (int bx = bx0; bx <= bx1; ++bx) {
                const int x = task_.x0 + bx * kBlock, y = task_.y0 + by * kBlock;
                const double px = 2 * x + 1 - args_.width, py = 2 * y + 1 - args_.height;
                bool out = false, in = true;
                for (int i = 0; i < 3; ++i) {
                    const double at = e.at(i, px, py);
                    out = out || at + most[i] < 0;
                    in = in && at + least[i] > 0;
                }
                if (out) continue;
                const double z = depth_before_clamp(t.depth, px, py), slack = 1e-12 * (::fabs(z) + z_most - z_least);
                T& farthest = tile_.farthest[by][bx];
                // Rounding to T keeps order, so what is farther before it is not nearer after it.
                const double near = larger(z + z_least - slack, t.depth.low);
                if (static_cast<T>(smaller(near, t.depth.high)) > farthest) continue;
                const int right = smaller(task_.x1 - 1, x + kBlock - 1), bottom = smaller(task_.y1 - 1, y + kBlock - 1);
                if (!in) {
                    draw_rows(t, name, x, right, larger(y, y0), smaller(bottom, y1));
                    continue;
                }
                draw_rows<true>(t, name, x, right, y, bottom);
                if (!tile_.peels && !t.depth.clips) {
                    const double far = larger(smaller(z + z_most + slack, t.depth.high), t.depth.low);
                    farthest = smaller(farthest, static_cast<T>(far));
                }
            }
    }

    // The decision where an edge function is too close to zero.
    bool inside(const Triangle& t, double px, double py) {
        if (lattice_ == kUnknown) {
            lattice_ = kOnLattice;
            for (int i = 0; i < 3; ++i)
                if (!computed_exactly(t.v[(i + 1) % 3], t.v[(i + 2) % 3], t.edges.a[i] * t.turn, t.edges.b[i] * t.turn,
                                      t.edges.c[i] * t.turn, args_.width, args_.height))
                    lattice_ = kAnywhere;
        }
        if (lattice_ == kAnywhere) return covers(t, px, py, args_.width, args_.height);
        for (int i = 0; i < 3; ++i) {
            const double e = t.edges.at(i, px, py);
            if (e < 0) return false;
            if (e == 0 && !(t.edges.a[i] > 0 || (t.edges.a[i] == 0 && t.edges.b[i] > 0))) return false;
        }
        return true;
    }

    enum Lattice { kUnknown, kOnLattice, kAnywhere };

    const RasterizeArgs<T>& args_;
    const TileTask& task_;
    TileBuffer<T>& tile_;
    const T* const pos_;
    Lattice lattice_ = kUnknown;
};

template <class T>
void TileRaster<T>::write() const {
    struct Known {
        std::int32_t name;
        Edges edges;
    };
    Known known[kCached];
    for (Known& k : known) k.name = -1;
    const double width = args_.width, height = args_.height;
    for (int y = task_.y0; y < task_.y1; ++y) {
        const Index row = ((task_.item * args_.height + y) * args_.width + task_.x0) * 4;
        T* out = args_.rast + row;
        T* derivatives = args_.rast_db == nullptr ? nullptr : args_.rast_db + row;
        const double py = 2 * y + 1 - args_.height;
        const int begin = (y - task_.y0) * kStride;
        for (int x = task_.x0; x < task_.x1; ++x, out += 4) {
            const int at = begin + x - task_.x0;
            const std::int32_t name = tile_.triangles[at];
            double d[4] = {0, 0, 0, 0};
            if (name == kNoTriangle) {
                for (int i = 0; i < 4; ++i) out[i] = T(0);
            } else {
                Known& k = known[name % kCached];
                if (k.name != name) {
                    k.name = name;
                    ClipVertex v[3];
                    load_triangle(pos_, args_.tri + 3 * Index(name), v);
                    double turn;
                    k.edges = make_edges<is_wide<T>>(v, width, height, turn);
                }
                const Barycentrics b = barycentrics(k.edges, 2 * x + 1 - args_.width, py);
                out[0] = static_cast<T>(held_to_one(b.of[0]));
                out[1] = static_cast<T>(held_to_one(b.of[1]));
                out[2] = tile_.depths[at];
                out[3] = triangle_id<T>(name + 1);
                if (derivatives != nullptr) barycentric_derivatives(k.edges, b, d);
            }
            if (derivatives != nullptr) {
                for (int i = 0; i < 4; ++i) derivatives[i] = static_cast<T>(d[i]);
                derivatives += 4;
            }
        }
    }
}

}  // namespace

template <class T>
void raster_tile(const RasterizeArgs<T>& args, const TileTask& task) {
    TileBuffer<T> buffer;
    TileRaster<T> raster(args, task, buffer);
    raster.draw();
    raster.write();
}

template void raster_boxes<float>(const RasterizeArgs<float>&, const BoxTask&);
template void raster_boxes<double>(const RasterizeArgs<double>&, const BoxTask&);
template void raster_tile<float>(const RasterizeArgs<float>&, const TileTask&);
template void raster_tile<double>(const RasterizeArgs<double>&, const TileTask&);

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
