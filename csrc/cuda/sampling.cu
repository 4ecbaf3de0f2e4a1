// One thread per lookup. Texel gradients are added with atomics: their order, and so their last digits, vary.
#include <cuda_runtime.h>

#include "ops.h"
#include "sampling/coordinates.h"
#include "sampling/interpolate.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

constexpr int threads_per_group = 256;

struct Lookup {
    int level[2];
    Tap<float> x[2], y[2];
    float blend;
};

__device__ Tap<float> tap(bool wrap, float coordinate, int size) {
    return wrap ? axis_tap<true>(coordinate, size) : axis_tap<false>(coordinate, size);
}

__device__ Lookup find(const SampleArgs<float>& args, Index item, Index point) {
    const float* const uv = args.uv + item * args.uv_batch_stride + point * args.uv_point_stride;
    const float lod = args.lod[item * args.lod_batch_stride + point * args.lod_point_stride];
    const LevelPair<float> pair = level_pair(lod, args.level_count - 1);
    Lookup lookup;
    lookup.level[0] = pair.finer;
    lookup.level[1] = pair.coarser;
    lookup.blend = pair.blend;
    for (int s = 0; s < 2; ++s) {
        const TextureLevel<float>& level = args.levels[lookup.level[s]];
        lookup.x[s] = tap(args.wrap_u, uv[0], level.width);
        lookup.y[s] = tap(args.wrap_v, uv[1], level.height);
    }
    return lookup;
}

__device__ Quad<float> quad(const SampleArgs<float>& args, const Lookup& lookup, int s, Index item) {
    const TextureLevel<float>& level = args.levels[lookup.level[s]];
    const float* const texels = level.texels + item * level.batch_stride;
    const float* const row0 = texels + lookup.y[s].first * level.row_stride;
    const float* const row1 = texels + lookup.y[s].second * level.row_stride;
    const Index left = lookup.x[s].first * level.texel_stride, right = lookup.x[s].second * level.texel_stride;
    return {row0 + left, row0 + right, row1 + left, row1 + right, lookup.x[s].fraction, lookup.y[s].fraction};
}

__global__ void sample_kernel(const __grid_constant__ SampleArgs<float> args, float* out) {
    const Index n = Index(blockIdx.x) * blockDim.x + threadIdx.x;
    if (n >= args.batch * args.points) return;
    const Index item = n / args.points;
    const Lookup lookup = find(args, item, n - item * args.points);
    const Quad<float> finer = quad(args, lookup, 0, item);
    float* const texel = out + n * args.channels;
    if (lookup.blend == 0)
        sample_level<0>(finer, args.channels, texel);
    else
        sample_levels<0>(finer, quad(args, lookup, 1, item), lookup.blend, args.channels, texel);
}

__device__ void add_quad(const SampleArgs<float>& args, float* target, const Lookup& lookup, int s, float weight,
                         const float* grad) {
    const Tap<float> x = lookup.x[s], y = lookup.y[s];
    const Index width = args.levels[lookup.level[s]].width;
    const Index texels[4] = {y.first * width + x.first, y.first * width + x.second, y.second * width + x.first,
                             y.second * width + x.second};
    const float weights[4] = {weight * (1 - y.fraction) * (1 - x.fraction), weight * (1 - y.fraction) * x.fraction,
                              weight * y.fraction * (1 - x.fraction), weight * y.fraction * x.fraction};
    for (int k = 0; k < 4; ++k)
        for (int c = 0; c < args.channels; ++c) atomicAdd(target + texels[k] * args.channels + c, weights[k] * grad[c]);
}

