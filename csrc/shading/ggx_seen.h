// The lobe of ggx_lobe.h for one viewer and many lights: a texel's surface, turned into the space of the lights and
// with everything worked out that no light changes. What is left per light, with s = l + v and h = s / |s|:
//
//     D V l_n = peak / 2 |s|^4 l_n / (q'^2 X),   q' = |s|^2 q = (w1.s)^2 + (w2.s)^2 + s_n^2
//     P = (1 - |s| / 2)^5,                       because l.h = |s| / 2 for unit vectors
//
// so one division and two roots. ggx_lobe.h has the two types, and says what is computed in which.
#pragma once

#include "shading/ggx_lobe.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// A directional light, the same for all texels. S is the precision of the lobe.
template <class S>
struct Light {
    Vec3<double> direction;  // unit vector from the surface
    Vec3<S> l, radiance;     // the direction in S
};

template <class Model, class W, class T, template <class> class Width>
struct GgxSeen {
    Vec3<W> n, w1, w2;  // n is 0 where nothing is seen, so that no light is above its horizon
    W v_w1, v_w2;       // v.w1, v.w2
    Vec3<T> v, diffuse, f0;
    Width<T> width;
    T n_v;       // n.v
    T v_n, g_v;  // n.v as held, and G(v)
    T half_peak;

    static MIPBAKE_FUNCTION GgxSeen of(const GgxSurface<W, T, Width>& surface, const Axes<T>& axes, const Vec3<T>& view,
                                       const TurnedAway& rule) {
        const Axes<W> wide = {widened(axes.t), widened(axes.b), widened(axes.n)};
        GgxSeen s;
        s.v = view;
        s.n = wide.combine(surface.n);
        s.w1 = wide.combine(surface.w1);
        s.w2 = wide.combine(surface.w2);
        s.width = surface.width.turned(axes);
        const Vec3<W> v = widened(view);
        s.v_w1 = dot(s.w1, v);
        s.v_w2 = dot(s.w2, v);
        const W n_v = dot(s.n, v);
        const auto seen = n_v > W(rule.least);
        s.n = {select(seen, s.n.x, W(0)), select(seen, s.n.y, W(0)), select(seen, s.n.z, W(0))};
        s.n_v = narrow<T>(n_v);
        s.v_n = narrow<T>(larger(n_v, W(rule.held)));
        s.g_v = square_root(s.v_n * s.v_n + s.width.form(view, s.v_n).value());
        s.diffuse = surface.diffuse;
        s.f0 = surface.f0;
        s.half_peak = surface.peak * T(0.5f);
        return s;
    }

    // n.l, and 0 where nothing of the light is seen.
    template <class S>
    MIPBAKE_INLINE T cosine(const Light<S>& light) const {
        return narrow<T>(dot(n, light.direction));
    }

    // Whether a light of that cosine counts.
    static MIPBAKE_INLINE auto lit(const T& cosine) { return cosine > T(kHorizon); }

    // Adds radiance f(theta, l, v). `cosine` belongs to the light.
    template <class S>
    MIPBAKE_INLINE void add(const Light<S>& light, const T& cosine, Vec3<T>& sum) const {
        const auto counts = lit(cosine);
        const T l_n = select(counts, cosine, T(1));  // so that nothing below divides by 0
        const Vec3<T> s = {v.x + light.l.x, v.y + light.l.y, v.z + light.l.z};
        const T length2 = dot(s, s);
        const T schlick = fifth_power(larger(T(1) - square_root(length2) * T(0.5f), T(0)));
        const T y1 = narrow<T>(dot(w1, light.direction) + v_w1), y2 = narrow<T>(dot(w2, light.direction) + v_w2);
        const T above = l_n + n_v;  // (l + v).n
        const T q = y1 * y1 + y2 * y2 + above * above;
        const T g_l = square_root(l_n * l_n + width.form(light.l, l_n).value());
        const T x = l_n * g_v + v_n * g_l;
        const T a = length2 / larger(q * x, T(1e-30f));
        const T lambert = select(counts, cosine, T(0));  // times the model's weight, below
        const T specular = select(above > T(0), half_peak * a * (a * x) * lambert, T(0));
        const T mirror = specular * schlick, rest = specular - mirror;
        const T matte = lambert * Model::diffuse_weight(schlick);
        sum.x = sum.x + (diffuse.x * matte + f0.x * rest + mirror) * light.radiance.x;
        sum.y = sum.y + (diffuse.y * matte + f0.y * rest + mirror) * light.radiance.y;
        sum.z = sum.z + (diffuse.z * matte + f0.z * rest + mirror) * light.radiance.z;
    }

  private:
    static MIPBAKE_INLINE Vec3<W> widened(const Vec3<T>& a) { return {widen<W>(a.x), widen<W>(a.y), widen<W>(a.z)}; }
    static MIPBAKE_INLINE T fifth_power(const T& a) { return square(square(a)) * a; }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
