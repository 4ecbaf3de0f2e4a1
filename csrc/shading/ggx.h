// `ggx`: 11 channels. Diffuse albedo r, g, b; specular F0 r, g, b; normal x, y; log-roughness tensor a, b, c.
#pragma once

#include "shading/frame.h"
#include "shading/ggx_lobe.h"
#include "shading/log_tensor.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct Ggx : GgxLobe<Ggx> {
    static constexpr const char* name = "ggx";
    static constexpr int channels = 11, colour_channels = 6;

    template <class S>
    static MIPBAKE_INLINE S diffuse_weight(S) {
        return S(1);
    }

    template <class R>
    static MIPBAKE_INLINE void prepare_colour(const R* c, Surface<R, R>& s) {
        s.diffuse = {c[0] * 0.3183098861837907, c[1] * 0.3183098861837907, c[2] * 0.3183098861837907};
        s.f0 = {c[3], c[4], c[5]};
    }

    template <class R>
    static MIPBAKE_INLINE void prepare_shape(const R* c, Surface<R, R>& s) {
        const Frame<R> frame = tangent_frame(lift_normal(c[0], c[1]));
        s.n = frame.n;
        set_log_tensor(s, frame, c + 2);
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
