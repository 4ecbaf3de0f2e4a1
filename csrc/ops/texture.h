// What the core offers for textures: lookups in MIP stacks, MIP steps, and the gradients.
#pragma once

#include <cstdint>

#include "ops/runtime.h"

namespace mipbake {

constexpr int max_levels = 32;

enum class Storage { float32, float64, float16, bfloat16 };
enum class Filter { nearest, linear, linear_mipmap_nearest, linear_mipmap_linear, anisotropic };
// The mode of one axis. Where one axis has `cube`, the other has it as well.
enum class Boundary { wrap, clamp, mirror, zero, cube };

// One level of a MIP stack: texel (i, j) of face f of batch item b begins at texels + b * batch_stride + f *
// face_stride
// + i * row_stride + j * texel_stride, and its channels are consecutive. Strides are in elements; 0 repeats, negative
// is allowed.
struct TextureImage {
    const void* texels;
    std::int64_t batch_stride, face_stride, row_stride, texel_stride;
};

// `points` lookups in each of `batch` items, computed in T (float, or double where texels are stored so). Strides are
// in elements; 0 repeats one value for every item or lookup.
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
    const T* out;                          // (batch, points, channels)
    T* levels[max_levels];                 // (level_batch, [6,] height, width, channels): all of them or none
    std::int64_t level_batch[max_levels];  // `batch`, or 1 to sum over the items
    T* uv;                                 // (batch, points, 2 or 3)
    T* uv_da;                              // (batch, points, 4 or 6)
    T* bias;                               // (batch, points)
};

// out: (batch, points, channels), C-contiguous.
template <class T>
void texture_cpu(const TextureArgs<T>& args, T* out);
// Sums into texels run in the order of the lookups whatever the number of threads: reproducible bit for bit. Where
// lookups are many, scratch of 4 bytes for each band of rows that a lookup touches (2 to 4, of at most 4 M lookups at a
// time).
template <class T>
void texture_backward_cpu(const TextureArgs<T>& args, const TextureGrads<T>& grads);

// Bilinear lookups in two steps, with the bits of texture_cpu: where they lie in level 0, of which only the size is
// known, and what they make of texels. texels: (points, 4) counted row by row, two of a row and two of the row below.
// fractions: (points, 2) the way from the first to the second along a row, and from row to row.
void texture_taps_cpu(const TextureArgs<float>& args, std::int64_t* texels, float* fractions);
struct TexelQuads {
    const float* values;         // (texels, channels)
    const std::int64_t* texels;  // (points, 4) indices of values
    const float* fractions;      // (points, 2)
    std::int64_t points;
    int channels;
};
// out: (points, channels).
void texture_quads_cpu(const TexelQuads& quads, float* out);

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

// Texels are float or of a half type. Texel gradients are summed with atomics, so their last digits vary from run to
// run.
void texture_cuda(const TextureArgs<float>& args, float* out, CudaStream stream);
void texture_backward_cuda(const TextureArgs<float>& args, const TextureGrads<float>& grads, CudaStream stream);
void texture_mip_cuda(const MipShape& shape, Storage storage, const void* level, void* out, CudaStream stream);
void texture_mip_backward_cuda(const MipShape& shape, const float* grad_out, float* grad, CudaStream stream);

}  // namespace mipbake
