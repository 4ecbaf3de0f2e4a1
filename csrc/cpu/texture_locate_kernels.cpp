// From coordinates to texels, a block at a time, in loops over its lookups that vectorise; and the adjoint, from slopes
// in the texture back to coordinates, their derivatives and the bias.
#include "cpu/texture_block.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

// ---- Reading ----

// Forced inline, so that a constant stride makes wide loads of it.
template <class T>
MIPBAKE_INLINE void spread(int count, const T* __restrict from, Index stride, int components,
                           T (*__restrict to)[block_size]) {
    for (int k = 0; k < components; ++k)
        for (int i = 0; i < count; ++i) to[k][i] = from[i * stride + k];
}

template <class T>
void spread_planar(int count, const T* __restrict uv, Index stride, T* __restrict u, T* __restrict v) {
    if (stride == 2) {
        for (int i = 0; i < count; ++i) {
            u[i] = uv[2 * i];
            v[i] = uv[2 * i + 1];
        }
        return;
    }
    for (int i = 0; i < count; ++i) {
        u[i] = uv[i * stride];
        v[i] = uv[i * stride + 1];
    }
}

template <class T>
void spread_derivatives(int count, const T* __restrict da, Index stride, T (*__restrict to)[block_size]) {
    if (stride == 4) {
        for (int i = 0; i < count; ++i) {
            to[0][i] = da[4 * i];
            to[1][i] = da[4 * i + 1];
            to[2][i] = da[4 * i + 2];
            to[3][i] = da[4 * i + 3];
        }
        return;
    }
    spread(count, da, stride, 4, to);
}

// ---- Levels of detail ----

template <class T>
void planar_lods(int count, const T (*__restrict da)[block_size], T width, T height, T* __restrict lod) {
    for (int i = 0; i < count; ++i) {
        const Jacobian<T> j = {width * da[0][i], width * da[1][i], height * da[2][i], height * da[3][i]};
        lod[i] = lod_of(ellipse_of(j));
    }
}

template <class T>
MIPBAKE_INLINE FaceDerivatives<T> derivatives_of(const Block<T>& b, int i) {
    const T d[6] = {b.da[0][i], b.da[1][i], b.da[2][i], b.da[3][i], b.da[4][i], b.da[5][i]};
    return face_derivatives(b.face[i], b.direction[0][i], b.direction[1][i], b.direction[2][i], d);
}

template <class T>
void add_bias(int count, const T* __restrict bias, T* __restrict lod) {
    for (int i = 0; i < count; ++i) lod[i] += bias[i];
}

// Turns what was read into u, v, face and lod.
template <class T>
void prepare(const TextureArgs<T>& args, Block<T>& b) {
    const bool is_cube = args.boundary_u == Boundary::cube;
    if (is_cube)
        for (int i = 0; i < b.count; ++i) {
            const CubePoint<T> point = cube_point(b.direction[0][i], b.direction[1][i], b.direction[2][i]);
            b.face[i] = point.face;
            b.u[i] = point.s;
            b.v[i] = point.t;
        }
    if (!is_mipmapped(args.filter)) return;
    if (args.uv_da == nullptr || args.filter == Filter::anisotropic) {
        const bool is_biased = args.bias != nullptr;
        for (int i = 0; i < b.count; ++i) b.lod[i] = is_biased ? b.bias[i] : T(0);
        return;
    }
    if (is_cube) {
        for (int i = 0; i < b.count; ++i)
            b.lod[i] = b.face[i] < 0 ? T(0) : lod_of(ellipse_of(cube_jacobian(derivatives_of(b, i), args.widths[0])));
    } else {
        planar_lods(b.count, b.da, static_cast<T>(args.widths[0]), static_cast<T>(args.heights[0]), b.lod);
    }
    if (args.bias == nullptr) return;
    add_bias(b.count, b.bias, b.lod);
    if (is_cube)
        for (int i = 0; i < b.count; ++i) b.lod[i] = b.face[i] < 0 ? T(0) : b.lod[i];
}

// ---- Levels and texels ----

