// What the core offers for meshes: rasterisation, interpolation, antialiasing and the gradients. Arrays are
// C-contiguous.
#pragma once

#include <cstdint>

#include "ops/runtime.h"

namespace mipbake {

constexpr int max_resolution = 32768;  // pixels along an axis

// T is float or double.
template <class T>
struct RasterizeArgs {
    std::int64_t batch, vertices, triangles;
    int height, width;
    const T* pos;                // (batch, vertices, 4) clip space, or (vertices, 4) where `shared`
    bool shared;                 // one array of vertices for every item: range mode, or a batch of 1
    const std::int32_t* tri;     // (triangles, 3)
    const std::int32_t* ranges;  // (batch, 2) starts and counts within tri, always on the host; null for all of it
    const T* previous;           // (batch, height, width, 4), the layer to go behind; or null
    T* rast;                     // (batch, height, width, 4): u, v, z/w, triangle + 1
    T* rast_db;                  // (batch, height, width, 4): du/dX, du/dY, dv/dX, dv/dY; or null
};

template <class T>
struct RasterizeBackwardArgs {
    std::int64_t batch, vertices, triangles;
    int height, width;
    const T* pos;
    bool shared;
    const std::int32_t* tri;
    const T* rast;
    const T* grad_rast;  // (batch, height, width, 4); only u and v count
    const T* grad_db;    // (batch, height, width, 4), or null
    T* grad_pos;         // like pos, overwritten; z receives 0
};

// Memory that rasterize_cpu keeps between calls. A scratch that another thread is using costs the call one of its own.
std::int64_t raster_scratch();
void raster_scratch_free(std::int64_t handle);

// Throws std::invalid_argument, a sentence for the user, where a position is not finite, an index is not of a vertex or
// a range is not within the triangles. Arrays may be null. pos is (items, vertices, 4), or without the first axis where
// it is not `instanced`.
template <class T>
void check_mesh(const T* pos, bool instanced, std::int64_t items, std::int64_t vertices, const std::int32_t* tri,
                std::int64_t triangles, const std::int32_t* ranges, std::int64_t batch);

// Draws a mesh that check_mesh has passed. Scratch, of as many items of the batch at once as have 4 million triangles,
// or of one: 12 bytes per triangle, 8 for each tile of 64 x 64 pixels that a triangle touches, and 256 per tile.
// `scratch` is a handle, or 0.
template <class T>
void rasterize_cpu(const RasterizeArgs<T>& args, std::int64_t scratch);

// Throws std::invalid_argument where a pixel has a triangle that there is not. Sums do not depend on the threads.
template <class T>
void rasterize_backward_cpu(const RasterizeBackwardArgs<T>& args);

// The workspace has rasterize_workspace bytes. Sums into vertices use atomics, so their last digits vary from run to
// run.
std::int64_t rasterize_workspace(std::int64_t batch, std::int64_t triangles, int height, int width);
void rasterize_cuda(const RasterizeArgs<float>& args, void* workspace, CudaStream stream);
void rasterize_backward_cuda(const RasterizeBackwardArgs<float>& args, CudaStream stream);

// rast: (batch, height, width, 4) with u, v, z/w, triangle + 1; tri: (triangles, 3).
template <class T>
struct InterpolateArgs {
    const T* attr;                             // (batch, vertices, channels), or (vertices, channels) for all items
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

void interpolate_cuda(const InterpolateArgs<float>& args, float* out, float* out_da, CudaStream stream);
void interpolate_backward_cuda(const InterpolateArgs<float>& args, const InterpolateGrads<float>& grads,
                               CudaStream stream);

template <class T>
struct AntialiasArgs {
    const T* color;  // (batch, height, width, channels)
    int channels;
    const T* rast;
    const T* pos;  // (batch, vertices, 4) with x, y, z, w in clip space, or (vertices, 4) for all items
    std::int64_t pos_batch_stride, vertices;  // the stride is 0 where all items share
    const std::int32_t* tri;
    const std::int32_t* next;  // (triangles, 3), of antialias_topology_cpu
    std::int64_t triangles;
    std::int64_t batch;
    int height, width;
};

template <class T>
struct AntialiasGrads {
    const T* out;  // (batch, height, width, channels)
    double boost;  // multiplies the gradient of the positions
    T* color;      // (batch, height, width, channels)
    T* pos;        // as AntialiasArgs::pos
};

// For edge e of triangle t (0: v_0 v_1, 1: v_1 v_2, 2: v_2 v_0) the index 3 t' + e' of the next edge that joins the
// same two vertices, in a cycle through increasing indices. Throws std::invalid_argument where a vertex does not exist.
void antialias_topology_cpu(const std::int32_t* tri, std::int64_t triangles, std::int64_t vertices, std::int32_t* next);

// Scratch: two bytes per triangle, for each batch item that has positions of its own. Throws std::invalid_argument
// where a triangle of rast, or a vertex of tri, does not exist.
template <class T>
void antialias_cpu(const AntialiasArgs<T>& args, T* out);
template <class T>
void antialias_backward_cpu(const AntialiasArgs<T>& args, const AntialiasGrads<T>& grads);

// workspace: a byte per triangle, for each batch item that has positions of its own.
void antialias_cuda(const AntialiasArgs<float>& args, float* out, std::uint8_t* workspace, CudaStream stream);
void antialias_backward_cuda(const AntialiasArgs<float>& args, const AntialiasGrads<float>& grads,
                             std::uint8_t* workspace, CudaStream stream);

}  // namespace mipbake
