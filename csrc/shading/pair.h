// A light-view pair, and what of it does not depend on the texel.
#pragma once

#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class S>
struct Pair {
    Vec3<double> light, view;  // unit vectors in tangent space
    Vec3<double> half;         // normalize(light + view); (0, 0, 0) where light = -view
    double half_scale;         // 1 / |light + view|; 1 where light = -view
    Vec3<S> l, v, h;           // the same in the precision of the lobe
    S scale;                   // half_scale
    S schlick;                 // (1 - l.h)^5

    static MIPBAKE_FUNCTION Pair of(const Vec3<double>& light, const Vec3<double>& view) {
        Pair p;
        p.light = light;
        p.view = view;
        const Vec3<double> sum = light + view;
        const double length2 = dot(sum, sum);
        p.half_scale = length2 > 1e-30 ? 1 / square_root(length2) : 1;
        p.half = length2 > 1e-30 ? sum * p.half_scale : Vec3<double>{0, 0, 0};
        const double grazing = larger(1 - dot(light, p.half), 0.0);
        p.schlick = static_cast<S>(square(square(grazing)) * grazing);
        p.scale = static_cast<S>(p.half_scale);
        p.l = cast(p.light);
        p.v = cast(p.view);
        p.h = cast(p.half);
        return p;
    }

  private:
    static MIPBAKE_INLINE Vec3<S> cast(const Vec3<double>& a) {
        return {static_cast<S>(a.x), static_cast<S>(a.y), static_cast<S>(a.z)};
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
