// The adjoint of lookups in their coordinates, derivatives and bias. Independent per lookup.
#include "cpu/texture_block.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

// Derivatives of a lookup by u, v and the level of detail.
template <class T>
struct LookupSlopes {
    T u, v, lod;
};

template <int C, class Q, class T>
MIPBAKE_INLINE LookupSlopes<T> slopes_of(const TextureArgs<T>& args, const BlockQuads<Q, T>& b, int i, const T* grad) {
    if (is_void(args, b.block, i)) return {0, 0, 0};
    const QuadSlopes<T> fine = quad_slopes<C>(widened<C>(b.quads[0][i]), args.channels, grad);
    LookupSlopes<T> s = {fine.x * static_cast<T>(b.block.width[0][i]), fine.y * static_cast<T>(b.block.height[0][i]),
                         0};
    if (b.block.blended && b.block.level[0][i] != b.block.level[1][i]) {
        const QuadSlopes<T> coarse = quad_slopes<C>(widened<C>(b.quads[1][i]), args.channels, grad);
        s.u = lerp(s.u, coarse.x * static_cast<T>(b.block.width[1][i]), b.block.blend[i]);
        s.v = lerp(s.v, coarse.y * static_cast<T>(b.block.height[1][i]), b.block.blend[i]);
        s.lod = coarse.value - fine.value;
    }
    return s;
}

template <class T>
bool wants_lod(const TextureGrads<T>& grads) {
    return grads.uv_da != nullptr || grads.bias != nullptr;
}

template <int C, class Q, class T>
MIPBAKE_KERNEL void slopes_with(const TextureArgs<T>& args, const void* zeros, const TextureGrads<T>& grads,
                                Index begin, Index end) {
    // Through the projection to a face, the level of detail depends on the direction too.
    const bool by_lod = wants_lod(grads) || (args.boundary_u == Boundary::cube && args.uv_da != nullptr);
    pipeline<Q>(args, zeros, by_lod, begin, end, [&](const BlockQuads<Q, T>& b) {
        const T* grad = grads.out + (b.block.item * args.points + b.block.point) * args.channels;
        Slopes<T> slopes;
        for (int i = 0; i < b.block.count; ++i, grad += C > 0 ? C : args.channels) {
            const LookupSlopes<T> s = slopes_of<C>(args, b, i, grad);
            slopes.u[i] = s.u;
            slopes.v[i] = s.v;
            slopes.lod[i] = s.lod;
        }
        write_slopes(args, grads, b.block, static_cast<const Axes<T>*>(nullptr), slopes);
    });
}

template <int C, class Q, class T>
MIPBAKE_KERNEL void tap_slopes_with(const TextureArgs<T>& args, const void* zeros, const TextureGrads<T>& grads,
                                    Index begin, Index end) {
    Slopes<T> slopes;
    for (int i = 0; i < block_size; ++i)
        slopes.u[i] = slopes.v[i] = slopes.lod[i] = slopes.axis_u[i] = slopes.axis_v[i] = 0;
    pipeline_taps<Q>(
        args, zeros, wants_lod(grads), begin, end,
        [&](const BlockQuads<Q, T>& b) {
            const T* const first = grads.out + (b.block.item * args.points + b.block.point) * args.channels;
            for (int i = 0; i < b.block.count; ++i) {
                const int owner = b.block.owner[i];
                const LookupSlopes<T> s = slopes_of<C>(args, b, i, first + Index(owner) * args.channels);
                const T weight = b.block.weight[i];
                slopes.u[owner] += weight * s.u;
                slopes.v[owner] += weight * s.v;
                slopes.lod[owner] += weight * s.lod;
                slopes.axis_u[owner] += weight * b.block.place[i] * s.u;
                slopes.axis_v[owner] += weight * b.block.place[i] * s.v;
            }
        },
        [&](const Block<T>& run, const Axes<T>& axes) {
            write_slopes(args, grads, run, &axes, slopes);
            for (int i = 0; i < block_size; ++i)
                slopes.u[i] = slopes.v[i] = slopes.lod[i] = slopes.axis_u[i] = slopes.axis_v[i] = 0;
        });
}

}  // namespace

template <class T>
void texture_slopes_range(const TextureArgs<T>& args, const void* zeros, const TextureGrads<T>& grads, Index begin,
                          Index end) {
    with_storage<T>(args.storage, [&](auto stored) {
        using S = decltype(stored);
        if (args.boundary_u == Boundary::cube) return slopes_with<0, GeneralQuad<S>>(args, zeros, grads, begin, end);
        if (args.filter == Filter::anisotropic)
            return args.channels == 4 ? tap_slopes_with<4, PlanarQuad<S>>(args, zeros, grads, begin, end)
                                      : tap_slopes_with<0, PlanarQuad<S>>(args, zeros, grads, begin, end);
        with_channels<S>(args.channels,
                         [&](auto c) { slopes_with<c.value, PlanarQuad<S>>(args, zeros, grads, begin, end); });
    });
}

template void texture_slopes_range<float>(const TextureArgs<float>&, const void*, const TextureGrads<float>&, Index,
                                          Index);
template void texture_slopes_range<double>(const TextureArgs<double>&, const void*, const TextureGrads<double>&, Index,
                                           Index);

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
