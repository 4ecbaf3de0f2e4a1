// The lobe that the models share: a Lambertian term, and an anisotropic GGX microfacet term with height-correlated
// Smith masking-shadowing (docs/conventions.md; Heitz 2014; Kemppinen et al. 2023, section 3.4):
//
//     f = (k albedo / pi + D V F) l_n,   zero where l_n <= 0
//     D = 1 / (pi sqrt(det S) q^2),      q = h_t^T S^-1 h_t + h_n^2;   zero where h_n <= 0
//     V = 1/2 / (l_n G(v) + c G(l)),     G(w) = sqrt(w_n^2 + w_t^T S w_t),   c = max(v_n, 1e-4) for v_n in G(v), too
//     F = F0 + (1 - F0) P,               P = (1 - l.h)^5
//
// k is the model's weight of the diffuse term, a function of P alone. Here w_n = w.n and w_t is w in the tangent frame.
// c is what TurnedAway in pair.h holds v_n to. The form of D is a sum of squares, so that nothing cancels: with
// S^-1 = W W^T and W = [w1 w2] taken as vectors of tangent space, h_t^T S^-1 h_t = (h.w1)^2 + (h.w2)^2. The form of G
// is the business of widths.h.
//
// Two types. Where a narrow lobe is hit, h.w1 is a small difference of large products (h is nearly normal to w1, which
// is 1/alpha long); near the horizon so are l_n and v_n, and their sum where one of them is below it. These are taken
// in W, which is double; everything else is a product or a sum of terms of one sign, and is computed in T, which may be
// float.
#pragma once

#include "core/real.h"
#include "shading/pair.h"
#include "shading/sums.h"
#include "shading/widths.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// What a texel contributes, prepared once for all light-view pairs. Width is TwoWidths or OneWidth.
template <class W, class T, template <class> class Width>
struct GgxSurface {
    Vec3<W> n, w1, w2;
    Width<T> width;
    Vec3<T> diffuse, f0;  // albedo / pi; reflectance at normal incidence
    T peak;               // 1 / (pi sqrt(det S)), D at h = n

    // Both call f(a_i, b_i) on fields of two surfaces: zip_colour on the fields that prepare_colour sets, zip_shape on
    // the fields that prepare_shape sets.
    template <class A, class B, class F>
    static MIPBAKE_INLINE void zip_colour(A& a, B& b, F f) {
        zip_vector(a.diffuse, b.diffuse, f);
        zip_vector(a.f0, b.f0, f);
    }
    template <class A, class B, class F>
    static MIPBAKE_INLINE void zip_shape(A& a, B& b, F f) {
        zip_vector(a.n, b.n, f);
        zip_vector(a.w1, b.w1, f);
        zip_vector(a.w2, b.w2, f);
        Width<T>::zip(a.width, b.width, f);
        f(a.peak, b.peak);
    }
};

// Sets the fields that describe the microfacets from principal axes: unit tangent vectors e1, e2, normal to each other,
// and alpha along each.
template <class R>
MIPBAKE_FUNCTION void set_axes(GgxSurface<R, R, TwoWidths>& s, const Vec3<R>& e1, const R& alpha1, const Vec3<R>& e2,
                               const R& alpha2) {
    s.w1 = e1 * (1.0 / alpha1);
    s.w2 = e2 * (1.0 / alpha2);
    s.width.u1 = e1 * alpha1;
    s.width.u2 = e2 * alpha2;
    s.peak = 0.3183098861837907 / (alpha1 * alpha2);
}
template <class R>
MIPBAKE_FUNCTION void set_axes(GgxSurface<R, R, OneWidth>& s, const Vec3<R>& e1, const Vec3<R>& e2, const R& alpha) {
    s.w1 = e1 * (1.0 / alpha);
    s.w2 = e2 * (1.0 / alpha);
    s.width.alpha2 = alpha * alpha;
    s.peak = 0.3183098861837907 / s.width.alpha2;
}

// The surface for one viewer and many lights; see ggx_seen.h.
template <class Model, class W, class T, template <class> class Width = TwoWidths>
struct GgxSeen;

// Evaluation and its adjoint, for models whose surface is a GgxSurface. Model::diffuse_weight(P) is k.
template <class Model, template <class> class Width = TwoWidths>
struct GgxLobe {
    static constexpr bool has_adjoint = true;
    template <class W, class T>
    using Surface = GgxSurface<W, T, Width>;
    template <class W, class T>
    using Seen = GgxSeen<Model, W, T, Width>;

    // f(theta, l, v), 3 channels.
    template <class W, class T, class S, class PW, class PT>
    static MIPBAKE_INLINE Vec3<T> evaluate(const GgxSurface<W, T, Width>& s, const Pair<S, PW, PT>& p) {
        const Terms<T, S> c = Terms<T, S>::of(s, p);
        const T cosine = select(c.lit, c.l_n, T(0)) * Model::diffuse_weight(p.schlick);
        const PT rest = 1 - p.schlick;
        return {s.diffuse.x * cosine + (s.f0.x * rest + p.schlick) * c.specular,
                s.diffuse.y * cosine + (s.f0.y * rest + p.schlick) * c.specular,
                s.diffuse.z * cosine + (s.f0.z * rest + p.schlick) * c.specular};
    }

