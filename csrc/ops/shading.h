// What the core offers for shading: materials in lights, and the gradients.
#pragma once

#include <cstdint>

#include "ops/runtime.h"

namespace mipbake {

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

// Unit vectors of float or double, (batch, pair, texel, 3), with their strides in elements.
struct StridedDirections {
    const void* data;
    std::int64_t strides[3];  // of batch, pair and component; 0 where it broadcasts
    std::int64_t texel = 0;   // of texel; 0 where all texels share
};

struct ShadeArgs {
    int model;               // index of the model
    bool is_double;          // all arrays are double, else float
    std::int64_t B, K, N;    // batch, light-view pairs, texels
    StridedArray3 material;  // (B, N, C) stored channels
    StridedDirections light, view;
    bool black = false;  // where the normal turns away from the viewer; else n.v is held to 1e-4 there

    // Whether texels have directions of their own.
    bool per_texel() const { return light.texel != 0 || view.texel != 0; }
};

// f(theta, l, v), cosine included, into `radiance`: (B, K, N, 3), contiguous.
void shade_cpu(const ShadeArgs& args, void* radiance);

// B surfaces, points of each under directional lights of its own. Strides are in elements;
// 0 where it broadcasts.
struct ShadeLitArgs {
    int model;
    bool is_double;        // all arrays are double, else float
    std::int64_t B, N, K;  // surfaces, points, lights
    const void* material;  // (B, N, C) stored channels
    std::int64_t material_strides[3];
    const void* frame;  // (B, N, 3, 3): rows t, b, n, the axes of tangent space, in the space of view and light
    std::int64_t frame_strides[4];
    const void* view;  // (B, N, 3) unit vectors
    std::int64_t view_strides[3];
    const void* light;     // (B, K, 3) unit vectors, contiguous
    const void* radiance;  // (B, K, 3) finite, contiguous
    bool black = false;    // as in ShadeArgs
};

// The sum over the lights of radiance * f(theta, l, v) into `out`: (B, N, 3), contiguous. On the CPU alone, and without
// a gradient: renders of meshes, which use it, run on NumPy arrays.
void shade_lit_cpu(const ShadeLitArgs& args, void* out);

// The gradient of the sum of grad_radiance * f by the material, into `grad_material`. grad_radiance is (B, K, N, 3) and
// grad_material (B, N, C), both contiguous. `duals` asks for forward-mode differentiation even where the model has an
// adjoint of its own; the two agree to rounding. It is for directions that all texels share.
void shade_backward_cpu(const ShadeArgs& args, const void* grad_radiance, void* grad_material, bool duals);

// The gradient by lights and views of each texel, into `grad_light` and `grad_view`: (B, K, N, 3), contiguous. Each is
// at a right angle to its direction, whose length is 1.
void shade_directions_backward_cpu(const ShadeArgs& args, const void* grad_radiance, void* grad_light, void* grad_view);

void shade_cuda(const ShadeArgs& args, void* radiance, CudaStream stream);
void shade_backward_cuda(const ShadeArgs& args, const void* grad_radiance, void* grad_material, CudaStream stream);
void shade_directions_backward_cuda(const ShadeArgs& args, const void* grad_radiance, void* grad_light, void* grad_view,
                                    CudaStream stream);

}  // namespace mipbake
