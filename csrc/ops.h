// The only door of the native core: plain pointers, sizes, strides, a stream.
#pragma once

#include <cstdint>
#include <memory>

#include "core/environment.h"

namespace mipbake {

// ---- Runtime ----

// These two and every kernel throw EnvironmentFault where MIPBAKE_ISA or MIPBAKE_THREADS holds what it cannot.
const char* active_isa_name();  // "baseline", "avx2" or "avx512": the instruction set of the CPU kernels
int num_threads();              // threads that a CPU kernel may use, the caller included
void set_num_threads(int count);
bool cuda_compiled();   // whether this build has CUDA kernels
bool cuda_available();  // whether it also finds a CUDA device to run them on

// A stream (a cudaStream_t) of a CUDA device. Functions that take one are defined where cuda_compiled(), for arrays of
// float in the memory of that device. They enqueue their work and do not wait for it. They throw std::runtime_error
// with CUDA's message.
struct CudaStream {
    int device;
    std::uintptr_t stream;
};

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

// ---- Networks ----

// A layer of a network: (outputs, inputs, taps) weights and (outputs) biases, contiguous; taps are 1, or 9 of 3 x 3.
struct NetworkLayer {
    const float *weight, *bias;
    std::int64_t outputs, inputs;
    int taps;
};

// Limits of what is shaded: roughness, its logarithm and its fourth power.
struct NetworkLimits {
    float least_roughness, most_roughness, least_log_roughness, most_log_roughness, least_alpha2, most_alpha2;
};

// Networks whose latents are moments and learned maps (models/moment_network.py), and networks whose latents
// are all learned (models/latent_network.py).
enum class NetworkKind { moments, latents };

// The decoder of a moment network sees features and learned latents, then what its layers make; the last layer also
// what sharpening added, behind the others. That layer's outputs are the corrections, the sharpness of three parts and,
// where lobes are stretched, three more. The decoder of a latent network sees latents, and makes parameters.
struct NetworkArgs {
    NetworkKind kind;
    int read, made;  // 0 gltf, 1 gltf-anisotropic, 2 ggx, 3 beckmann; moment networks read what `made` says
    NetworkLimits limits;
    NetworkLayer whiten;  // of latent networks
    const NetworkLayer* encoder;
    int encoder_layers;
    NetworkLayer project;
    const NetworkLayer* decoder;
    int decoder_layers;
};
struct NetworkCounts {
    std::int64_t read, made, inputs, moments, detail, features, outputs;
};
// What such a network must have: channels that are read and made, and numbers of its parts.
NetworkCounts network_counts(NetworkKind kind, int read, int made);

// What each of `n` texels or rows of a level is summed from: (n, taps) of the finer ones, by the sharpened filter and
// by the plain one.
struct AxisWeights {
    const std::int32_t* index;
    const float *sharp, *plain;
    int n, taps;
};

// An image of latents that is filtered from a finer one: decoded as a level, or there for coarser ones, or both.
struct NetworkSink {
    int source;  // -1 for level 0, or the index of an earlier sink
    AxisWeights rows, columns;
    float* out;         // (rows.n, columns.n, made) of a level; null where nothing is decoded
    const float* bias;  // of all layers of the decoder for that level, one after the other
};

struct NetworkBakeArgs {
    const float* stored;  // (height, width, read)
    std::int64_t height, width;
    bool wrap_rows, wrap_columns;  // or clamped
    const float *sharp, *plain;    // 2 reach + 1 and 2 reach - 1 taps of level 0
    int reach;
    const float* bias;  // of the decoder for level 0
    float* top;         // (height, width, made)
    const NetworkSink* sinks;
    int sink_count;
};

// A part of a bake, for workers that share one. The rows that it reads stand in its image in the order of the whole.
struct NetworkPart {
    std::int64_t begin, end;  // rows of level 0 that are decoded, the first to `top`
    const float* latents;     // null, or (height, row_floats of the width) in place of `stored`, without level 0
    int kept;                 // the sink whose latents are kept for another part, or -1
    float* out;               // (rows.n, row_floats of columns.n) of that sink
};

class Network;  // packed weights

// Bakes every level of a set, some rows of level 0 at a time. What args point to must live as long. Results do not
// depend on the number of threads. Rows of `stored` are read from the top down, but for those that filters and the
// encoder reach beyond the rows that are baked, across the border where rows wrap. A row of a level is written once,
// when it is complete; all rows are after the last advance().
class NetworkBake {
  public:
    NetworkBake(std::shared_ptr<const Network> network, const NetworkBakeArgs& args);
    NetworkBake(std::shared_ptr<const Network> network, const NetworkBakeArgs& args, const NetworkPart& part);
    ~NetworkBake();
    std::int64_t rows_done() const;
    void advance();                                                          // the next rows
    static std::int64_t row_floats(const Network& network, std::int64_t n);  // of the latents of n texels
  private:
    struct State;
    std::unique_ptr<State> state_;
};
std::shared_ptr<const Network> packed_network(const NetworkArgs& args);

// The same bake on a card: of arrays of the host, which are complete when it returns. Results differ from those of
// NetworkBake by rounding. Beside level 0 the card holds the latents of every sink, and maps of half a million texels.
void network_bake_cuda(const NetworkArgs& network, const NetworkBakeArgs& args, CudaStream stream);

// ---- Interpolation and antialiasing of rasterised images ----

// rast: (batch, height, width, 4) with u, v, z/w, triangle + 1; tri: (triangles, 3). All arrays are C-contiguous.
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

// ---- Texture ----

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

// ---- Resampling ----

// One axis of a resampling: output i is the sum over its `taps` of weights[i * taps + t] times input index[i * taps +
// t].
template <class T>
struct ResampleAxis {
    const std::int64_t* index;  // (count, taps), in range
    const T* weights;           // (count, taps)
    std::int64_t count, taps;
};

// Rows of `width` texels of `channels` consecutive numbers each.
template <class T>
struct ResampleArgs {
    const T* image;
    std::int64_t row_stride, width, channels;  // the stride is in elements
    ResampleAxis<T> rows, columns;
};

// out: (rows.count, columns.count, channels), C-contiguous. Rows are combined first, then columns, tap after tap, each
// product and sum rounded by itself: the same bits on every instruction set and for any number of threads. An axis of
// one tap is copied, whatever its weights.
template <class T>
void resample_cpu(const ResampleArgs<T>& args, T* out);

// ---- Rasterisation ----

constexpr int max_resolution = 32768;  // pixels along an axis

// T is float or double; everything is C-contiguous.
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

}  // namespace mipbake
