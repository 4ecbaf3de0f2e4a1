// Rasterisation on the GPU. Each pixel has a 64-bit key, depth above triangle, that triangles lower with atomicMin: the
// nearest wins, and among equals the lower triangle, in any order of arrival. A thread draws a small triangle; large
// ones are queued and drawn by many blocks. A last kernel turns keys into barycentrics. The same headers make the same
// decisions on the CPU.
#include "cuda/launch.h"
#include "ops/raster.h"
#include "raster/barycentric.h"
#include "raster/box.h"
#include "raster/triangle_id.h"

namespace mipbake {
namespace {

using namespace cuda;
using Key = unsigned long long;

constexpr int most_pixels_of_thread = 64;  // in the box of a triangle that one thread draws
constexpr int queue_blocks = 512, queue_slices = 8;
constexpr int tile_side = 16, tile_pixels = tile_side * tile_side;  // that a block draws at once
constexpr Index most_queued = Index(1) << 18;
constexpr int items_per_launch = 128;

struct Queued {
    std::int32_t item, triangle;
};

// Workspace: a key per pixel, the queue, and its length.
Index queue_size(Index batch, Index triangles) { return std::max<Index>(1, std::min(most_queued, batch * triangles)); }

struct Workspace {
    Key* keys;
    Queued* queue;
    Key* queued;
    Key capacity;
};

// The triangles of the items [first, first + items) of the batch: of each, from `starts` on, as many as there are
// between two `offsets`. Where every item has all of them, `each` is their number and the lists are not used.
struct Items {
    Index first, total, each;
    int count;
    Index offsets[items_per_launch + 1];
    std::int32_t starts[items_per_launch];
};

__device__ const float* positions_of(const float* pos, bool shared, Index vertices, Index item) {
    return pos + (shared ? 0 : item) * vertices * 4;
}

// False where an index belongs to no vertex.
__device__ bool load_corners(const std::int32_t* tri, Index triangle, Index vertices, Index (&corners)[3]) {
    bool good = true;
    for (int i = 0; i < 3; ++i) {
        corners[i] = tri[3 * triangle + i];
        good = good && corners[i] >= 0 && corners[i] < vertices;
    }
    return good;
}

__device__ bool load_triangle(const float* pos, const std::int32_t* tri, Index triangle, Index vertices,
                              ClipVertex (&v)[3]) {
    Index corners[3];
    if (!load_corners(tri, triangle, vertices, corners)) return false;
    load_triangle(pos, corners, v);
    return true;
}

__device__ PixelBox load_box(const float* pos, const std::int32_t* tri, Index triangle, Index vertices, int width,
                             int height) {
    Index corners[3];
    float nearest;
    if (!load_corners(tri, triangle, vertices, corners)) return {1, 0, 1, 0};
    return box_of(pos + 4 * corners[0], pos + 4 * corners[1], pos + 4 * corners[2], width, height, nearest);
}

// Lowers the pixel's key if the triangle covers it.
__device__ void draw_pixel(const RasterizeArgs<float>& args, const Workspace& workspace, const Triangle& t, Index item,
                           std::int32_t triangle, int x, int y) {
    const double px = 2 * x + 1 - args.width, py = 2 * y + 1 - args.height;
    double exact;
    if (!covers(t, px, py, args.width, args.height) || !depth_at(t, px, py, exact)) return;
    const float depth = static_cast<float>(exact) + 0.0f;  // no negative zero
    const Index pixel = (item * args.height + y) * args.width + x;
    if (args.previous != nullptr) {
        const float* const before = args.previous + 4 * pixel;
        if (!(before[3] > 0) || !(depth > before[2])) return;
    }
    // The bits of a float are turned so that they order as integers.
    const unsigned bits = __float_as_uint(depth), ordered = (bits & 0x80000000u) != 0 ? ~bits : bits | 0x80000000u;
    const Key key = (Key(ordered) << 32) | static_cast<unsigned>(triangle);
    if (key < workspace.keys[pixel]) atomicMin(workspace.keys + pixel, key);
}

// Draws triangle i of the launch, or queues it.
__device__ void draw_triangle(const RasterizeArgs<float>& args, const Workspace& workspace, const Items& items,
                              Index i) {
    Index item, triangle;
    if (items.each > 0) {
        item = i / items.each;
        triangle = i - item * items.each;
    } else {
        int low = 0, high = items.count;  // offsets[low] <= i < offsets[high]
        while (high - low > 1) {
            const int middle = (low + high) / 2;
            (items.offsets[middle] <= i ? low : high) = middle;
        }
        item = low;
        triangle = items.starts[low] + (i - items.offsets[low]);
    }
    item += items.first;
    const float* const pos = positions_of(args.pos, args.shared, args.vertices, item);
    const PixelBox box = load_box(pos, args.tri, triangle, args.vertices, args.width, args.height);
    if (box.x1 < box.x0) return;
    if ((box.x1 - box.x0 + 1) * (box.y1 - box.y0 + 1) > most_pixels_of_thread) {
        const Key place = atomicAdd(workspace.queued, Key(1));
        if (place < workspace.capacity) {
            workspace.queue[place] = {static_cast<std::int32_t>(item), static_cast<std::int32_t>(triangle)};
            return;
        }
        // No room is left: slower, but right.
    }
    Triangle t;
    if (!load_triangle(pos, args.tri, triangle, args.vertices, t.v) || !prepare<false>(t, args.width, args.height))
        return;
    for (int y = box.y0; y <= box.y1; ++y)
        for (int x = box.x0; x <= box.x1; ++x)
            draw_pixel(args, workspace, t, item, static_cast<std::int32_t>(triangle), x, y);
}

__global__ void __launch_bounds__(threads_per_block)
    draw_kernel(const __grid_constant__ RasterizeArgs<float> args, const __grid_constant__ Workspace workspace,
                const __grid_constant__ Items items) {
    for_each(items.total, [&](Index i) { draw_triangle(args, workspace, items, i); });
}

// Blocks (i, s) take the triangles i, i + gridDim.x, ... of the queue, and of each the rows of tiles s, s + gridDim.y,
// ...; a thread is a pixel of the tile.
__global__ void __launch_bounds__(tile_pixels)
    draw_queue_kernel(const __grid_constant__ RasterizeArgs<float> args, const __grid_constant__ Workspace workspace) {
    __shared__ Triangle t;
    __shared__ PixelBox box;
    __shared__ bool drawn;
    const Key count = min(*workspace.queued, workspace.capacity);
    for (Key i = blockIdx.x; i < count; i += gridDim.x) {
        const Queued queued = workspace.queue[i];
        __syncthreads();  // the triangle before is done with
        if (threadIdx.x == 0) {
            const float* const pos = positions_of(args.pos, args.shared, args.vertices, queued.item);
            box = load_box(pos, args.tri, queued.triangle, args.vertices, args.width, args.height);
            drawn = load_triangle(pos, args.tri, queued.triangle, args.vertices, t.v) &&
                    prepare<false>(t, args.width, args.height);
        }
        __syncthreads();
        if (!drawn) continue;
        constexpr double extent = 2 * (tile_side - 1);
        for (int ty = box.y0 / tile_side + static_cast<int>(blockIdx.y); ty <= box.y1 / tile_side;
             ty += static_cast<int>(gridDim.y))
            for (int tx = box.x0 / tile_side; tx <= box.x1 / tile_side; ++tx) {
                const int left = tx * tile_side, low = ty * tile_side;
                bool out = false;  // whether an edge keeps the whole tile out
                for (int e = 0; e < 3; ++e) {
                    const double at = t.edges.at(e, 2 * left + 1 - args.width, 2 * low + 1 - args.height);
                    const double most = larger(t.edges.a[e] * extent, 0.0) + larger(t.edges.b[e] * extent, 0.0);
                    out = out || at + most < -2 * t.bound;
                }
                const int x = left + static_cast<int>(threadIdx.x) % tile_side;
                const int y = low + static_cast<int>(threadIdx.x) / tile_side;
                if (out || x >= args.width || y >= args.height) continue;
                draw_pixel(args, workspace, t, queued.item, queued.triangle, x, y);
            }
    }
}

__global__ void __launch_bounds__(threads_per_block)
    resolve_kernel(const __grid_constant__ RasterizeArgs<float> args, const __grid_constant__ Workspace workspace) {
    for_each(args.batch * args.height * args.width, [&](Index pixel) {
        const Key key = workspace.keys[pixel];
        float4 values = {0, 0, 0, 0}, slopes = {0, 0, 0, 0};
        if (key != ~Key(0)) {
            const Index row = pixel / args.width, item = row / args.height;
            const int x = static_cast<int>(pixel - row * args.width), y = static_cast<int>(row - item * args.height);
            const auto triangle = static_cast<std::int32_t>(key & 0xffffffffu);
            const auto ordered = static_cast<unsigned>(key >> 32);
            ClipVertex v[3];
            load_triangle(positions_of(args.pos, args.shared, args.vertices, item), args.tri, triangle, args.vertices,
                          v);
            double turn;
            const Edges edges = make_edges<false>(v, args.width, args.height, turn);
            const Barycentrics b = barycentrics(edges, 2 * x + 1 - args.width, 2 * y + 1 - args.height);
            values.x = static_cast<float>(held_to_one(b.of[0]));
            values.y = static_cast<float>(held_to_one(b.of[1]));
            values.z = __uint_as_float((ordered & 0x80000000u) != 0 ? ordered & 0x7fffffffu : ~ordered);
            values.w = triangle_id<float>(triangle + 1);
            if (args.rast_db != nullptr) {
                double d[4];
                barycentric_derivatives(edges, b, d);
                slopes = {static_cast<float>(d[0]), static_cast<float>(d[1]), static_cast<float>(d[2]),
                          static_cast<float>(d[3])};
            }
        }
        reinterpret_cast<float4*>(args.rast)[pixel] = values;
        if (args.rast_db != nullptr) reinterpret_cast<float4*>(args.rast_db)[pixel] = slopes;
    });
}

// ---- Backward ----

constexpr unsigned all_lanes = 0xffffffffu;

// Sums over the lanes of a warp; all of them must call.
__device__ Triple sum_of_warp(Triple value) {
    for (int i = 0; i < 3; ++i)
        for (int step = 16; step > 0; step /= 2) value.v[i] += __shfl_xor_sync(all_lanes, value.v[i], step);
    return value;
}

// A warp is 8 x 4 pixels. Where all
// that are not empty show one triangle, one lane adds for all.
__global__ void __launch_bounds__(threads_per_block)
    backward_kernel(const __grid_constant__ RasterizeBackwardArgs<float> args) {
    const int x = static_cast<int>(blockIdx.x) * 32 + static_cast<int>(threadIdx.x / 32 % 4 * 8 + threadIdx.x % 8);
    const int y = static_cast<int>(blockIdx.y) * 8 + static_cast<int>(threadIdx.x / 128 * 4 + threadIdx.x / 8 % 4);
    for (Index item = blockIdx.z; item < args.batch; item += gridDim.z) {
        const float* const pos = positions_of(args.pos, args.shared, args.vertices, item);
        std::int32_t triangle = -1;
        Index corners[3] = {0, 0, 0};
        ClipVertex v[3];
        double turn = 0;
        Edges sums = {Triple(0.0), Triple(0.0), Triple(0.0)};
        const bool within = x < args.width && y < args.height;
        const Index pixel = (item * args.height + y) * args.width + x;
        if (within) {
            bool valid = true;
            triangle = triangle_of(args.rast[4 * pixel + 3], triangle_id<float>(args.triangles), valid);
            if (triangle >= 0 && !load_corners(args.tri, triangle, args.vertices, corners)) triangle = -1;
        }
        if (triangle >= 0) {
            load_triangle(pos, corners, v);
            const Edges edges = make_edges<false>(v, args.width, args.height, turn);
            const double px = 2 * x + 1 - args.width, py = 2 * y + 1 - args.height;
            const Barycentrics b = barycentrics(edges, px, py);
            const float* const g = args.grad_rast + 4 * pixel;
            double h[4] = {0, 0, 0, 0};
            if (args.grad_db != nullptr) {
                for (int i = 0; i < 4; ++i) h[i] = args.grad_db[4 * pixel + i];
                barycentric_adjoint<true>(edges, px, py, b, g[0], g[1], h, sums);
            } else {
                barycentric_adjoint<false>(edges, px, py, b, g[0], g[1], h, sums);
            }
        }
        const unsigned shown = __ballot_sync(all_lanes, triangle >= 0);
        if (shown == 0) continue;
        const int leader = __ffs(static_cast<int>(shown)) - 1;
        const std::int32_t leading = __shfl_sync(all_lanes, triangle, leader);
        const bool together = __all_sync(all_lanes, triangle < 0 || triangle == leading) && (shown & (shown - 1)) != 0;
        if (together) sums = {sum_of_warp(sums.a), sum_of_warp(sums.b), sum_of_warp(sums.c)};
        if (triangle < 0 || (together && static_cast<int>(threadIdx.x % 32) != leader)) continue;
        Vec3<double> gradient[3];
        pull_back(v, sums, turn, args.width, args.height, gradient);
        float* const target = args.grad_pos + (args.shared ? 0 : item) * args.vertices * 4;
        for (int i = 0; i < 3; ++i) {
            atomicAdd(target + 4 * corners[i], static_cast<float>(gradient[i].x));
            atomicAdd(target + 4 * corners[i] + 1, static_cast<float>(gradient[i].y));
            atomicAdd(target + 4 * corners[i] + 3, static_cast<float>(gradient[i].z));
        }
    }
}

Index key_count(Index batch, int height, int width) { return batch * height * width; }

}  // namespace

std::int64_t rasterize_workspace(std::int64_t batch, std::int64_t triangles, int height, int width) {
    return (key_count(batch, height, width) + 1) * Index(sizeof(Key)) +
           queue_size(batch, triangles) * Index(sizeof(Queued));
}

void rasterize_cuda(const RasterizeArgs<float>& args, void* workspace, CudaStream stream) {
    const Queue queue(stream);
    const Index pixels = key_count(args.batch, args.height, args.width);
    if (pixels == 0) return;
    Key* const keys = static_cast<Key*>(workspace);
    const Workspace parts{keys, reinterpret_cast<Queued*>(keys + pixels + 1), keys + pixels,
                          static_cast<Key>(queue_size(args.batch, args.triangles))};
    queue.fill(parts.keys, pixels, 0xff);
    queue.fill(parts.queued, 1);
    for (Index first = 0; first < args.batch;) {
        Items items{};
        items.first = first;
        if (args.ranges == nullptr) {
            items.each = args.triangles;
            items.total = args.batch * args.triangles;
            first = args.batch;
        } else {
            for (; items.count < items_per_launch && first < args.batch; ++first, ++items.count) {
                items.starts[items.count] = args.ranges[2 * first];
                items.total += args.ranges[2 * first + 1];
                items.offsets[items.count + 1] = items.total;
            }
        }
        queue.run_each(items.total, draw_kernel, args, parts, items);
    }
    queue.run(dim3(queue_blocks, queue_slices), tile_pixels, draw_queue_kernel, args, parts);
    queue.run_each(pixels, resolve_kernel, args, parts);
}

void rasterize_backward_cuda(const RasterizeBackwardArgs<float>& args, CudaStream stream) {
    const Queue queue(stream);
    queue.fill(args.grad_pos, (args.shared ? 1 : args.batch) * args.vertices * 4);
    const dim3 blocks = grid_of(blocks_for(args.width, block_width), blocks_for(args.height, block_height), args.batch);
    queue.run(blocks, threads_per_block, backward_kernel, args);
}

}  // namespace mipbake
