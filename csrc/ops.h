// The only door of the native core: plain pointers, sizes, strides, a stream.
#pragma once

#include <cstdint>

namespace mipbake {

// ---- Runtime ----

const char* active_isa_name();  // "baseline", "avx2" or "avx512": the instruction set of the CPU kernels
int num_threads();              // threads that a CPU kernel may use, the caller included
void set_num_threads(int count);
bool cuda_compiled();   // whether this build has CUDA kernels
bool cuda_available();  // whether it also finds a CUDA device to run them on

// ---- Shading ----

struct ModelInfo {
    const char* name;
    int channels;
};
int model_count();
ModelInfo model_info(int index);

// An array of float or double with its strides, in elements; 0 where it broadcasts.
struct StridedArray3 {
    const void* data;
    std::int64_t strides[3];
};

struct ShadeArgs {
    int model;               // index of the model
    bool is_double;          // all arrays are double, else float
    std::int64_t B, K, N;    // batch, light-view pairs, texels
    StridedArray3 material;  // (B, N, C) stored channels
    StridedArray3 light;     // (B, K, 3) unit vectors
    StridedArray3 view;      // (B, K, 3)
};

// f(theta, l, v), cosine included, into `radiance`: (B, K, N, 3), contiguous.
void shade_cpu(const ShadeArgs& args, void* radiance);

// The gradient of the sum of grad_radiance * f by the material, into `grad_material`. grad_radiance is (B, K, N, 3) and
// grad_material (B, N, C), both contiguous. `duals` asks for forward-mode differentiation even where the model has an
// adjoint of its own; the two agree to rounding.
void shade_backward_cpu(const ShadeArgs& args, const void* grad_radiance, void* grad_material, bool duals);

// The same for arrays on the GPU, in float alone, enqueued on a stream (a cudaStream_t) of the current device. They
// throw std::runtime_error with CUDA's message; in a build without CUDA, always.
void shade_cuda(const ShadeArgs& args, void* radiance, std::uintptr_t stream);
void shade_backward_cuda(const ShadeArgs& args, const void* grad_radiance, void* grad_material, std::uintptr_t stream);

// ---- Texture sampling ----

constexpr int max_levels = 32;

// One level of a MIP stack: texel (i, j) of batch item b begins at texels + b * batch_stride + i * row_stride +
// j * texel_stride, and its channels are consecutive. Strides are in elements; 0 repeats, negative is allowed.
template <class T>
struct TextureLevel {
    const T* texels;
    std::int64_t batch_stride, row_stride, texel_stride;
    int height, width;
};

// `points` lookups in each of `batch` items. Strides are in elements; 0 repeats one value for every item or lookup.
template <class T>
struct SampleArgs {
    TextureLevel<T> levels[max_levels];  // finest first
    int level_count, channels;
    bool wrap_u, wrap_v;  // repeat along the axis; otherwise clamp to the centre of the edge texel
    std::int64_t batch, points;
    const T* uv;  // pairs (u, v), each pair consecutive
    std::int64_t uv_batch_stride, uv_point_stride;
    const T* lod;
    std::int64_t lod_batch_stride, lod_point_stride;
};

// What flows back: each target is overwritten, C-contiguous, or null where it is not wanted.
template <class T>
struct SampleGrads {
    const T* out;              // (batch, points, channels)
    T* levels[max_levels];     // (level_batch, height, width, channels): all of them or none
    std::int64_t level_batch;  // `batch`, or 1 to sum over the items
    T* uv;                     // (batch, points, 2)
    T* lod;                    // (batch, points)
};

// out: (batch, points, channels), C-contiguous. T is float or double.
template <class T>
void sample_cpu(const SampleArgs<T>& args, T* out);

// Sums into texels run in the order of the lookups whatever the number of threads: reproducible bit for bit.
template <class T>
void sample_backward_cpu(const SampleArgs<T>& args, const SampleGrads<T>& grads);

// Pointers are the device's. Null, or the text of CUDA's error. Texel gradients are summed with atomics, so their last
// digits vary from run to run. Defined where cuda_compiled().
const char* sample_cuda(const SampleArgs<float>& args, float* out, int device, void* stream);
const char* sample_backward_cuda(const SampleArgs<float>& args, const SampleGrads<float>& grads, int device,
                                 void* stream);

}  // namespace mipbake