template <class T>
void level_pairs(int count, bool nearest, const T* __restrict lod, int last, int* __restrict finer,
                 int* __restrict coarser, T* __restrict blend) {
    if (nearest) {
        for (int i = 0; i < count; ++i) {
            const LevelPair<T> pair = nearest_level(lod[i], last);
            finer[i] = pair.finer;
            coarser[i] = pair.coarser;
            blend[i] = pair.blend;
        }
        return;
    }
    for (int i = 0; i < count; ++i) {
        const LevelPair<T> pair = level_pair(lod[i], last);
        finer[i] = pair.finer;
        coarser[i] = pair.coarser;
        blend[i] = pair.blend;
    }
}

inline void gather(int count, const int* __restrict table, const int* __restrict index, int* __restrict out) {
    for (int i = 0; i < count; ++i) out[i] = table[index[i]];
}

template <class T>
bool any_blend(int count, const T* blend) {
    int mixed = 0;
    for (int i = 0; i < count; ++i) mixed |= static_cast<int>(blend[i] != 0);
    return mixed != 0;
}

template <class T>
void choose_levels(const TextureArgs<T>& args, bool always_both, Block<T>& b) {
    const int last = args.level_count - 1;
    const bool is_nearest = args.filter == Filter::linear_mipmap_nearest;
    const bool needs_both =
        always_both && (args.filter == Filter::linear_mipmap_linear || args.filter == Filter::anisotropic);
    if (is_uniform(args)) {
        const T lod = is_mipmapped(args.filter) ? b.lod[0] : T(0);
        const LevelPair<T> pair = is_nearest ? nearest_level(lod, last) : level_pair(lod, last);
        b.blended = pair.blend != 0 || needs_both;
        for (int i = 0; i < b.count; ++i) b.blend[i] = pair.blend;
        for (int s = 0; s < (b.blended ? 2 : 1); ++s) {
            const int level = s == 0 ? pair.finer : pair.coarser;
            for (int i = 0; i < b.count; ++i) b.level[s][i] = level;
            for (int i = 0; i < b.count; ++i) b.height[s][i] = args.heights[level];
            for (int i = 0; i < b.count; ++i) b.width[s][i] = args.widths[level];
        }
    } else {
        level_pairs(b.count, is_nearest, b.lod, last, b.level[0], b.level[1], b.blend);
        b.blended = any_blend(b.count, b.blend) || needs_both;
        for (int s = 0; s < (b.blended ? 2 : 1); ++s) {
            gather(b.count, args.heights, b.level[s], b.height[s]);
            gather(b.count, args.widths, b.level[s], b.width[s]);
        }
    }
}

template <Boundary boundary, bool nearest, class T>
void taps_with(int count, const T* __restrict coordinate, const int* __restrict size, int* __restrict first,
               int* __restrict second, T* __restrict fraction) {
    for (int i = 0; i < count; ++i) {
        const Tap<T> tap =
            nearest ? nearest_tap<boundary>(coordinate[i], size[i]) : linear_tap<boundary>(coordinate[i], size[i]);
        first[i] = tap.first;
        second[i] = tap.second;
        fraction[i] = tap.fraction;
    }
}

template <class T>
void taps(Boundary boundary, bool nearest, int count, const T* coordinate, const int* size, int* first, int* second,
          T* fraction) {
    switch (boundary) {
        case Boundary::wrap:
            return (nearest ? taps_with<Boundary::wrap, true, T>
                            : taps_with<Boundary::wrap, false, T>)(count, coordinate, size, first, second, fraction);
        case Boundary::clamp:
            return (nearest ? taps_with<Boundary::clamp, true, T>
                            : taps_with<Boundary::clamp, false, T>)(count, coordinate, size, first, second, fraction);
        case Boundary::mirror:
            return (nearest ? taps_with<Boundary::mirror, true, T>
                            : taps_with<Boundary::mirror, false, T>)(count, coordinate, size, first, second, fraction);
        case Boundary::zero:
            return (nearest ? taps_with<Boundary::zero, true, T>
                            : taps_with<Boundary::zero, false, T>)(count, coordinate, size, first, second, fraction);
        case Boundary::cube:
            return (nearest ? taps_with<Boundary::cube, true, T>
                            : taps_with<Boundary::cube, false, T>)(count, coordinate, size, first, second, fraction);
    }
}

