// `gltf`: 8 channels, the metallic-roughness model of glTF 2.0, appendix B. Base colour r, g, b; metallic; perceptual
// roughness; normal x, y, z.
#pragma once

#include "shading/frame.h"
#include "shading/ggx_lobe.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

constexpr double kDielectricF0 = 0.04;  // as DIELECTRIC_F0 and MIN_ROUGHNESS in mipbake/material/
constexpr double kMinRoughness = 0.045;
constexpr double kMaxRoughness = 100;  // no material's: only so that nothing overflows

// mix(dielectric, metal, metallic), where the dielectric is mix(base / pi, D V, F_d) with
// F_d = 0.04 + 0.96 P, and the metal D V (base + (1 - base) P). The microfacet terms add up to D V F with
// F0 = mix(0.04, base, metallic); the diffuse term is left with (1 - metallic) (1 - F_d).
template <class S>
MIPBAKE_INLINE S dielectric_transmission(S schlick) {
    return S(1 - kDielectricF0) * (1 - schlick);
}

template <class Surface, class R>
MIPBAKE_FUNCTION void set_metallic(Surface& s, const R& r, const R& g, const R& b, const R& metallic) {
    const R share = (1.0 - metallic) * 0.3183098861837907;
    s.diffuse = {r * share, g * share, b * share};
    s.f0 = {kDielectricF0 + (r - kDielectricF0) * metallic, kDielectricF0 + (g - kDielectricF0) * metallic,
            kDielectricF0 + (b - kDielectricF0) * metallic};
}

struct Gltf : GgxLobe<Gltf, OneWidth> {
    static constexpr const char* name = "gltf";
    static constexpr int channels = 8, colour_channels = 4;

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
        const Frame<R> frame = any_frame(unit_normal(Vec3<R>{c[1], c[2], c[3]}));
        s.n = frame.n;
        set_axes(s, frame.t, frame.b, alpha);
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
