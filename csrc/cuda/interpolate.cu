// One thread per pixel. Gradients of vertices are added with atomics: their order, and so their last digits, vary.
#include <cuda_runtime.h>

#include <algorithm>

#include "ops.h"
#include "raster/interpolate.h"
#include "raster/triangle_id.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

constexpr unsigned block_width = 32, block_height = 8, most_items = 65535;

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

// Calls f(item, pixel of the batch) for the pixels of this thread.
template <class T, class F>
__device__ void for_each_pixel(const InterpolateArgs<T>& args, F&& f) {
    const int x = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
    const int y = static_cast<int>(blockIdx.y * blockDim.y + threadIdx.y);
    if (x >= args.width || y >= args.height) return;
    for (Index item = blockIdx.z; item < args.batch; item += gridDim.z)
        f(item, (item * args.height + y) * args.width + x);
}

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
    for_each_pixel(args, [&](Index item, Index p) {
        const float* const pixel = args.rast + 4 * p;
        bool valid = true;
        Corners<float> corners;
        Index vertices[3];
        const std::int32_t triangle = triangle_of(pixel[3], static_cast<float>(args.triangles), valid);
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
                                const __grid_constant__ InterpolateGrads<float> grads,
                                const __grid_constant__ Slice listed) {
    for_each_pixel(args, [&](Index item, Index p) {
        const float* const pixel = args.rast + 4 * p;
        const float* const grad = grads.out + p * args.channels;
        bool valid = true;
        Corners<float> corners;
        Index vertices[3];
        const std::int32_t triangle = triangle_of(pixel[3], static_cast<float>(args.triangles), valid);
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

const char* text_of(cudaError_t status) { return status == cudaSuccess ? nullptr : cudaGetErrorString(status); }

dim3 grid_of(const InterpolateArgs<float>& args) {
    return {(static_cast<unsigned>(args.width) + block_width - 1) / block_width,
            (static_cast<unsigned>(args.height) + block_height - 1) / block_height,
            static_cast<unsigned>(std::min<Index>(args.batch, most_items))};
}

// Calls launch(listed) for every slice of the listed channels, once where there are none.
template <class Launch>
const char* for_each_slice(const InterpolateArgs<float>& args, Launch&& launch) {
    if (args.batch == 0 || args.height == 0 || args.width == 0) return nullptr;
    for (int begin = 0; begin == 0 || begin < args.listed_count; begin += Slice::most) {
        launch(slice(args, begin));
        if (const cudaError_t status = cudaGetLastError(); status != cudaSuccess) return text_of(status);
    }
    return nullptr;
}

}  // namespace

const char* interpolate_cuda(const InterpolateArgs<float>& args, float* out, float* out_da, int device, void* stream) {
    // The module links a CUDA runtime of its own, which has its own idea of the current device.
    if (const cudaError_t status = cudaSetDevice(device); status != cudaSuccess) return text_of(status);
    return for_each_slice(args, [&](const Slice& listed) {
        forward_kernel<<<grid_of(args), dim3(block_width, block_height), 0, static_cast<cudaStream_t>(stream)>>>(
            args, listed, out, out_da);
    });
}

const char* interpolate_backward_cuda(const InterpolateArgs<float>& args, const InterpolateGrads<float>& grads,
                                      int device, void* stream) {
    if (const cudaError_t status = cudaSetDevice(device); status != cudaSuccess) return text_of(status);
    const cudaStream_t queue = static_cast<cudaStream_t>(stream);
    if (grads.attr != nullptr) {
        const Index items = args.attr_batch_stride == 0 ? 1 : args.batch;
        const std::size_t bytes = static_cast<std::size_t>(items * args.vertices * args.channels) * sizeof(float);
        const cudaError_t status = cudaMemsetAsync(grads.attr, 0, bytes, queue);
        if (status != cudaSuccess) return text_of(status);
    }
    return for_each_slice(args, [&](const Slice& listed) {
        backward_kernel<<<grid_of(args), dim3(block_width, block_height), 0, queue>>>(args, grads, listed);
    });
}

}  // namespace mipbake
