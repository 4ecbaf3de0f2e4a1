// `beckmann`: 12 channels. The channels of `ggx`, and g = ln(gamma), the exponent of the generalised Beckmann
// distribution (Aittala, Weyrich and Lehtinen 2015, "Two-shot SVBRDF capture for stationary materials";
// docs/conventions.md).
#pragma once

#include "shading/beckmann_lobe.h"
#include "shading/frame.h"
#include "shading/log_tensor.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

constexpr double kMaxLogGamma = 1.5;  // as MAX_LOG_GAMMA in mipbake/material/

struct Beckmann : BeckmannLobe<Beckmann> {
    static constexpr const char* name = "beckmann";
    static constexpr int channels = 12, colour_channels = 6;

    template <class S>
    static MIPBAKE_INLINE S diffuse_weight(S) {
        return S(1);
    }

    template <class R>
    static MIPBAKE_INLINE void prepare_colour(const R* c, BeckmannSurface<R, R>& s) {
        s.diffuse = {c[0] * 0.3183098861837907, c[1] * 0.3183098861837907, c[2] * 0.3183098861837907};
        s.f0 = {c[3], c[4], c[5]};
    }

    template <class R>
    static MIPBAKE_INLINE void prepare_shape(const R* c, BeckmannSurface<R, R>& s) {
        const Frame<R> frame = tangent_frame(lift_normal(c[0], c[1]));
        s.n = frame.n;
        set_log_tensor(s, frame, c + 2);
        const R g = clamp(c[5], -kMaxLogGamma, kMaxLogGamma);
        s.gamma = exponential(g);
        s.peak = s.peak * inverse_gamma_function(1.0 + exponential(-g));
    }

    // 1 / Gamma(x) for x from 1 to 6, to rounding: Gamma(x + 7) = x (x + 1) ... (x + 6) Gamma(x), and Stirling's series
    // of ln Gamma(x + 7) with Bernoulli's numbers up to B_12 (DLMF 5.11.1), whose first term left out is below 1e-14.
    // Dual numbers give its derivative, -digamma(x) / Gamma(x).
    template <class R>
    static MIPBAKE_FUNCTION R inverse_gamma_function(const R& x) {
        R product = x;
        for (int i = 1; i < 7; ++i) product = product * (x + static_cast<double>(i));
        const R y = x + 7.0, inverse = 1.0 / y, z = inverse * inverse;
        const R series =
            inverse *
            (1.0 / 12 +
             z * (-1.0 / 360 + z * (1.0 / 1260 + z * (-1.0 / 1680 + z * (1.0 / 1188 + z * (-691.0 / 360360))))));
        // (y - 1/2) ln y - y + ln(2 pi) / 2
        return product * exponential(y - (y - 0.5) * logarithm(y) - 0.9189385332046727 - series);
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