template <class T>
void find_rows(const TextureArgs<T>& args, int s, Block<T>& b) {
    taps(args.boundary_v, args.filter == Filter::nearest, b.count, b.v, b.height[s], b.y0[s], b.y1[s], b.y[s]);
}

template <class T>
void find_columns(const TextureArgs<T>& args, int s, Block<T>& b) {
    taps(args.boundary_u, args.filter == Filter::nearest, b.count, b.u, b.width[s], b.x0[s], b.x1[s], b.x[s]);
}

// ---- Adjoint ----

template <class T>
void planar_derivative_slopes(int count, const T (*__restrict da)[block_size], T width, T height,
                              const T* __restrict lod, T* __restrict out) {
    T slopes[4][block_size];
    for (int i = 0; i < count; ++i) {
        const Jacobian<T> j = {width * da[0][i], width * da[1][i], height * da[2][i], height * da[3][i]};
        const Jacobian<T> g = lod_adjoint(j, ellipse_of(j), lod[i]);
        slopes[0][i] = width * g.sx;
        slopes[1][i] = width * g.sy;
        slopes[2][i] = height * g.tx;
        slopes[3][i] = height * g.ty;
    }
    for (int i = 0; i < count; ++i) {
        // A lookup without a slope has none by derivatives that are not finite either.
        const bool is_flat = lod[i] == 0;
        for (int k = 0; k < 4; ++k) out[4 * i + k] = is_flat ? T(0) : slopes[k][i];
    }
}

template <class T>
void axis_slopes(const TextureArgs<T>& args, const Block<T>& b, const Axes<T>& axes, const Slopes<T>& slopes, T* out) {
    const T width = static_cast<T>(args.widths[0]), height = static_cast<T>(args.heights[0]);
    for (int i = 0; i < b.count; ++i) {
        const Jacobian<T> j = {width * b.da[0][i], width * b.da[1][i], height * b.da[2][i], height * b.da[3][i]};
        const bool is_one = axes.taps[i] == 1;
        const Jacobian<T> g = axis_adjoint(j, ellipse_of(j), is_one ? T(0) : slopes.axis_u[i] / width,
                                           is_one ? T(0) : slopes.axis_v[i] / height, slopes.lod[i]);
        const bool is_flat = slopes.lod[i] == 0 && slopes.axis_u[i] == 0 && slopes.axis_v[i] == 0;
        out[4 * i] = is_flat ? T(0) : width * g.sx;
        out[4 * i + 1] = is_flat ? T(0) : width * g.sy;
        out[4 * i + 2] = is_flat ? T(0) : height * g.tx;
        out[4 * i + 3] = is_flat ? T(0) : height * g.ty;
    }
}

template <class T>
void write_cube_slopes(const TextureArgs<T>& args, const Block<T>& b, const Slopes<T>& slopes, T* uv, T* uv_da) {
    const bool has_lod = args.uv_da != nullptr && args.filter == Filter::linear_mipmap_linear;
    for (int i = 0; i < b.count; ++i) {
        T direction[3] = {0, 0, 0}, derivatives[6] = {0, 0, 0, 0, 0, 0};
        if (b.face[i] >= 0) {
            T d[6] = {0, 0, 0, 0, 0, 0};
            const bool is_sloped = has_lod && slopes.lod[i] != 0;
            if (is_sloped)
                for (int k = 0; k < 6; ++k) d[k] = b.da[k][i];
            const FaceDerivatives<T> f =
                face_derivatives(b.face[i], b.direction[0][i], b.direction[1][i], b.direction[2][i], d);
            Jacobian<T> g = {0, 0, 0, 0};
            if (is_sloped) {
                const Jacobian<T> j = cube_jacobian(f, args.widths[0]);
                g = lod_adjoint(j, ellipse_of(j), slopes.lod[i]);
            }
            cube_adjoint(b.face[i], f, args.widths[0], slopes.u[i], slopes.v[i], g, direction, derivatives);
        }
        if (uv != nullptr)
            for (int k = 0; k < 3; ++k) uv[3 * i + k] = direction[k];
        if (uv_da != nullptr)
            for (int k = 0; k < 6; ++k) uv_da[6 * i + k] = derivatives[k];
    }
}

}  // namespace

