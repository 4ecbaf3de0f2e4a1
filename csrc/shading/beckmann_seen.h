// The lobe of beckmann_lobe.h for one viewer and many lights, as ggx_seen.h has it for the lobe of ggx_lobe.h: with
// s = l + v and h = s / |s|,
//
//     D V l_n = peak / 2 exp(-q^gamma) |s|^4 / s_n^4 l_n / X,   q = ((w1.s)^2 + (w2.s)^2) / s_n^2
#pragma once

#include "shading/beckmann_lobe.h"
#include "shading/ggx_seen.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class Model, class W, class T>
struct BeckmannSeen : GgxSeen<Model, W, T> {  // but that g_v is G(v) of beckmann_masking.h
    W gamma, v_wide;                          // n_v in W

    static MIPBAKE_FUNCTION BeckmannSeen of(const BeckmannSurface<W, T>& surface, const Axes<T>& axes,
                                            const Vec3<T>& view, const TurnedAway& rule) {
        BeckmannSeen s;
        static_cast<GgxSeen<Model, W, T>&>(s) = GgxSeen<Model, W, T>::of(surface, axes, view, rule);
        s.g_v = BeckmannMasking<T>::of(s.v_n, s.width.form(view, s.v_n).value()).g;
        s.gamma = surface.gamma;
        s.v_wide = dot(s.n, Vec3<W>{widen<W>(view.x), widen<W>(view.y), widen<W>(view.z)});
        return s;
    }

    // Adds radiance f(theta, l, v). `cosine` belongs to the light.
    template <class S>
    MIPBAKE_INLINE void add(const Light<S>& light, const T& cosine, Vec3<T>& sum) const {
        const auto counts = this->lit(cosine);
        const T l_n = select(counts, cosine, T(1));  // so that nothing below divides by 0
        const Vec3<T> s = {this->v.x + light.l.x, this->v.y + light.l.y, this->v.z + light.l.z};
        const T length2 = dot(s, s), length = square_root(length2);
        const T grazing = larger(T(1) - length * T(0.5f), T(0));
        const T schlick = square(square(grazing)) * grazing;
        const W y1 = dot(this->w1, light.direction) + this->v_w1, y2 = dot(this->w2, light.direction) + this->v_w2;
        const W inverse_sum = 1.0 / larger(dot(this->n, light.direction) + v_wide, W(kHorizon));
        const W q = (y1 * y1 + y2 * y2) * (inverse_sum * inverse_sum);
        const T lobe = Stretched<W, T>::of(q, gamma).value;
        const T g_l = BeckmannMasking<T>::of(l_n, this->width.form(light.l, l_n).value()).g;
        const T x = larger(l_n * this->g_v + this->v_n * g_l, T(1e-30f));
        const T above = l_n + this->n_v;  // (l + v).n
        const T height = larger(above, length * T(kLeastHeight));
        const T inverse = T(1) / larger(height * x, T(1e-30f));
        const T fourth = square(square(length * inverse * x));
        const T lambert = select(counts, cosine, T(0));  // times the model's weight, below
        const T reflected = select(above > T(0), lambert, T(0));
        const T specular = this->half_peak * lobe * fourth * (inverse * height * reflected);
        const T mirror = specular * schlick, rest = specular - mirror;
        const T matte = lambert * Model::diffuse_weight(schlick);
        sum.x = sum.x + (this->diffuse.x * matte + this->f0.x * rest + mirror) * light.radiance.x;
        sum.y = sum.y + (this->diffuse.y * matte + this->f0.y * rest + mirror) * light.radiance.y;
        sum.z = sum.z + (this->diffuse.z * matte + this->f0.z * rest + mirror) * light.radiance.z;
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
