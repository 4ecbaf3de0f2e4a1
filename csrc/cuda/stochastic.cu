// Stochastic gradients on the GPU: one thread for an element or a pixel, and no atomics.
#include <cuda_runtime.h>

#include <algorithm>

#include "stochastic/elements.h"
#include "stochastic/touched.h"
#include "stochastic_ops.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

constexpr unsigned block_size = 256;
constexpr Index most_blocks = 65535;

template <class F>
__device__ void for_each(Index count, F&& f) {
    const Index step = Index(gridDim.x) * blockDim.x;
    for (Index i = Index(blockIdx.x) * blockDim.x + threadIdx.x; i < count; i += step) f(i);
}

__device__ Index element_at(const ElementList& list, Index i) { return list.listed != nullptr ? list.listed[i] : i; }

__device__ std::uint32_t first_of(Index element, int channels) {
    return static_cast<std::uint32_t>(element * channels);
}

__global__ void perturb_kernel(const __grid_constant__ PerturbArgs<float> args,
                               const __grid_constant__ ChannelNumbers<float> n) {
    for_each(args.elements.count, [&](Index i) {
        const Index e = element_at(args.elements, i), at = e * n.count;
        perturb_element(args.values + at, n, first_of(e, n.count), args.key, args.plus + at, args.minus + at);
    });
}

__global__ void gradient_kernel(const __grid_constant__ GradientArgs<float> args,
                                const __grid_constant__ ChannelNumbers<float> n) {
    for_each(args.elements.count, [&](Index i) {
        double sum = 0;
        for (Index k = args.starts[i]; k < args.starts[i + 1]; ++k)
            sum += static_cast<double>(args.differences[args.pixels[k]]);
        const Index e = element_at(args.elements, i);
        add_gradient(static_cast<float>(sum), n, first_of(e, n.count), args.key, args.gradient + e * n.count);
    });
}

__global__ void adam_kernel(const __grid_constant__ AdamArgs<float> args,
                            const __grid_constant__ ChannelNumbers<float> n) {
    for_each(args.elements.count, [&](Index i) {
        const Index e = element_at(args.elements, i), at = e * n.count;
        const AdamScales<float> whole = adam_scales(++args.steps[e], args.beta1, args.beta2);
        adam_element(args.values + at, args.gradient + at, args.first + at, args.second + at, whole, n, args.beta1,
                     args.beta2, args.epsilon);
    });
}

__global__ void differences_kernel(const float* plus, const float* minus, const float* reference, const float* weights,
                                   Index pixels, Index channels, float* out) {
    for_each(pixels, [&](Index i) {
        float sum = 0;
        for (Index c = i * channels; c < (i + 1) * channels; ++c)
            sum += (plus[c] - minus[c]) * (plus[c] + minus[c] - 2 * reference[c]);
        out[i] = weights != nullptr ? weights[i] * sum : sum;
    });
}

__global__ void touched_kernel(const __grid_constant__ TouchedArgs args, std::int32_t* texels) {
    for_each(args.points, [&](Index i) { add_touched(args, i, texels + i * args.most); });
}

const char* text_of(cudaError_t status) { return status == cudaSuccess ? nullptr : cudaGetErrorString(status); }

// Calls launch(blocks, stream) on the device, unless there is nothing to do.
template <class Launch>
const char* launched(Index count, int device, void* stream, Launch&& launch) {
    // The module links a CUDA runtime of its own, which has its own idea of the current device.
    if (const cudaError_t status = cudaSetDevice(device); status != cudaSuccess) return text_of(status);
    if (count == 0) return nullptr;
    const Index blocks = std::min((count + block_size - 1) / block_size, most_blocks);
    launch(static_cast<unsigned>(blocks), static_cast<cudaStream_t>(stream));
    return text_of(cudaGetLastError());
}

}  // namespace

const char* perturb_cuda(const PerturbArgs<float>& args, int device, void* stream) {
    return launched(args.elements.count, device, stream, [&](unsigned blocks, cudaStream_t queue) {
        perturb_kernel<<<blocks, block_size, 0, queue>>>(args, numbers_of(args.channels));
    });
}

const char* gradient_cuda(const GradientArgs<float>& args, int device, void* stream) {
    return launched(args.elements.count, device, stream, [&](unsigned blocks, cudaStream_t queue) {
        gradient_kernel<<<blocks, block_size, 0, queue>>>(args, numbers_of(args.channels));
    });
}

const char* adam_cuda(const AdamArgs<float>& args, int device, void* stream) {
    return launched(args.elements.count, device, stream, [&](unsigned blocks, cudaStream_t queue) {
        adam_kernel<<<blocks, block_size, 0, queue>>>(args, numbers_of(args.channels));
    });
}

const char* differences_cuda(const float* plus, const float* minus, const float* reference, const float* weights,
                             Index pixels, Index channels, float* out, int device, void* stream) {
    return launched(pixels, device, stream, [&](unsigned blocks, cudaStream_t queue) {
        differences_kernel<<<blocks, block_size, 0, queue>>>(plus, minus, reference, weights, pixels, channels, out);
    });
}

const char* touched_cuda(const TouchedArgs& args, std::int32_t* texels, int device, void* stream) {
    return launched(args.points, device, stream, [&](unsigned blocks, cudaStream_t queue) {
        touched_kernel<<<blocks, block_size, 0, queue>>>(args, texels);
    });
}

}  // namespace mipbake
