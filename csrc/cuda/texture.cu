// Texture lookups: one thread per lookup. Texel gradients are added with atomics: their order, and so their last
// digits, vary. A MIP step and its adjoint: one thread per number that is written, which makes both reproducible.
#include "cuda/launch.h"
#include "sampling/cube.h"
#include "sampling/mip.h"
#include "sampling/quads.h"

namespace mipbake {
namespace {

using namespace cuda;
using Args = TextureArgs<float>;
using Grads = TextureGrads<float>;

__device__ bool is_mipmapped(Filter filter) { return filter != Filter::nearest && filter != Filter::linear; }

template <Boundary boundary>
__device__ Tap<float> tap_with(bool nearest, float coordinate, int size) {
    return nearest ? nearest_tap<boundary>(coordinate, size) : linear_tap<boundary>(coordinate, size);
}

__device__ Tap<float> tap(Boundary boundary, bool nearest, float coordinate, int size) {
    switch (boundary) {
        case Boundary::wrap:
            return tap_with<Boundary::wrap>(nearest, coordinate, size);
        case Boundary::clamp:
            return tap_with<Boundary::clamp>(nearest, coordinate, size);
        case Boundary::mirror:
            return tap_with<Boundary::mirror>(nearest, coordinate, size);
        case Boundary::zero:
            return tap_with<Boundary::zero>(nearest, coordinate, size);
        default:
            return tap_with<Boundary::cube>(nearest, coordinate, size);
    }
}

// A lookup as it was read: where it is, and how many taps it takes along which axis (in units of the texture).
struct Lookup {
    Index item;
    float u, v, lod;
    int face;  // -1: a direction that points nowhere; 0 in planes
    int taps;
    float axis_u, axis_v;
    float direction[3], derivatives[6];
};

__device__ Jacobian<float> jacobian_of(const Args& args, const Lookup& lookup) {
    const float* const d = lookup.derivatives;
    if (args.boundary_u == Boundary::cube)
        return cube_jacobian(face_derivatives(lookup.face, lookup.direction[0], lookup.direction[1],
                                              lookup.direction[2], lookup.derivatives),
                             args.widths[0]);
    const float width = static_cast<float>(args.widths[0]), height = static_cast<float>(args.heights[0]);
    return {width * d[0], width * d[1], height * d[2], height * d[3]};
}

__device__ Lookup read_lookup(const Args& args, Index n) {
    Lookup lookup = {};
    lookup.item = n / args.points;
    lookup.taps = 1;
    const Index point = n - lookup.item * args.points;
    const float* const uv = args.uv + lookup.item * args.uv_batch_stride + point * args.uv_point_stride;
    const bool is_cube = args.boundary_u == Boundary::cube;
    if (is_cube) {
        for (int k = 0; k < 3; ++k) lookup.direction[k] = uv[k];
        const CubePoint<float> at = cube_point(uv[0], uv[1], uv[2]);
        lookup.face = at.face;
        lookup.u = at.s;
        lookup.v = at.t;
        if (at.face < 0) return lookup;
    } else {
        lookup.u = uv[0];
        lookup.v = uv[1];
    }
    if (!is_mipmapped(args.filter)) return lookup;
    if (args.bias != nullptr)
        lookup.lod = args.bias[lookup.item * args.bias_batch_stride + point * args.bias_point_stride];
    if (args.uv_da == nullptr) return lookup;
    const float* const da = args.uv_da + lookup.item * args.uv_da_batch_stride + point * args.uv_da_point_stride;
    for (int k = 0; k < (is_cube ? 6 : 4); ++k) lookup.derivatives[k] = da[k];
    const Ellipse<float> ellipse = ellipse_of(jacobian_of(args, lookup));
    if (args.filter != Filter::anisotropic) {
        lookup.lod += lod_of(ellipse);
        return lookup;
    }
    const AxisTaps<float> taps = axis_taps(jacobian_of(args, lookup), ellipse);
    lookup.taps = taps.count;
    lookup.axis_u = taps.s / static_cast<float>(args.widths[0]);
    lookup.axis_v = taps.t / static_cast<float>(args.heights[0]);
    lookup.lod += taps.lod;
    return lookup;
}

__device__ LevelPair<float> levels_of(const Args& args, const Lookup& lookup) {
    const int last = args.level_count - 1;
    if (!is_mipmapped(args.filter)) return {0, 0, 0.0f};
    return args.filter == Filter::linear_mipmap_nearest ? nearest_level(lookup.lod, last)
                                                        : level_pair(lookup.lod, last);
}

__device__ float place_of(const Lookup& lookup, int ordinal) {
    return (static_cast<float>(ordinal) + 0.5f) / static_cast<float>(lookup.taps) - 0.5f;
}

// One tap in one level: its texels, and their places in a contiguous level, -1 outside.
template <class S>
struct Located {
    GeneralQuad<S> quad;
    Index texels[4];
};

template <class S>
__device__ Located<S> locate(const Args& args, const Lookup& lookup, int ordinal, int level) {
    const int width = args.widths[level], height = args.heights[level];
    const bool nearest = args.filter == Filter::nearest, is_moved = lookup.taps > 1;
    const float place = place_of(lookup, ordinal);
    const float u = is_moved ? lookup.u + place * lookup.axis_u : lookup.u;
    const float v = is_moved ? lookup.v + place * lookup.axis_v : lookup.v;
    const Tap<float> x = tap(args.boundary_u, nearest, u, width), y = tap(args.boundary_v, nearest, v, height);
    const TextureImage& image = args.levels[level];
    const S* const texels = static_cast<const S*>(image.texels) + lookup.item * image.batch_stride;
    Located<S> located;
    located.quad.x = x.fraction;
    located.quad.y = y.fraction;
    located.quad.missing = -1;
    if (args.boundary_u == Boundary::cube) {
        const bool valid = lookup.face >= 0;
        const CubeQuadTexels found = cube_quad(valid ? lookup.face : 0, y.first, y.second, x.first, x.second, width);
        if (valid) located.quad.missing = found.missing;
        for (int k = 0; k < 4; ++k) {
            const CubeTexel t = found.texels[k];
            located.texels[k] = valid ? (Index(t.face) * height + t.row) * width + t.column : -1;
            located.quad.texels[k] =
                valid ? texels + t.face * image.face_stride + t.row * image.row_stride + t.column * image.texel_stride
                      : nullptr;
        }
        return located;
    }
    for (int k = 0; k < 4; ++k) {
        const int row = (k & 2) != 0 ? y.second : y.first, column = (k & 1) != 0 ? x.second : x.first;
        const bool inside = row >= 0 && column >= 0;
        located.texels[k] = inside ? Index(row) * width + column : -1;
        located.quad.texels[k] = inside ? texels + row * image.row_stride + column * image.texel_stride : nullptr;
    }
    return located;
}

template <class S>
__device__ void look_up(const Args& args, Index n, float* out) {
    const Lookup lookup = read_lookup(args, n);
    const LevelPair<float> pair = levels_of(args, lookup);
    float* const texel = out + n * args.channels;
    for (int k = 0; k < lookup.taps; ++k) {
        const GeneralQuad<S> finer = locate<S>(args, lookup, k, pair.finer).quad;
        const GeneralQuad<S> coarser = pair.blend != 0 ? locate<S>(args, lookup, k, pair.coarser).quad : finer;
        const float share = 1.0f / static_cast<float>(k + 1);
        for (int c = 0; c < args.channels; ++c) {
            const float fine = bilinear(finer, c);
            const float value = pair.blend != 0 ? lerp(fine, bilinear(coarser, c), pair.blend) : fine;
            // The mean of the taps so far; equal taps give exactly their value.
            texel[c] = k == 0 ? value : lerp(texel[c], value, share);
        }
    }
}

template <class S>
__global__ void texture_kernel(const __grid_constant__ Args args, float* out) {
    for_each(args.batch * args.points, [&](Index n) { look_up<S>(args, n, out); });
}

template <class S>
__device__ void add_texels(const Args& args, const Grads& grads, const Located<S>& located, Index item, int level,
                           float weight, const float* grad) {
    const Index size =
        Index(args.heights[level]) * args.widths[level] * args.channels * (args.boundary_u == Boundary::cube ? 6 : 1);
    float* const target = grads.levels[level] + (grads.level_batch[level] > 1 ? item * size : 0);
    float weights[4];
    quad_weights(located.quad.x, located.quad.y, weight, located.quad.missing, weights);
    for (int k = 0; k < 4; ++k) {
        if (weights[k] == 0 || located.texels[k] < 0) continue;
        float* const texel = target + located.texels[k] * args.channels;
        for (int c = 0; c < args.channels; ++c) atomicAdd(texel + c, weights[k] * grad[c]);
    }
}

// Gradients of a lookup by its place in the texture or face, its level of detail and its axis.
struct LookupSlopes {
    float u, v, lod, axis_u, axis_v;
};

__device__ void write_slopes(const Args& args, const Grads& grads, const Lookup& lookup, const LookupSlopes& slopes,
                             Index n) {
    if (grads.bias != nullptr) grads.bias[n] = slopes.lod;
    const bool is_cube = args.boundary_u == Boundary::cube;
    const bool is_sloped = args.uv_da != nullptr && is_mipmapped(args.filter) &&
                           (slopes.lod != 0 || slopes.axis_u != 0 || slopes.axis_v != 0);
    Jacobian<float> by_jacobian = {0, 0, 0, 0};
    const float width = static_cast<float>(args.widths[0]), height = static_cast<float>(args.heights[0]);
    if (is_sloped) {
        const Jacobian<float> j = jacobian_of(args, lookup);
        const Ellipse<float> ellipse = ellipse_of(j);
        by_jacobian = lookup.taps > 1
                          ? axis_adjoint(j, ellipse, slopes.axis_u / width, slopes.axis_v / height, slopes.lod)
                          : lod_adjoint(j, ellipse, slopes.lod);
    }
    if (!is_cube) {
        if (grads.uv != nullptr) {
            grads.uv[2 * n] = slopes.u;
            grads.uv[2 * n + 1] = slopes.v;
        }
        if (grads.uv_da != nullptr) {
            grads.uv_da[4 * n] = width * by_jacobian.sx;
            grads.uv_da[4 * n + 1] = width * by_jacobian.sy;
            grads.uv_da[4 * n + 2] = height * by_jacobian.tx;
            grads.uv_da[4 * n + 3] = height * by_jacobian.ty;
        }
        return;
    }
    float direction[3] = {0, 0, 0}, derivatives[6] = {0, 0, 0, 0, 0, 0};
    if (lookup.face >= 0) {
        float d[6] = {0, 0, 0, 0, 0, 0};
        if (is_sloped)
            for (int k = 0; k < 6; ++k) d[k] = lookup.derivatives[k];
        const FaceDerivatives<float> f =
            face_derivatives(lookup.face, lookup.direction[0], lookup.direction[1], lookup.direction[2], d);
        cube_adjoint(lookup.face, f, args.widths[0], slopes.u, slopes.v, by_jacobian, direction, derivatives);
    }
    if (grads.uv != nullptr)
        for (int k = 0; k < 3; ++k) grads.uv[3 * n + k] = direction[k];
    if (grads.uv_da != nullptr)
        for (int k = 0; k < 6; ++k) grads.uv_da[6 * n + k] = derivatives[k];
}

template <class S>
__device__ void look_back(const Args& args, const Grads& grads, Index n) {
    const Lookup lookup = read_lookup(args, n);
    const LevelPair<float> pair = levels_of(args, lookup);
    const float* const grad = grads.out + n * args.channels;
    const bool by_uv = grads.uv != nullptr || grads.uv_da != nullptr || grads.bias != nullptr;
    const float weight = 1.0f / static_cast<float>(lookup.taps);
    LookupSlopes slopes = {0, 0, 0, 0, 0};
    for (int k = 0; k < lookup.taps; ++k) {
        const Located<S> finer = locate<S>(args, lookup, k, pair.finer);
        // NaN in any of them makes the whole lookup NaN: it then adds to no gradient. Nor does a lookup without a
        // direction.
        const float sum = finer.quad.x + finer.quad.y + pair.blend;
        if (sum != sum || lookup.face < 0) continue;
        const bool has_coarser = pair.finer != pair.coarser && (pair.blend != 0 || by_uv);
        const Located<S> coarser = has_coarser ? locate<S>(args, lookup, k, pair.coarser) : finer;
        if (grads.levels[0] != nullptr) {
            add_texels(args, grads, finer, lookup.item, pair.finer, weight * (1 - pair.blend), grad);
            if (pair.blend != 0) add_texels(args, grads, coarser, lookup.item, pair.coarser, weight * pair.blend, grad);
        }
        if (!by_uv) continue;
        const QuadSlopes<float> fine = quad_slopes<0>(finer.quad, args.channels, grad);
        float du = fine.x * static_cast<float>(args.widths[pair.finer]);
        float dv = fine.y * static_cast<float>(args.heights[pair.finer]);
        if (has_coarser) {
            const QuadSlopes<float> coarse = quad_slopes<0>(coarser.quad, args.channels, grad);
            du = lerp(du, coarse.x * static_cast<float>(args.widths[pair.coarser]), pair.blend);
            dv = lerp(dv, coarse.y * static_cast<float>(args.heights[pair.coarser]), pair.blend);
            slopes.lod += weight * (coarse.value - fine.value);
        }
        const float place = place_of(lookup, k);
        slopes.u += weight * du;
        slopes.v += weight * dv;
        slopes.axis_u += weight * place * du;
        slopes.axis_v += weight * place * dv;
    }
    if (lookup.taps == 1) slopes.axis_u = slopes.axis_v = 0;
    if (by_uv) write_slopes(args, grads, lookup, slopes, n);
}

template <class S>
__global__ void backward_kernel(const __grid_constant__ Args args, const __grid_constant__ Grads grads) {
    for_each(args.batch * args.points, [&](Index n) { look_back<S>(args, grads, n); });
}

template <class S>
__device__ void average(const MipShape& shape, const S* level, Index n, S* out) {
    const int height = mip_size(shape.height), width = mip_size(shape.width), channels = shape.channels;
    const int c = static_cast<int>(n % channels), column = static_cast<int>(n / channels % width);
    const Index row = n / channels / width, image = row / height;
    const MipTaps<float> y = mip_taps<float>(static_cast<int>(row - image * height), shape.height);
    const MipTaps<float> x = mip_taps<float>(column, shape.width);
    // a + w (b - a) + v (c - a): equal numbers give exactly their value. Loops have as many rounds as there can be
    // taps, because weights stay in registers where a constant is their index.
    float first = 0, value = 0;
    for (int k = 0; k < 3; ++k) {
        if (k >= x.count) continue;
        const S* const at = level + ((image * shape.height + y.first) * shape.width + x.first + k) * channels + c;
        const Index step = Index(shape.width) * channels;
        const float a = value_of(at[0]);
        float column = a;
        for (int l = 1; l < 3; ++l)
            if (l < y.count) column += y.weights[l] * (value_of(at[l * step]) - a);
        if (k == 0) first = value = column;
        if (k > 0) value += x.weights[k] * (column - first);
    }
    store_value(value, out + n);
}

template <class S>
__global__ void mip_kernel(const __grid_constant__ MipShape shape, Index numbers, const S* level, S* out) {
    for_each(numbers, [&](Index n) { average(shape, level, n, out); });
}

__device__ void add_averages(const MipShape& shape, const float* grad_out, Index n, float* grad) {
    const int height = mip_size(shape.height), width = mip_size(shape.width), channels = shape.channels;
    const int c = static_cast<int>(n % channels), column = static_cast<int>(n / channels % shape.width);
    const Index row = n / channels / shape.width, image = row / shape.height;
    const MipTaps<float> y = mip_adjoint_taps<float>(static_cast<int>(row - image * shape.height), shape.height);
    const MipTaps<float> x = mip_adjoint_taps<float>(column, shape.width);
    float sum = 0;
    for (int k = 0; k < 2; ++k)
        for (int l = 0; l < 2; ++l) {
            if (k >= y.count || l >= x.count) continue;
            sum += y.weights[k] * x.weights[l] *
                   grad_out[((image * height + y.first + k) * width + x.first + l) * channels + c];
        }
    grad[n] += sum;
}

__global__ void mip_backward_kernel(const __grid_constant__ MipShape shape, Index numbers, const float* grad_out,
                                    float* grad) {
    for_each(numbers, [&](Index n) { add_averages(shape, grad_out, n, grad); });
}

// Calls f with a number of the type that texels are stored in.
template <class F>
void with_storage(Storage storage, F&& f) {
    if (storage == Storage::float16) return f(Float16());
    if (storage == Storage::bfloat16) return f(Bfloat16());
    f(float());
}

}  // namespace

void texture_cuda(const TextureArgs<float>& args, float* out, CudaStream stream) {
    const Queue queue(stream);
    with_storage(args.storage, [&](auto stored) {
        queue.run_each(args.batch * args.points, texture_kernel<decltype(stored)>, args, out);
    });
}

void texture_backward_cuda(const TextureArgs<float>& args, const TextureGrads<float>& grads, CudaStream stream) {
    const Queue queue(stream);
    for (int l = 0; l < args.level_count && grads.levels[0] != nullptr; ++l)
        queue.fill(grads.levels[l], grads.level_batch[l] * args.heights[l] * args.widths[l] * args.channels *
                                        (args.boundary_u == Boundary::cube ? 6 : 1));
    with_storage(args.storage, [&](auto stored) {
        queue.run_each(args.batch * args.points, backward_kernel<decltype(stored)>, args, grads);
    });
}

void texture_mip_cuda(const MipShape& shape, Storage storage, const void* level, void* out, CudaStream stream) {
    const Queue queue(stream);
    const Index numbers = shape.images * mip_size(shape.height) * mip_size(shape.width) * shape.channels;
    with_storage(storage, [&](auto stored) {
        using S = decltype(stored);
        queue.run_each(numbers, mip_kernel<S>, shape, numbers, static_cast<const S*>(level), static_cast<S*>(out));
    });
}

void texture_mip_backward_cuda(const MipShape& shape, const float* grad_out, float* grad, CudaStream stream) {
    const Index numbers = shape.images * shape.height * shape.width * shape.channels;
    Queue(stream).run_each(numbers, mip_backward_kernel, shape, numbers, grad_out, grad);
}

}  // namespace mipbake