template <class T>
MIPBAKE_KERNEL void read_lookups(const TextureArgs<T>& args, Index item, Index point, int count, Block<T>& b) {
    b.count = count;
    b.item = item;
    b.point = point;
    const T* const uv = args.uv + item * args.uv_batch_stride + point * args.uv_point_stride;
    const bool is_cube = args.boundary_u == Boundary::cube;
    if (is_cube)
        spread(count, uv, args.uv_point_stride, 3, b.direction);
    else
        spread_planar(count, uv, args.uv_point_stride, b.u, b.v);
    if (is_mipmapped(args.filter) && args.uv_da != nullptr) {
        const T* const da = args.uv_da + item * args.uv_da_batch_stride + point * args.uv_da_point_stride;
        if (is_cube)
            spread(count, da, args.uv_da_point_stride, 6, b.da);
        else
            spread_derivatives(count, da, args.uv_da_point_stride, b.da);
    }
    if (is_mipmapped(args.filter) && args.bias != nullptr) {
        const T* const bias = args.bias + item * args.bias_batch_stride + point * args.bias_point_stride;
        if (args.bias_point_stride == 1)
            for (int i = 0; i < count; ++i) b.bias[i] = bias[i];
        else
            for (int i = 0; i < count; ++i) b.bias[i] = bias[i * args.bias_point_stride];
    }
    prepare(args, b);
}

template <class T>
MIPBAKE_KERNEL void read_listed(const TextureArgs<T>& args, Index first, const std::uint32_t* list, int shift,
                                int count, Block<T>& b) {
    if (shift == 0 && list[count - 1] - list[0] == static_cast<std::uint32_t>(count - 1)) {  // no gaps, as they ascend
        const Index lookup = first + list[0], item = args.batch == 1 ? 0 : lookup / args.points;
        const Index point = lookup - item * args.points;
        if (point + count <= args.points) return read_lookups(args, item, point, count, b);
    }
    b.count = count;
    const bool is_cube = args.boundary_u == Boundary::cube, is_one_item = args.batch == 1;
    const int coordinates = is_cube ? 3 : 2, derivatives = 2 * coordinates;
    const bool has_da = is_mipmapped(args.filter) && args.uv_da != nullptr;
    const bool has_bias = is_mipmapped(args.filter) && args.bias != nullptr;
    for (int i = 0; i < count; ++i) {
        const Index lookup = first + (list[i] >> shift);
        const Index item = is_one_item ? 0 : lookup / args.points, point = lookup - item * args.points;
        const T* const uv = args.uv + item * args.uv_batch_stride + point * args.uv_point_stride;
        if (is_cube) {
            for (int k = 0; k < coordinates; ++k) b.direction[k][i] = uv[k];
        } else {
            b.u[i] = uv[0];
            b.v[i] = uv[1];
        }
        if (has_da) {
            const T* const da = args.uv_da + item * args.uv_da_batch_stride + point * args.uv_da_point_stride;
            for (int k = 0; k < derivatives; ++k) b.da[k][i] = da[k];
        }
        if (has_bias) b.bias[i] = args.bias[item * args.bias_batch_stride + point * args.bias_point_stride];
    }
    prepare(args, b);
}

template <class T>
MIPBAKE_KERNEL void find_axes(const TextureArgs<T>& args, Block<T>& b, Axes<T>& axes) {
    const T width = static_cast<T>(args.widths[0]), height = static_cast<T>(args.heights[0]);
    for (int i = 0; i < b.count; ++i) {
        const Jacobian<T> j = {width * b.da[0][i], width * b.da[1][i], height * b.da[2][i], height * b.da[3][i]};
        const AxisTaps<T> taps = axis_taps(j, ellipse_of(j));
        axes.taps[i] = taps.count;
        axes.u[i] = taps.s / width;
        axes.v[i] = taps.t / height;
        b.lod[i] += taps.lod;
    }
}

