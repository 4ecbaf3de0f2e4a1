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

// ---- Interpolation and antialiasing of rasterised images ----

// rast: (batch, height, width, 4) with u, v, z/w, triangle + 1; tri: (triangles, 3). All arrays are C-contiguous.
template <class T>
struct InterpolateArgs {
    const T* attr;  // (batch, vertices, channels), or (vertices, channels) for all items
    std::int64_t attr_batch_stride, vertices;  // the stride is 0 where all items share
    int channels;
    const T* rast;
    const T* rast_db;  // (batch, height, width, 4) with du/dX, du/dY, dv/dX, dv/dY; null where nothing is listed
    const std::int32_t* tri;
    std::int64_t triangles;
    const int* listed;  // the channels whose derivatives are wanted; in the memory of the host, also for CUDA
    int listed_count;
    std::int64_t batch;
    int height, width;
};

// What flows back: null where it is not wanted, otherwise overwritten.
template <class T>
struct InterpolateGrads {
    const T* out;  // (batch, height, width, channels)
    const T* da;   // (batch, height, width, 2 * listed_count), or null
    T* attr;       // as InterpolateArgs::attr
    T* rast;       // (batch, height, width, 4)
    T* db;         // (batch, height, width, 4)
};

// out: (batch, height, width, channels); out_da: (batch, height, width, 2 * listed_count), dA/dX before dA/dY. T is
// float or double. Throws std::invalid_argument where a triangle of rast does not exist.
template <class T>
void interpolate_cpu(const InterpolateArgs<T>& args, T* out, T* out_da);
// Sums into vertices do not depend on the number of threads, bit for bit. Triangles that do not exist count as empty.
template <class T>
void interpolate_backward_cpu(const InterpolateArgs<T>& args, const InterpolateGrads<T>& grads);

// Pointers are the device's but for args.listed. Null, or the text of CUDA's error. Defined where cuda_compiled().
const char* interpolate_cuda(const InterpolateArgs<float>& args, float* out, float* out_da, int device, void* stream);
const char* interpolate_backward_cuda(const InterpolateArgs<float>& args, const InterpolateGrads<float>& grads,
                                      int device, void* stream);

// ---- Texture ----

enum class Storage { float32, float64, float16, bfloat16 };
enum class Filter { nearest, linear, linear_mipmap_nearest, linear_mipmap_linear, anisotropic };
// Of one axis. `cube` stands in both, and no other then.
enum class Boundary { wrap, clamp, mirror, zero, cube };

// One level of a MIP stack: texel (i, j) of face f of batch item b begins at texels + b * batch_stride + f * face_stride
// + i * row_stride + j * texel_stride, and its channels are consecutive. Strides are in elements; 0 repeats, negative is
// allowed.
struct TextureImage {
    const void* texels;
    std::int64_t batch_stride, face_stride, row_stride, texel_stride;
};

// `points` lookups in each of `batch` items, computed in T (float, or double where texels are stored so). Strides are in
// elements; 0 repeats one value for every item or lookup.
template <class T>
struct TextureArgs {
    TextureImage levels[max_levels];  // finest first
    int heights[max_levels], widths[max_levels];
    int level_count, channels;
    Storage storage;
    Filter filter;
    Boundary boundary_u, boundary_v;
    std::int64_t batch, points;
    const T* uv;  // 2 consecutive coordinates, or 3 with cubes
    std::int64_t uv_batch_stride, uv_point_stride;
    const T* uv_da;  // 4 or 6 derivatives by the pixel, consecutive; null without
    std::int64_t uv_da_batch_stride, uv_da_point_stride;
    const T* bias;  // null without
    std::int64_t bias_batch_stride, bias_point_stride;
};

// What flows back: each target is overwritten, C-contiguous, or null where it is not wanted.
template <class T>
struct TextureGrads {
    const T* out;                           // (batch, points, channels)
    T* levels[max_levels];                  // (level_batch, [6,] height, width, channels): all of them or none
    std::int64_t level_batch[max_levels];   // `batch`, or 1 to sum over the items
    T* uv;                                  // (batch, points, 2 or 3)
    T* uv_da;                               // (batch, points, 4 or 6)
    T* bias;                                // (batch, points)
};

// out: (batch, points, channels), C-contiguous.
template <class T>
void texture_cpu(const TextureArgs<T>& args, T* out);
// Sums into texels run in the order of the lookups whatever the number of threads: reproducible bit for bit. Where lookups
// are many, scratch of 4 bytes for each band of rows that a lookup touches (2 to 4, of at most 4 M lookups at a time).
template <class T>
void texture_backward_cpu(const TextureArgs<T>& args, const TextureGrads<T>& grads);

// From (images, height, width, channels) to (images, max(1, height / 2), max(1, width / 2), channels), C-contiguous:
// area averages, polyphase where a size is odd.
struct MipShape {
    std::int64_t images;
    int height, width, channels;
};
void texture_mip_cpu(const MipShape& shape, Storage storage, const void* level, void* out);
// Adds the adjoint: grad (images, height, width, channels) += M^T grad_out.
template <class T>
void texture_mip_backward_cpu(const MipShape& shape, const T* grad_out, T* grad);

// Pointers are the device's; in float alone, texels in float or a half type. Null, or the text of CUDA's error. Texel
// gradients are summed with atomics, so their last digits vary from run to run. Defined where cuda_compiled().
const char* texture_cuda(const TextureArgs<float>& args, float* out, int device, void* stream);
const char* texture_backward_cuda(const TextureArgs<float>& args, const TextureGrads<float>& grads, int device,
                                  void* stream);
const char* texture_mip_cuda(const MipShape& shape, Storage storage, const void* level, void* out, int device,
                             void* stream);
const char* texture_mip_backward_cuda(const MipShape& shape, const float* grad_out, float* grad, int device,
                                      void* stream);

}  // namespace mipbake
