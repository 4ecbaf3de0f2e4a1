// Texture lookups.
#include "cpu/texture_block.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

template <int C, class Q, class T>
MIPBAKE_INLINE void interpolate(const BlockQuads<Q, T>& b, int i, int channels, T* out) {
    constexpr int local = C > 0 ? C : 1;
    const int n = C > 0 ? C : channels;
    T values[local];  // formed before one is stored: the output could alias what they are formed from
    T* const to = C > 0 ? values : out;
    const auto finer = widened<C>(b.quads[0][i]);
    if (b.block.blended && b.block.blend[i] != 0) {
        const auto coarser = widened<C>(b.quads[1][i]);
        const T blend = b.block.blend[i];
        for (int c = 0; c < n; ++c) to[c] = lerp(bilinear(finer, c), bilinear(coarser, c), blend);
    } else {
        for (int c = 0; c < n; ++c) to[c] = bilinear(finer, c);
    }
    if (C > 0)
        for (int c = 0; c < C; ++c) out[c] = values[c];
}

template <int C, class Q, class T>
MIPBAKE_KERNEL void look_up(const TextureArgs<T>& args, const void* zeros, T* out, Index begin, Index end) {
    pipeline<Q>(args, zeros, false, begin, end, [&](const BlockQuads<Q, T>& b) {
        T* texel = out + (b.block.item * args.points + b.block.point) * args.channels;
        for (int i = 0; i < b.block.count; ++i, texel += C > 0 ? C : args.channels)
            interpolate<C>(b, i, args.channels, texel);
    });
}

// Means of taps as they come: each tap moves the mean by its share of the way, so that equal taps give exactly their
// value.
template <int C, class Q, class T>
MIPBAKE_KERNEL void look_up_taps(const TextureArgs<T>& args, const void* zeros, T* out, Index begin, Index end) {
    const int n = C > 0 ? C : args.channels;
    pipeline_taps<Q>(
        args, zeros, false, begin, end,
        [&](const BlockQuads<Q, T>& b) {
            T* const first = out + (b.block.item * args.points + b.block.point) * args.channels;
            for (int i = 0; i < b.block.count; ++i) {
                T* const texel = first + Index(b.block.owner[i]) * n;
                if (b.block.ordinal[i] == 0) {
                    interpolate<C>(b, i, args.channels, texel);
                    continue;
                }
                const T share = T(1) / static_cast<T>(b.block.ordinal[i] + 1);
                const auto finer = widened<C>(b.quads[0][i]);
                const auto coarser = widened<C>(b.quads[b.block.blended && b.block.blend[i] != 0 ? 1 : 0][i]);
                for (int c = 0; c < n; ++c) {
                    const T fine = bilinear(finer, c);
                    texel[c] = lerp(texel[c], lerp(fine, bilinear(coarser, c), b.block.blend[i]), share);
                }
            }
        },
        [](const Block<T>&, const Axes<T>&) {});
}

}  // namespace

template <class T>
void texture_range(const TextureArgs<T>& args, const void* zeros, T* out, Index begin, Index end) {
    with_storage<T>(args.storage, [&](auto stored) {
        using S = decltype(stored);
        if (args.boundary_u == Boundary::cube)
            return args.channels == 3 ? look_up<3, GeneralQuad<S>>(args, zeros, out, begin, end)
                                      : look_up<0, GeneralQuad<S>>(args, zeros, out, begin, end);
        if (args.filter == Filter::anisotropic)
            return args.channels == 4 ? look_up_taps<4, PlanarQuad<S>>(args, zeros, out, begin, end)
                                      : look_up_taps<0, PlanarQuad<S>>(args, zeros, out, begin, end);
        with_channels<S>(args.channels, [&](auto c) { look_up<c.value, PlanarQuad<S>>(args, zeros, out, begin, end); });
    });
}

template void texture_range<float>(const TextureArgs<float>&, const void*, float*, Index, Index);
template void texture_range<double>(const TextureArgs<double>&, const void*, double*, Index, Index);

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
