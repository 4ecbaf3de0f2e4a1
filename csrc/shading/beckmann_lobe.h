// A Lambertian term, and an anisotropic microfacet term with the generalised Beckmann distribution
// (docs/conventions.md; Aittala et al. 2015):
//
//     f = (k albedo / pi + D V F) l_n,   zero where l_n <= 0
//     D = exp(-q^gamma) / (pi Gamma(1 + 1/gamma) sqrt(det S) h_n^4),   q = h_t^T S^-1 h_t / h_n^2
//     V = 1/2 / (l_n G(v) + c G(l)),     G of beckmann_masking.h
//
// D is zero where h_n <= 0. The rest is as in ggx_lobe.h, with its surface, to which gamma is added, and its two types.
// Here q takes the wide type: its power is the argument of an exponential, so that a digit lost in q is many lost in D.
// V is for gamma = 1 whatever gamma is, which is an approximation.
//
// The slope of q^gamma at q = 0 has no bound for gamma < 1; below kLeastQ the power is replaced by its chord from 0.
#pragma once

#include "core/real.h"
#include "shading/beckmann_masking.h"
#include "shading/ggx_lobe.h"
#include "shading/sums.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

constexpr double kLeastQ = 1e-20;

// h_n is held to this: where it is smaller, D is 0 for every alpha up to 1, and its powers leave the range of float.
constexpr double kLeastHeight = 1e-6;

template <class W, class T>
struct BeckmannSurface : GgxSurface<W, T, TwoWidths> {  // peak is D at h = n
    W gamma;

    template <class A, class B, class F>
    static MIPBAKE_INLINE void zip_shape(A& a, B& b, F f) {
        GgxSurface<W, T, TwoWidths>::zip_shape(a, b, f);
        f(a.gamma, b.gamma);
    }
};

// exp(-q^gamma), and what of it its derivatives need.
template <class W, class T>
struct Stretched {
    W held;      // q, no less than kLeastQ
    W log_held;  // ln of that
    W power;     // held^gamma
    W exponent;  // q^gamma
    T value;     // exp(-exponent); 0 where that is beyond the range of T

    static MIPBAKE_INLINE Stretched of(const W& q, const W& gamma) {
        constexpr double reach = sizeof(typename PlainOf<T>::type) == 8 ? 700 : 87;
        Stretched s;
        s.held = larger(q, W(kLeastQ));
        s.log_held = logarithm_for<T>(s.held);
        s.power = exponential_for<T>(smaller(gamma * s.log_held, W(6.6)));  // e^6.6 is beyond 700
        s.exponent = s.power * smaller(q * (1 / kLeastQ), W(1));
        const T value = narrow_exponential<T>(-smaller(s.exponent, W(reach)));
        s.value = select(narrow<T>(s.exponent) < T(reach), value, T(0));
        return s;
    }
};

// The surface for one viewer and many lights; see beckmann_seen.h.
template <class Model, class W, class T>
struct BeckmannSeen;

// Evaluation and its adjoint, for models whose surface is a BeckmannSurface. Model::diffuse_weight(P) is k.
template <class Model>
struct BeckmannLobe {
    static constexpr bool has_adjoint = true;
    template <class W, class T>
    using Surface = BeckmannSurface<W, T>;
    template <class W, class T>
    using Seen = BeckmannSeen<Model, W, T>;

    // f(theta, l, v), 3 channels.
    template <class W, class T, class S, class PW, class PT>
    static MIPBAKE_INLINE Vec3<T> evaluate(const BeckmannSurface<W, T>& s, const Pair<S, PW, PT>& p) {
        const Terms<W, T, S> c = Terms<W, T, S>::of(s, p);
        const T specular = c.unit_specular * s.peak;
        const T cosine = select(c.lit, c.l_n, T(0)) * Model::diffuse_weight(p.schlick);
        const PT rest = 1 - p.schlick;
        return {s.diffuse.x * cosine + (s.f0.x * rest + p.schlick) * specular,
                s.diffuse.y * cosine + (s.f0.y * rest + p.schlick) * specular,
                s.diffuse.z * cosine + (s.f0.z * rest + p.schlick) * specular};
    }

