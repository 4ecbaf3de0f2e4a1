// Shading on the GPU, from the same headers as on the CPU: geometry in double, the lobe in float.
#include "cuda/launch.h"
#include "ops/shading.h"
#include "shading/models.h"
#include "shading/prepare.h"

namespace mipbake {
namespace {

using namespace cuda;

// A block shades kTexels texels, and kSlices threads share the pairs of each. Pairs are worked out kPairs at a time, in
// shared memory, because every texel needs them.
constexpr int kTexels = 32, kSlices = 8, kPairs = 64;
constexpr int kThreads = kTexels * kSlices;

__device__ Vec3<float> direction(const StridedDirections& a, Index b, Index k, Index n) {
    const float* const v = static_cast<const float*>(a.data) + b * a.strides[0] + k * a.strides[1] + n * a.texel;
    return {v[0], v[a.strides[2]], v[2 * a.strides[2]]};
}

__device__ Pair<float> pair_of(const ShadeArgs& args, Index b, Index k, Index n) {
    return Pair<float>::of(direction(args.light, b, k, n), direction(args.view, b, k, n), TurnedAway::rule(args.black));
}

// All threads of the block load pairs [k0, k0 + count), which every texel has, into shared memory.
__device__ void load_pairs(const ShadeArgs& args, Index b, Index k0, int count, Pair<float>* pairs) {
    const int i = threadIdx.y * kTexels + threadIdx.x;
    if (i < count) pairs[i] = pair_of(args, b, k0 + i, 0);
    __syncthreads();
}
static_assert(kPairs <= kThreads, "one thread works out one pair");

// The pair of texel n: its own, or the shared one.
template <bool per_texel>
__device__ decltype(auto) choose(const ShadeArgs& args, Index b, Index k, Index n, const Pair<float>& shared) {
    if constexpr (per_texel) {
        return pair_of(args, b, k, n);
    } else {
        return (shared);
    }
}

template <int C>
__device__ void load_material(const ShadeArgs& args, Index b, Index n, double (&channels)[C]) {
    const StridedArray3& a = args.material;
    const float* const texel = static_cast<const float*>(a.data) + b * a.strides[0] + n * a.strides[1];
    for (int c = 0; c < C; ++c) channels[c] = texel[c * a.strides[2]];
}

// Grid: batch elements, times chunks of kPairs pairs, times blocks of kTexels texels. Where texels have directions of
// their own, each thread works out its pairs.
template <class Model, bool per_texel>
__global__ void __launch_bounds__(kThreads) forward_kernel(const __grid_constant__ ShadeArgs args, float* radiance) {
    using Surface = typename Model::template Surface<double, float>;
    __shared__ Surface surfaces[kTexels];
    __shared__ Pair<float> pairs[kPairs];
    const Index blocks = (args.N + kTexels - 1) / kTexels, chunks = (args.K + kPairs - 1) / kPairs;
    const Index n = blockIdx.x % blocks * kTexels + threadIdx.x, b = blockIdx.x / blocks / chunks;
    const Index k0 = blockIdx.x / blocks % chunks * kPairs;
    const int count = static_cast<int>(smaller<Index>(kPairs, args.K - k0));
    if (threadIdx.y == 0 && n < args.N) {
        double channels[Model::channels];
        load_material(args, b, n, channels);
        surfaces[threadIdx.x] = Prepare<Model>::template surface<double, float>(channels);
    }
    if (per_texel) {
        __syncthreads();
    } else {
        load_pairs(args, b, k0, count, pairs);
    }
    if (n >= args.N) return;
    for (int i = threadIdx.y; i < count; i += kSlices) {
        const auto& pair = choose<per_texel>(args, b, k0 + i, n, pairs[i]);
        const Vec3<float> f = Model::evaluate(surfaces[threadIdx.x], pair);
        float* const out = radiance + ((b * args.K + k0 + i) * args.N + n) * 3;
        out[0] = f.x;
        out[1] = f.y;
        out[2] = f.z;
    }
}

// Grid: batch elements, times blocks of texels. Each slice sums its pairs in order, then the slices are summed in
// order: the same bits every time.
template <class Model, bool per_texel>
__global__ void __launch_bounds__(kThreads)
    backward_kernel(const __grid_constant__ ShadeArgs args, const float* grad_radiance, float* grad_material) {
    using Surface = typename Model::template Surface<double, float>;
    using Adjoint = typename Model::template Surface<float, float>;
    constexpr int C = Model::channels;
    __shared__ Surface surfaces[kTexels];
    __shared__ Pair<float> pairs[kPairs];
    __shared__ Adjoint adjoints[kSlices][kTexels];
    const Index blocks = (args.N + kTexels - 1) / kTexels;
    const Index n = blockIdx.x % blocks * kTexels + threadIdx.x, b = blockIdx.x / blocks;
    const auto zero = [](float& a, float&) { a = 0; };
    const auto add = [](float& a, const float& other) { a += other; };

    double channels[C];
    if (threadIdx.y == 0 && n < args.N) {
        load_material(args, b, n, channels);
        surfaces[threadIdx.x] = Prepare<Model>::template surface<double, float>(channels);
    }
    Adjoint adjoint;
    Prepare<Model>::zip(adjoint, adjoint, zero);
    for (Index k0 = 0; k0 < args.K; k0 += kPairs) {
        const int count = static_cast<int>(smaller<Index>(kPairs, args.K - k0));
        __syncthreads();  // the surfaces are there; the pairs before are done with
        if (!per_texel) load_pairs(args, b, k0, count, pairs);
        for (int i = threadIdx.y; n < args.N && i < count; i += kSlices) {
            const float* const g = grad_radiance + ((b * args.K + k0 + i) * args.N + n) * 3;
            const auto& pair = choose<per_texel>(args, b, k0 + i, n, pairs[i]);
            Model::evaluate_adjoint(surfaces[threadIdx.x], pair, Vec3<float>{g[0], g[1], g[2]}, adjoint);
        }
    }
    adjoints[threadIdx.y][threadIdx.x] = adjoint;
    __syncthreads();
    if (threadIdx.y != 0 || n >= args.N) return;
    for (int slice = 1; slice < kSlices; ++slice) Prepare<Model>::zip(adjoint, adjoints[slice][threadIdx.x], add);
    float gradient[C];
    Prepare<Model>::pull_back(channels, adjoint, gradient);
    for (int c = 0; c < C; ++c) grad_material[(b * args.N + n) * C + c] = gradient[c];
}

// For a model with no adjoint of its own.
template <class Model>
__device__ void shade_back(const ShadeArgs& args, Index i, const float* grad_radiance, float* grad_material) {
    constexpr int C = Model::channels;
    using W = Dual<double, C, float>;
    using T = Dual<float, C>;
    const Index b = i / args.N, n = i % args.N;
    double channels[C];
    load_material(args, b, n, channels);
    W inputs[C];
    for (int c = 0; c < C; ++c) inputs[c] = W::input(channels[c], c);
    const auto surface = Prepare<Model>::template surface<W, T>(inputs);
    float gradient[C] = {};
    for (Index k = 0; k < args.K; ++k) {
        const auto pair = pair_of(args, b, k, n);
        const float* const g = grad_radiance + ((b * args.K + k) * args.N + n) * 3;
        const Vec3<T> f = Model::evaluate(surface, pair);
        for (int c = 0; c < C; ++c) gradient[c] += g[0] * f.x.d[c] + g[1] * f.y.d[c] + g[2] * f.z.d[c];
    }
    for (int c = 0; c < C; ++c) grad_material[i * C + c] = gradient[c];
}

template <class Model>
__global__ void backward_duals_kernel(const __grid_constant__ ShadeArgs args, const float* grad_radiance,
                                      float* grad_material) {
    for_each(args.B * args.N, [&](Index i) { shade_back<Model>(args, i, grad_radiance, grad_material); });
}

__device__ void store_across(const float* gradient, const Vec3<float>& direction, float* out) {
    const Vec3<float> g{gradient[0], gradient[1], gradient[2]}, across = g - direction * dot(g, direction);
    out[0] = across.x;
    out[1] = across.y;
    out[2] = across.z;
}

// As csrc/cpu/shading_directions.cpp, a thread for each texel of each pair.
template <class Model>
__global__ void directions_kernel(const __grid_constant__ ShadeArgs args, const float* grad_radiance, float* grad_light,
                                  float* grad_view) {
    for_each(args.B * args.K * args.N, [&](Index i) {
        constexpr int C = Model::channels;
        using W = Dual<double, 6, float>;
        using T = Dual<float, 6>;
        const Index n = i % args.N, k = i / args.N % args.K, b = i / args.N / args.K;
        double channels[C];
        load_material(args, b, n, channels);
        W constants[C];
        for (int c = 0; c < C; ++c) constants[c] = W(channels[c]);
        const auto surface = Prepare<Model>::template surface<W, T>(constants);
        const Vec3<float> l = direction(args.light, b, k, n), v = direction(args.view, b, k, n);
        const auto pair =
            Pair<float, W, T>::of({T::input(l.x, 0), T::input(l.y, 1), T::input(l.z, 2)},
                                  {T::input(v.x, 3), T::input(v.y, 4), T::input(v.z, 5)}, TurnedAway::rule(args.black));
        const Vec3<T> f = Model::evaluate(surface, pair);
        const float* const g = grad_radiance + 3 * i;
        float by[6];
        for (int j = 0; j < 6; ++j) by[j] = g[0] * f.x.d[j] + g[1] * f.y.d[j] + g[2] * f.z.d[j];
        store_across(by, l, grad_light + 3 * i);
        store_across(by + 3, v, grad_view + 3 * i);
    });
}

}  // namespace

void shade_cuda(const ShadeArgs& args, void* radiance, CudaStream stream) {
    const Queue queue(stream);
    const Index blocks = blocks_for(args.N, kTexels) * blocks_for(args.K, kPairs) * args.B;
    auto* const out = static_cast<float*>(radiance);
    Models::visit(args.model, [&](auto model) {
        using Model = decltype(model);
        const auto kernel = args.per_texel() ? forward_kernel<Model, true> : forward_kernel<Model, false>;
        queue.run(grid_of(blocks), dim3(kTexels, kSlices), kernel, args, out);
    });
}

void shade_backward_cuda(const ShadeArgs& args, const void* grad_radiance, void* grad_material, CudaStream stream) {
    const Queue queue(stream);
    const auto* const g = static_cast<const float*>(grad_radiance);
    auto* const out = static_cast<float*>(grad_material);
    Models::visit(args.model, [&](auto model) {
        using Model = decltype(model);
        if constexpr (Model::has_adjoint) {
            const auto kernel = args.per_texel() ? backward_kernel<Model, true> : backward_kernel<Model, false>;
            queue.run(grid_of(blocks_for(args.N, kTexels) * args.B), dim3(kTexels, kSlices), kernel, args, g, out);
        } else {
            queue.run_each(args.B * args.N, backward_duals_kernel<Model>, args, g, out);
        }
    });
}

void shade_directions_backward_cuda(const ShadeArgs& args, const void* grad_radiance, void* grad_light, void* grad_view,
                                    CudaStream stream) {
    const Queue queue(stream);
    Models::visit(args.model, [&](auto model) {
        queue.run_each(args.B * args.K * args.N, directions_kernel<decltype(model)>, args,
                       static_cast<const float*>(grad_radiance), static_cast<float*>(grad_light),
                       static_cast<float*>(grad_view));
    });
}

}  // namespace mipbake
