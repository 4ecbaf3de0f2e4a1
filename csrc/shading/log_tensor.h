// The microfacets of `ggx` and `beckmann` from the three channels of their log-roughness tensor.
#pragma once

#include "shading/frame.h"
#include "shading/ggx_lobe.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Sets the fields that describe the microfacets from a, b, c.
template <class R>
MIPBAKE_FUNCTION void set_log_tensor(GgxSurface<R, R, TwoWidths>& s, const Frame<R>& frame, const R* abc) {
    // S = exp([[a, c], [c, b]]) (Kemppinen et al. 2023, equation 6). With m = (a + b) / 2, d = (a - b) / 2 and
    // r = sqrt(d^2 + c^2): S = e^m [[A, C], [C, B]], A = cosh r + d sinh(r) / r, C = c sinh(r) / r, A B - C^2 = 1.
    // m is held to [-30, 10] and r to 20, at the same direction of (d, c), far beyond any material, so that nothing
    // overflows.
    const R m = clamp((abc[0] + abc[1]) * 0.5, -30, 10);
    const R d = (abc[0] - abc[1]) * 0.5, k = abc[2];
    const R r2 = d * d + k * k;
    const auto small = r2 < 0.01;
    const R r = square_root(larger(r2, R(0.01)));
    const R decay = exponential(-smaller(r, R(20)));
    const R sinhc_large = 0.5 * (1.0 / decay - decay) / r;

    // For small r the series, which have no root.
    const R cosh_series = 1.0 + r2 * (0.5 + r2 * (1.0 / 24 + r2 * (1.0 / 720 + r2 * (1.0 / 40320))));
    const R sinhc_series = 1.0 + r2 * (1.0 / 6 + r2 * (1.0 / 120 + r2 * (1.0 / 5040 + r2 * (1.0 / 362880))));
    const R sinhc = select(small, sinhc_series, sinhc_large);

    // Else A = e^-r + (r + d) sinh(r) / r, and for d < 0 r + d is taken as c^2 / (r - d), so that nothing cancels
    // when one axis is much narrower than the other.
    const auto wide = d > 0.0;
    const R excess = select(wide, r + d, k * k / select(wide, R(1), r - d));
    const R A = select(small, cosh_series + sinhc * d, decay + sinhc * excess);
    const R shear = sinhc * k / A;  // C / A

    // L = sqrt(e^m) [[sqrt A, 0], [C / sqrt A, 1 / sqrt A]], Cholesky's factor: unlike principal axes it is smooth
    // at isotropy. Its determinant is e^m.
    const R scale = exponential(m);
    const R inverse_scale = 1.0 / scale;
    const R l11 = square_root(scale * A);
    const R inverse_l11 = 1.0 / l11;
    s.width.u1 = (frame.t + frame.b * shear) * l11;
    s.width.u2 = frame.b * (scale * inverse_l11);
    s.w1 = frame.t * inverse_l11;
    s.w2 = (frame.b - frame.t * shear) * (l11 * inverse_scale);
    s.peak = inverse_scale * 0.3183098861837907;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
