// `gltf-anisotropic`: 11 channels. The channels of `gltf`; then, as in KHR_materials_anisotropy, the direction x, y and
// the strength.
#pragma once

#include "shading/gltf.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct GltfAnisotropic : GgxLobe<GltfAnisotropic> {
    static constexpr const char* name = "gltf-anisotropic";
    static constexpr int channels = 11, colour_channels = 4;

    template <class S>
    static MIPBAKE_INLINE S diffuse_weight(S schlick) {
        return dielectric_transmission(schlick);
    }

    template <class R>
    static MIPBAKE_INLINE void prepare_colour(const R* c, Surface<R, R>& s) {
        set_metallic(s, c[0], c[1], c[2], c[3]);
    }

    template <class R>
    static MIPBAKE_INLINE void prepare_shape(const R* c, Surface<R, R>& s) {
        const R alpha = square(clamp(c[0], kMinRoughness, kMaxRoughness));
        const R along = alpha + (1.0 - alpha) * square(clamp(c[6], -1, 1));
        const Frame<R> frame = tangent_frame(unit_normal(Vec3<R>{c[1], c[2], c[3]}));
        s.n = frame.n;

        // The direction, normalised; +x, with no gradient, where it is shorter than 1e-6.
        const R length2 = c[4] * c[4] + c[5] * c[5];
        const auto usable = length2 > 1e-12;
        const R inverse = 1.0 / square_root(larger(length2, R(1e-12)));
        const R x = select(usable, c[4] * inverse, R(1)), y = select(usable, c[5] * inverse, R(0));
        set_axes(s, frame.t * x + frame.b * y, along, frame.b * x - frame.t * y, alpha);
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
