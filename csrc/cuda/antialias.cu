// One thread per triangle for the silhouettes, then one per pixel, which looks at its four neighbours: colours and
// their gradients are the same bits in every run. Gradients of positions are added with atomics: their last digits
// vary.
#include "cuda/launch.h"
#include "ops/raster.h"
#include "raster/silhouette.h"
#include "raster/triangle_id.h"

namespace mipbake {
namespace {

using namespace cuda;

__host__ __device__ Index pos_items(const AntialiasArgs<float>& args) {
    return args.pos_batch_stride == 0 ? 1 : args.batch;
}

__device__ bool exists(const AntialiasArgs<float>& args, const std::int32_t* v) {
    for (int k = 0; k < 3; ++k)
        if (v[k] < 0 || v[k] >= args.vertices) return false;
    return true;
}

// silhouettes: (1 or batch, triangles), a byte each; see silhouette_edges.
__global__ void silhouette_kernel(const __grid_constant__ AntialiasArgs<float> args, std::uint8_t* silhouettes) {
    for_each(pos_items(args) * args.triangles, [&](Index i) {
        const Index item = i / args.triangles;
        const float* const pos = args.pos + item * args.pos_batch_stride;
        const int edges = silhouette_edges(i - item * args.triangles, args.tri, args.next, [&](Index other) {
            const std::int32_t* const v = args.tri + 3 * other;
            return exists(args, v) ? facing(pos, v) : 0;
        });
        silhouettes[i] = static_cast<std::uint8_t>(edges);
    });
}

// Two neighbouring pixels, and where a silhouette edge passes between them.
struct Blend {
    Index first, second;  // pixels of the batch
    PixelPair pair;
    double d;    // negative where there is no such edge
    Index a, b;  // the vertices of the edge
};

// The pixel (y, x) of a batch item and its neighbour to the right, or below in memory.
__device__ Blend find_blend(const AntialiasArgs<float>& args, const std::uint8_t* silhouettes, bool horizontal,
                            Index item, int y, int x) {
    Blend blend;
    blend.d = -1;
    blend.first = (item * args.height + y) * args.width + x;
    blend.second = blend.first + (horizontal ? 1 : args.width);
    bool valid = true;
    const float last = triangle_id<float>(args.triangles);
    const std::int32_t first = triangle_of(args.rast[4 * blend.first + 3], last, valid);
    const std::int32_t second = triangle_of(args.rast[4 * blend.second + 3], last, valid);
    if (first == second) return blend;
    const float first_depth = first < 0 ? HUGE_VALF : args.rast[4 * blend.first + 2];
    const float second_depth = second < 0 ? HUGE_VALF : args.rast[4 * blend.second + 2];
    const Index nearer = first_depth <= second_depth ? first : second;
    if (nearer < 0) return blend;
    const bool shared = args.pos_batch_stride == 0;
    const int edges = silhouettes[(shared ? 0 : item * args.triangles) + nearer];
    if (edges == 0) return blend;
    const float* const pos = args.pos + item * args.pos_batch_stride;
    const std::int32_t* const v = args.tri + 3 * nearer;
    if (!exists(args, v)) return blend;
    const float* const corners[3] = {pos + 4 * Index(v[0]), pos + 4 * Index(v[1]), pos + 4 * Index(v[2])};
    blend.pair = pixel_pair(horizontal, y, x, args.height, args.width);
    const Crossing crossing = find_crossing(blend.pair, corners, edges);
    if (crossing.edge < 0) return blend;
    blend.d = crossing.d;
    blend.a = v[crossing.edge];
    blend.b = v[crossing.edge == 2 ? 0 : crossing.edge + 1];
    return blend;
}

// Calls f(blend, whether the pixel is its first) for the pairs of a pixel that are blended, in the order of the CPU.
template <class F>
__device__ void for_each_blend(const AntialiasArgs<float>& args, const std::uint8_t* silhouettes, Index item, int y,
                               int x, F&& f) {
    for (int side = 0; side < 4; ++side) {
        const bool horizontal = side == 1 || side == 2, is_first = side >= 2;
        const int first_y = y - (side == 0 ? 1 : 0), first_x = x - (side == 1 ? 1 : 0);
        if (first_y < 0 || first_x < 0 || (side == 2 && x + 1 >= args.width) || (side == 3 && y + 1 >= args.height))
            continue;
        const Blend blend = find_blend(args, silhouettes, horizontal, item, first_y, first_x);
        if (blend.d >= 0) f(blend, is_first);
    }
}

__global__ void forward_kernel(const __grid_constant__ AntialiasArgs<float> args, const std::uint8_t* silhouettes,
                               float* out) {
    for_each_pixel(args.batch, args.height, args.width, [&](Index item, int y, int x, Index pixel) {
        const float* const own = args.color + pixel * args.channels;
        float* const target = out + pixel * args.channels;
        for (int c = 0; c < args.channels; ++c) target[c] = own[c];
        for_each_blend(args, silhouettes, item, y, x, [&](const Blend& blend, bool is_first) {
            if (blends_into_second(blend.d) == is_first) return;
            const float weight = static_cast<float>(blend_weight(blend.d));
            const float* const source = args.color + (is_first ? blend.second : blend.first) * args.channels;
            for (int c = 0; c < args.channels; ++c) target[c] += weight * (source[c] - own[c]);
        });
    });
}

__device__ void add_end(float* target, const double (&gradient)[3]) {
    atomicAdd(target, static_cast<float>(gradient[0]));
    atomicAdd(target + 1, static_cast<float>(gradient[1]));
    atomicAdd(target + 3, static_cast<float>(gradient[2]));
}

__global__ void backward_kernel(const __grid_constant__ AntialiasArgs<float> args,
                                const __grid_constant__ AntialiasGrads<float> grads, const std::uint8_t* silhouettes) {
    for_each_pixel(args.batch, args.height, args.width, [&](Index item, int y, int x, Index pixel) {
        float* const target = grads.color + pixel * args.channels;
        if (grads.color != nullptr)
            for (int c = 0; c < args.channels; ++c) target[c] = grads.out[pixel * args.channels + c];
        for_each_blend(args, silhouettes, item, y, x, [&](const Blend& blend, bool is_first) {
            const bool into_second = blends_into_second(blend.d);
            const float* const grad = grads.out + (into_second ? blend.second : blend.first) * args.channels;
            if (grads.color != nullptr) {
                const float weight = static_cast<float>(blend_weight(blend.d));
                const float signed_weight = into_second == is_first ? weight : -weight;  // a source gains
                for (int c = 0; c < args.channels; ++c) target[c] += signed_weight * grad[c];
            }
            if (grads.pos == nullptr || !is_first) return;
            const float* const first = args.color + blend.first * args.channels;
            const float* const second = args.color + blend.second * args.channels;
            double by_d = 0;
            for (int c = 0; c < args.channels; ++c) by_d += double(grad[c]) * (double(first[c]) - double(second[c]));
            const float* const pos = args.pos + item * args.pos_batch_stride;
            const EndGradients ends =
                crossing_gradient(blend.pair, pos + 4 * blend.a, pos + 4 * blend.b, blend.d, by_d * grads.boost);
            float* const into = grads.pos + item * args.pos_batch_stride;
            add_end(into + 4 * blend.a, ends.a);
            add_end(into + 4 * blend.b, ends.b);
        });
    });
}

}  // namespace

void antialias_cuda(const AntialiasArgs<float>& args, float* out, std::uint8_t* workspace, CudaStream stream) {
    const Queue queue(stream);
    queue.run_each(pos_items(args) * args.triangles, silhouette_kernel, args, workspace);
    queue.run_pixels(args.batch, args.height, args.width, forward_kernel, args, workspace, out);
}

void antialias_backward_cuda(const AntialiasArgs<float>& args, const AntialiasGrads<float>& grads,
                             std::uint8_t* workspace, CudaStream stream) {
    const Queue queue(stream);
    if (grads.pos != nullptr) queue.fill(grads.pos, pos_items(args) * args.vertices * 4);
    queue.run_each(pos_items(args) * args.triangles, silhouette_kernel, args, workspace);
    queue.run_pixels(args.batch, args.height, args.width, backward_kernel, args, grads, workspace);
}

}  // namespace mipbake
