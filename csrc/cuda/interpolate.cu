// One thread per pixel. Gradients of vertices are added with atomics: their order, and so their last digits, vary.
#include "cuda/launch.h"
#include "ops/raster.h"
#include "raster/interpolate.h"
#include "raster/triangle_id.h"

namespace mipbake {
namespace {

using namespace cuda;

// The listed channels of one launch; more channels take further launches.
struct Slice {
    static constexpr int most = 128;
    int begin, count;
    int channels[most];
};

Slice slice(const InterpolateArgs<float>& args, int begin) {
    Slice listed{};
    listed.begin = begin;
    listed.count = std::min(Slice::most, args.listed_count - begin);
    for (int k = 0; k < listed.count; ++k) listed.channels[k] = args.listed[begin + k];
    return listed;
}

__device__ Listed list_of(const Slice& slice) { return {slice.channels, slice.count}; }

__device__ bool find_corners(const InterpolateArgs<float>& args, Index item, std::int32_t triangle, Corners<float>& a,
                             Index (&vertices)[3]) {
    if (triangle < 0) return false;
    const std::int32_t* const v = args.tri + 3 * Index(triangle);
    for (int k = 0; k < 3; ++k) {
        vertices[k] = v[k];
        if (v[k] < 0 || v[k] >= args.vertices) return false;
    }
    const float* const attr = args.attr + item * args.attr_batch_stride;
    a = {attr + vertices[0] * args.channels, attr + vertices[1] * args.channels, attr + vertices[2] * args.channels};
    return true;
}

__global__ void forward_kernel(const __grid_constant__ InterpolateArgs<float> args,
                               const __grid_constant__ Slice listed, float* out, float* out_da) {
    for_each_pixel(args.batch, args.height, args.width, [&](Index item, int, int, Index p) {
        const float* const pixel = args.rast + 4 * p;
        bool valid = true;
        Corners<float> corners;
        Index vertices[3];
        const std::int32_t triangle = triangle_of(pixel[3], triangle_id<float>(args.triangles), valid);
        const bool drawn = find_corners(args, item, triangle, corners, vertices);
        if (listed.begin == 0) {
            float* const values = out + p * args.channels;
            if (drawn)
                interpolate_values<0>(corners, pixel[0], pixel[1], args.channels, values);
            else
                for (int c = 0; c < args.channels; ++c) values[c] = 0;
        }
        if (listed.count == 0) return;
        float* const derivatives = out_da + 2 * (p * args.listed_count + listed.begin);
        if (drawn)
            interpolate_derivatives<-1>(corners, args.rast_db + 4 * p, list_of(listed), derivatives);
        else
            for (int k = 0; k < 2 * listed.count; ++k) derivatives[k] = 0;
    });
}

__global__ void backward_kernel(const __grid_constant__ InterpolateArgs<float> args,
                                const __grid_constant__ Slice listed,
                                const __grid_constant__ InterpolateGrads<float> grads) {
    for_each_pixel(args.batch, args.height, args.width, [&](Index item, int, int, Index p) {
        const float* const pixel = args.rast + 4 * p;
        const float* const grad = grads.out + p * args.channels;
        bool valid = true;
        Corners<float> corners;
        Index vertices[3];
        const std::int32_t triangle = triangle_of(pixel[3], triangle_id<float>(args.triangles), valid);
        const bool drawn = find_corners(args, item, triangle, corners, vertices);
        const bool is_first = listed.begin == 0;
        if (grads.rast != nullptr && is_first) {
            float by_u = 0, by_v = 0;
            if (drawn) barycentric_gradient<0>(corners, args.channels, grad, &by_u, &by_v);
            float* const target = grads.rast + 4 * p;
            target[0] = by_u;
            target[1] = by_v;
            target[2] = target[3] = 0;
        }
        const bool has_derivatives = grads.da != nullptr && listed.count > 0;
        const float* const grad_da = has_derivatives ? grads.da + 2 * (p * args.listed_count + listed.begin) : nullptr;
        if (grads.db != nullptr) {
            float by_db[4] = {0, 0, 0, 0};
            if (drawn && has_derivatives) derivative_gradient<-1>(corners, grad_da, list_of(listed), by_db);
            float* const target = grads.db + 4 * p;
            for (int i = 0; i < 4; ++i) target[i] = is_first ? by_db[i] : target[i] + by_db[i];
        }
        if (grads.attr == nullptr || !drawn) return;
        float* const target = grads.attr + item * args.attr_batch_stride;
        const auto add = [&](int vertex, int c, float value) {
            atomicAdd(target + vertices[vertex] * args.channels + c, value);
        };
        if (is_first) value_contributions(pixel[0], pixel[1], args.channels, grad, add);
        if (has_derivatives) derivative_contributions(args.rast_db + 4 * p, grad_da, list_of(listed), add);
    });
}

// Runs a kernel for every slice of the listed channels, once where there are none.
template <class Kernel, class... Arguments>
void run_slices(const Queue& queue, const InterpolateArgs<float>& args, Kernel kernel, const Arguments&... arguments) {
    for (int begin = 0; begin == 0 || begin < args.listed_count; begin += Slice::most)
        queue.run_pixels(args.batch, args.height, args.width, kernel, args, slice(args, begin), arguments...);
}

}  // namespace

void interpolate_cuda(const InterpolateArgs<float>& args, float* out, float* out_da, CudaStream stream) {
    run_slices(Queue(stream), args, forward_kernel, out, out_da);
}

void interpolate_backward_cuda(const InterpolateArgs<float>& args, const InterpolateGrads<float>& grads,
                               CudaStream stream) {
    const Queue queue(stream);
    const Index items = args.attr_batch_stride == 0 ? 1 : args.batch;
    if (grads.attr != nullptr) queue.fill(grads.attr, items * args.vertices * args.channels);
    run_slices(queue, args, backward_kernel, grads);
}

}  // namespace mipbake
