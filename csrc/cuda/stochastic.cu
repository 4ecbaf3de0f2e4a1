// Stochastic gradients on the GPU: one thread for an element or a pixel, and no atomics.
#include "cuda/launch.h"
#include "ops/stochastic.h"
#include "stochastic/elements.h"
#include "stochastic/touched.h"

namespace mipbake {
namespace {

using namespace cuda;

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

}  // namespace

void perturb_cuda(const PerturbArgs<float>& args, CudaStream stream) {
    Queue(stream).run_each(args.elements.count, perturb_kernel, args, numbers_of(args.channels));
}

void gradient_cuda(const GradientArgs<float>& args, CudaStream stream) {
    Queue(stream).run_each(args.elements.count, gradient_kernel, args, numbers_of(args.channels));
}

void adam_cuda(const AdamArgs<float>& args, CudaStream stream) {
    Queue(stream).run_each(args.elements.count, adam_kernel, args, numbers_of(args.channels));
}

void differences_cuda(const float* plus, const float* minus, const float* reference, const float* weights,
                      std::int64_t pixels, std::int64_t channels, float* out, CudaStream stream) {
    Queue(stream).run_each(pixels, differences_kernel, plus, minus, reference, weights, pixels, channels, out);
}

void touched_cuda(const TouchedArgs& args, std::int32_t* texels, CudaStream stream) {
    Queue(stream).run_each(args.points, touched_kernel, args, texels);
}

}  // namespace mipbake