    // Adds to `adjoint` the gradient of g . f(theta, l, v) by the fields of the surface.
    template <class W, class T, class S, class PW, class PT>
    static MIPBAKE_INLINE void evaluate_adjoint(const GgxSurface<W, T, Width>& s, const Pair<S, PW, PT>& p,
                                                const Vec3<T>& gradient, GgxSurface<T, T, Width>& adjoint) {
        const Terms<T, S> c = Terms<T, S>::of(s, p);
        const Vec3<T> g = {select(c.lit, gradient.x, T(0)), select(c.lit, gradient.y, T(0)),
                           select(c.lit, gradient.z, T(0))};
        const PT weight = Model::diffuse_weight(p.schlick), rest = 1 - p.schlick;

        // f = diffuse k l_n + (f0 (1 - P) + P) specular
        const T cosine = c.l_n * weight;
        add(adjoint.diffuse, g * cosine);
        const T reflected = c.specular * rest;
        add(adjoint.f0, g * reflected);
        const T g_specular = dot(g, s.f0) * rest + (g.x + g.y + g.z) * p.schlick;

        // specular = D V l_n = peak q^-2 / 2 l_n / X, with X = l_n G(v) + v_n G(l): each factor takes g_specular
        // specular times its power, over itself.
        const T flow = g_specular * c.specular;
        adjoint.peak = adjoint.peak + g_specular * c.unit_specular;
        const T over_q = flow * c.inverse_q, over_x = flow * c.inverse_x;
        const T inverse_g = S(1) / (c.g_l * c.g_v);
        const T y_bar = over_q * S(-4);  // by y_i: -2 flow / q times 2 y_i, without y_i
        // Minus the gradients by G(l)^2 / 2 and G(v)^2 / 2, which are quadratic in the dot products.
        const T gl_bar = over_x * c.v_n * c.g_v * inverse_g, gv_bar = over_x * c.l_n * c.g_l * inverse_g;
        const auto by_cosine = s.width.template by_cosine<S>();
        const T half_bar = y_bar * c.y3 * p.scale;  // y3 = (n.l + n.v) / |l + v|
        // By l_n: flow / l_n - flow G(v) / X = flow v_n G(l) / (l_n X), which does not cancel.
        const T l_bar = dot(g, s.diffuse) * weight + g_specular * c.per_cosine * c.v_n * c.g_l * c.inverse_x -
                        gl_bar * c.l_n * by_cosine + half_bar;
        const T v_bar = half_bar - select(c.held, T(0), over_x * c.g_l + gv_bar * c.v_n * by_cosine);
        accumulate(adjoint.n, l_bar, p.l, v_bar, p.v);
        accumulate(adjoint.w1, y_bar * c.y1, p.h);
        accumulate(adjoint.w2, y_bar * c.y2, p.h);
        s.width.add_adjoint(c.form_l, gl_bar, p.l, c.form_v, gv_bar, p.v, adjoint.width);
    }

  private:
    template <class T, class S>
    struct Terms {
        T l_n, v_n;       // n.l, 1 where nothing is lit, so that nothing below divides by 0; n.v as held
        T y1, y2, y3, q;  // h.w1, h.w2, h.n and the sum of their squares
        typename Width<T>::Form form_l, form_v;
        T g_l, g_v, x;  // G(l), G(v), X = l_n G(v) + v_n G(l)
        T inverse_q, inverse_x;
        T unit_specular, specular;  // D V l_n where peak is 1, and with the texel's; 0 where nothing is reflected
        T per_cosine;               // D V
        decltype(T(0) > T(0)) lit, held;

        template <class W, class PW, class PT>
        static MIPBAKE_INLINE Terms of(const GgxSurface<W, T, Width>& s, const Pair<S, PW, PT>& p) {
            Terms c;
            const W l_wide = dot(s.n, p.light), v_wide = dot(s.n, p.view);
            const T l_n = narrow<T>(l_wide), v_n = narrow<T>(v_wide);
            c.lit = both(l_n > T(kHorizon), v_n > T(p.least));
            c.held = T(p.held) > v_n;
            c.l_n = select(c.lit, l_n, T(1));
            c.v_n = larger(v_n, T(p.held));
            c.y1 = narrow<T>(dot(s.w1, p.sum)) * p.scale;
            c.y2 = narrow<T>(dot(s.w2, p.sum)) * p.scale;
            c.y3 = narrow<T>(l_wide + v_wide) * p.scale;
            const auto reflected = both(c.lit, c.y3 > T(0));
            c.q = c.y1 * c.y1 + c.y2 * c.y2 + c.y3 * c.y3;
            c.form_l = s.width.form(p.l, c.l_n);
            c.form_v = s.width.form(p.v, c.v_n);
            c.g_l = square_root(c.l_n * c.l_n + c.form_l.value());
            c.g_v = square_root(c.v_n * c.v_n + c.form_v.value());
            c.x = c.l_n * c.g_v + c.v_n * c.g_l;
            const T inverse = S(1) / larger(c.q * c.x, T(1e-30));
            c.inverse_q = inverse * c.x;
            c.inverse_x = inverse * c.q;
            const T unit = select(reflected, inverse * c.inverse_q * S(0.5), T(0));
            c.per_cosine = unit * s.peak;
            c.unit_specular = unit * c.l_n;
            c.specular = c.unit_specular * s.peak;
            return c;
        }
    };
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