    // Adds to `adjoint` the gradient of g . f(theta, l, v) by the fields of the surface.
    template <class W, class T, class S, class PW, class PT>
    static MIPBAKE_INLINE void evaluate_adjoint(const BeckmannSurface<W, T>& s, const Pair<S, PW, PT>& p,
                                                const Vec3<T>& gradient, BeckmannSurface<T, T>& adjoint) {
        const Terms<W, T, S> c = Terms<W, T, S>::of(s, p);
        const Vec3<T> g = {select(c.lit, gradient.x, T(0)), select(c.lit, gradient.y, T(0)),
                           select(c.lit, gradient.z, T(0))};
        const PT weight = Model::diffuse_weight(p.schlick), rest = 1 - p.schlick;

        // f = diffuse k l_n + (f0 (1 - P) + P) specular
        add(adjoint.diffuse, g * (c.l_n * weight));
        const T specular = c.unit_specular * s.peak;
        add(adjoint.f0, g * (specular * rest));
        const T g_specular = dot(g, s.f0) * rest + (g.x + g.y + g.z) * p.schlick;

        // specular = peak exp(-q^gamma) h_n^-4 / 2 l_n / X, with X = l_n G(v) + v_n G(l) and q = (y1^2 + y2^2) / h_n^2:
        // each factor takes g_specular specular times its logarithm's derivative.
        const T flow = g_specular * specular;
        adjoint.peak = adjoint.peak + g_specular * c.unit_specular;
        const T exponent = narrow<T>(c.lobe.exponent);
        adjoint.gamma = adjoint.gamma - flow * exponent * narrow<T>(c.lobe.log_held);
        const auto on_chord = narrow_mask<T>(W(kLeastQ) > c.q);
        const T flow_power = flow * select(on_chord, T(1), narrow<T>(s.gamma));
        const T by_q = flow_power * narrow<T>(c.lobe.power) / narrow<T>(c.lobe.held);  // minus that by q
        const T y_bar = by_q * S(-2) * c.inverse_height * c.inverse_height;            // by y_i, without y_i
        const T height_bar = (flow_power * exponent * S(2) - flow * S(4)) * c.inverse_height * p.scale;

        const T over_x = flow * c.inverse_x;
        // Minus the gradients by s^2 / 2 of light and view, which are quadratic in the dot products.
        const T l_slope = c.of_light.slope / c.of_light.s, v_slope = c.of_view.slope / c.of_view.s;
        const T gl_bar = over_x * c.v_n * l_slope, gv_bar = over_x * c.l_n * v_slope;
        // By l_n: flow / l_n - flow (G(v) + v_n erf) / X = flow v_n s E / (l_n X), which does not cancel.
        const T l_bar = dot(g, s.diffuse) * weight + height_bar +
                        g_specular * c.per_cosine * s.peak * c.v_n * c.of_light.s * c.of_light.slope * c.inverse_x;
        const T v_bar = height_bar - select(c.held, T(0), over_x * (c.of_light.g + c.l_n * (1 - c.of_view.erfc)));
        accumulate(adjoint.n, l_bar, p.l, v_bar, p.v);
        accumulate(adjoint.w1, y_bar * c.y1, p.h);
        accumulate(adjoint.w2, y_bar * c.y2, p.h);
        s.width.add_adjoint(c.form_l, gl_bar, p.l, c.form_v, gv_bar, p.v, adjoint.width);
    }

  private:
    template <class W, class T, class S>
    struct Terms {
        T l_n, v_n;  // n.l, 1 where nothing is lit, so that nothing below divides by 0; n.v as held
        W q;
        Stretched<W, T> lobe;      // exp(-q^gamma)
        T y1, y2, inverse_height;  // h.w1, h.w2, 1 / h.n
        typename TwoWidths<T>::Form form_l, form_v;
        BeckmannMasking<T> of_light, of_view;
        T inverse_x;      // 1 / (l_n G(v) + v_n G(l))
        T per_cosine;     // D V where peak is 1; 0 where nothing is reflected
        T unit_specular;  // D V l_n where peak is 1
        decltype(T(0) > T(0)) lit, held;

        template <class PW, class PT>
        static MIPBAKE_INLINE Terms of(const BeckmannSurface<W, T>& s, const Pair<S, PW, PT>& p) {
            Terms c;
            const W l_wide = dot(s.n, p.light), v_wide = dot(s.n, p.view);
            const T l_n = narrow<T>(l_wide), v_n = narrow<T>(v_wide);
            c.lit = both(l_n > T(kHorizon), v_n > T(p.least));
            c.held = T(p.held) > v_n;
            c.l_n = select(c.lit, l_n, T(1));
            c.v_n = larger(v_n, T(p.held));
            const T h_n = narrow<T>(l_wide + v_wide) * p.scale;
            const W y1 = dot(s.w1, p.sum), y2 = dot(s.w2, p.sum);
            const W inverse_sum = 1.0 / larger(l_wide + v_wide, W(kHorizon));
            c.q = (y1 * y1 + y2 * y2) * (inverse_sum * inverse_sum);
            c.lobe = Stretched<W, T>::of(c.q, s.gamma);
            c.y1 = narrow<T>(y1) * p.scale;
            c.y2 = narrow<T>(y2) * p.scale;
            c.form_l = s.width.form(p.l, c.l_n);
            c.form_v = s.width.form(p.v, c.v_n);
            c.of_light = BeckmannMasking<T>::of(c.l_n, c.form_l.value());
            c.of_view = BeckmannMasking<T>::of(c.v_n, c.form_v.value());
            const T height = larger(h_n, T(kLeastHeight));
            const T x = larger(c.l_n * c.of_view.g + c.v_n * c.of_light.g, T(1e-30f));
            const T inverse = S(1) / (height * x);
            c.inverse_height = inverse * x;
            c.inverse_x = inverse * height;
            const T fourth = square(square(c.inverse_height));
            c.per_cosine = select(both(c.lit, h_n > T(0)), c.lobe.value * fourth * c.inverse_x * S(0.5), T(0));
            c.unit_specular = c.per_cosine * c.l_n;
            return c;
        }
    };
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