__global__ void backward_kernel(const __grid_constant__ SampleArgs<float> args,
                                const __grid_constant__ SampleGrads<float> grads) {
    const Index n = Index(blockIdx.x) * blockDim.x + threadIdx.x;
    if (n >= args.batch * args.points) return;
    const Index item = n / args.points;
    const Lookup lookup = find(args, item, n - item * args.points);
    const float* const grad = grads.out + n * args.channels;
    const float sum = lookup.x[0].fraction + lookup.y[0].fraction + lookup.blend;
    const bool valid = sum == sum;  // NaN in any of them makes the whole lookup NaN: it then adds to no gradient
    if (valid && grads.levels[0] != nullptr) {
        for (int s = 0; s < (lookup.blend != 0 ? 2 : 1); ++s) {
            const TextureLevel<float>& level = args.levels[lookup.level[s]];
            const Index size = Index(level.height) * level.width * args.channels;
            float* const target = grads.levels[lookup.level[s]] + (grads.level_batch > 1 ? item * size : 0);
            add_quad(args, target, lookup, s, s == 0 ? 1 - lookup.blend : lookup.blend, grad);
        }
    }
    if (grads.uv == nullptr && grads.lod == nullptr) return;
    float du = 0, dv = 0, dlod = 0;
    if (valid) {
        const TextureLevel<float>& finer = args.levels[lookup.level[0]];
        const QuadSlopes<float> fine = quad_slopes<0>(quad(args, lookup, 0, item), args.channels, grad);
        du = fine.x * finer.width;
        dv = fine.y * finer.height;
        if (lookup.level[0] != lookup.level[1] && (lookup.blend != 0 || grads.lod != nullptr)) {
            const TextureLevel<float>& coarser = args.levels[lookup.level[1]];
            const QuadSlopes<float> coarse = quad_slopes<0>(quad(args, lookup, 1, item), args.channels, grad);
            du = lerp(du, coarse.x * coarser.width, lookup.blend);
            dv = lerp(dv, coarse.y * coarser.height, lookup.blend);
            dlod = coarse.value - fine.value;
        }
    }
    if (grads.uv != nullptr) {
        grads.uv[2 * n] = du;
        grads.uv[2 * n + 1] = dv;
    }
    if (grads.lod != nullptr) grads.lod[n] = dlod;
}

const char* text_of(cudaError_t status) { return status == cudaSuccess ? nullptr : cudaGetErrorString(status); }

unsigned groups(Index lookups) { return static_cast<unsigned>((lookups + threads_per_group - 1) / threads_per_group); }

}  // namespace

const char* sample_cuda(const SampleArgs<float>& args, float* out, int device, void* stream) {
    // The module links a CUDA runtime of its own, which has its own idea of the current device.
    if (const cudaError_t status = cudaSetDevice(device); status != cudaSuccess) return text_of(status);
    const Index lookups = args.batch * args.points;
    if (lookups == 0) return nullptr;
    sample_kernel<<<groups(lookups), threads_per_group, 0, static_cast<cudaStream_t>(stream)>>>(args, out);
    return text_of(cudaGetLastError());
}

const char* sample_backward_cuda(const SampleArgs<float>& args, const SampleGrads<float>& grads, int device,
                                 void* stream) {
    if (const cudaError_t status = cudaSetDevice(device); status != cudaSuccess) return text_of(status);
    const cudaStream_t queue = static_cast<cudaStream_t>(stream);
    for (int l = 0; l < args.level_count && grads.levels[0] != nullptr; ++l) {
        const TextureLevel<float>& level = args.levels[l];
        const std::size_t bytes = std::size_t(grads.level_batch) * static_cast<std::size_t>(level.height) *
                                  static_cast<std::size_t>(level.width) * static_cast<std::size_t>(args.channels) *
                                  sizeof(float);
        const cudaError_t status = cudaMemsetAsync(grads.levels[l], 0, bytes, queue);
        if (status != cudaSuccess) return text_of(status);
    }
    const Index lookups = args.batch * args.points;
    if (lookups == 0) return nullptr;
    backward_kernel<<<groups(lookups), threads_per_group, 0, queue>>>(args, grads);
    return text_of(cudaGetLastError());
}

}  // namespace mipbake
