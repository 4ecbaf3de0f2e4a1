// Bilinear lookups in two steps: where they read, and what they make of what was read there. An image of which only
// some texels are known is looked up so, with the bits of a lookup in all of it.
#include "cpu/texture_block.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

template <int C>
MIPBAKE_KERNEL void mix(const TexelQuads& quads, Index begin, Index end, float* out) {
    const int n = C > 0 ? C : quads.channels;
    for (Index i = begin; i < end; ++i) {
        PlanarQuad<float> quad;
        for (int k = 0; k < 4; ++k) quad.texels[k] = quads.values + quads.texels[4 * i + k] * n;
        quad.x = quads.fractions[2 * i];
        quad.y = quads.fractions[2 * i + 1];
        for (int c = 0; c < n; ++c) out[i * n + c] = bilinear(quad, c);
    }
}

}  // namespace

void texture_taps_range(const TextureArgs<float>& args, Index begin, Index end, Index* texels, float* fractions) {
    Block<float> b;
    const Index width = args.widths[0];
    for_each_run(begin, end, args.points, [&](Index item, Index point, int count) {
        read_lookups(args, item, point, count, b);
        locate(args, false, b);
        for (int i = 0; i < count; ++i, ++point) {
            Index* const four = texels + 4 * point;
            four[0] = b.y0[0][i] * width + b.x0[0][i];
            four[1] = b.y0[0][i] * width + b.x1[0][i];
            four[2] = b.y1[0][i] * width + b.x0[0][i];
            four[3] = b.y1[0][i] * width + b.x1[0][i];
            fractions[2 * point] = b.x[0][i];
            fractions[2 * point + 1] = b.y[0][i];
        }
    });
}

void texture_quads_range(const TexelQuads& quads, Index begin, Index end, float* out) {
    with_channels<float>(quads.channels, [&](auto c) { mix<c.value>(quads, begin, end, out); });
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