template <class T>
MIPBAKE_KERNEL void locate(const TextureArgs<T>& args, bool always_both, Block<T>& b) {
    choose_levels(args, always_both, b);
    for (int s = 0; s < (b.blended ? 2 : 1); ++s) {
        find_rows(args, s, b);
        find_columns(args, s, b);
    }
}

template <class T>
MIPBAKE_KERNEL void locate_rows(const TextureArgs<T>& args, Block<T>& b) {
    choose_levels(args, false, b);
    for (int s = 0; s < (b.blended ? 2 : 1); ++s) find_rows(args, s, b);
}

template <class T>
MIPBAKE_KERNEL void locate_in_level(const TextureArgs<T>& args, int level, Block<T>& b) {
    const int last = args.level_count - 1;
    for (int i = 0; i < b.count; ++i) b.height[0][i] = args.heights[level];
    for (int i = 0; i < b.count; ++i) b.width[0][i] = args.widths[level];
    find_rows(args, 0, b);
    find_columns(args, 0, b);
    if (!is_mipmapped(args.filter) || args.filter == Filter::linear_mipmap_nearest) {
        // A lookup with a NaN level of detail is also in a list, and must stay NaN.
        const bool is_mipmap = is_mipmapped(args.filter);
        for (int i = 0; i < b.count; ++i) b.blend[i] = !is_mipmap || b.lod[i] == b.lod[i] ? T(1) : b.lod[i];
        return;
    }
    for (int i = 0; i < b.count; ++i) {
        const LevelPair<T> pair = level_pair(b.lod[i], last);
        b.blend[i] = pair.finer == level ? 1 - pair.blend : pair.blend;
    }
}

template <class T>
MIPBAKE_KERNEL void write_slopes(const TextureArgs<T>& args, const TextureGrads<T>& grads, const Block<T>& b,
                                 const Axes<T>* axes, const Slopes<T>& slopes) {
    const Index lookup = b.item * args.points + b.point;
    if (grads.bias != nullptr)
        for (int i = 0; i < b.count; ++i) grads.bias[lookup + i] = slopes.lod[i];
    if (args.boundary_u == Boundary::cube) {
        write_cube_slopes(args, b, slopes, grads.uv == nullptr ? nullptr : grads.uv + 3 * lookup,
                          grads.uv_da == nullptr ? nullptr : grads.uv_da + 6 * lookup);
        return;
    }
    if (grads.uv != nullptr)
        for (int i = 0; i < b.count; ++i) {
            grads.uv[2 * (lookup + i)] = slopes.u[i];
            grads.uv[2 * (lookup + i) + 1] = slopes.v[i];
        }
    if (grads.uv_da == nullptr) return;
    T* const out = grads.uv_da + 4 * lookup;
    if (axes != nullptr)
        axis_slopes(args, b, *axes, slopes, out);
    else if (args.filter == Filter::linear_mipmap_linear && args.uv_da != nullptr)
        planar_derivative_slopes(b.count, b.da, static_cast<T>(args.widths[0]), static_cast<T>(args.heights[0]),
                                 slopes.lod, out);
    else
        for (int i = 0; i < 4 * b.count; ++i) out[i] = 0;
}

#define MIPBAKE_INSTANTIATE(T)                                                                                    \
    template void read_lookups<T>(const TextureArgs<T>&, Index, Index, int, Block<T>&);                           \
    template void read_listed<T>(const TextureArgs<T>&, Index, const std::uint32_t*, int, int, Block<T>&);        \
    template void find_axes<T>(const TextureArgs<T>&, Block<T>&, Axes<T>&);                                       \
    template void locate<T>(const TextureArgs<T>&, bool, Block<T>&);                                              \
    template void locate_rows<T>(const TextureArgs<T>&, Block<T>&);                                               \
    template void locate_in_level<T>(const TextureArgs<T>&, int, Block<T>&);                                      \
    template void write_slopes<T>(const TextureArgs<T>&, const TextureGrads<T>&, const Block<T>&, const Axes<T>*, \
                                  const Slopes<T>&);
MIPBAKE_INSTANTIATE(float)
MIPBAKE_INSTANTIATE(double)

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
