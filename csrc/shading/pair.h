// A light-view pair, and what of it does not depend on the material.
#pragma once

#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Cosines up to this count as not positive: products of smaller ones leave the range of float.
constexpr double kHorizon = 1e-9;

// What is shaded where the normal turns away from the viewer (docs/conventions.md).
struct TurnedAway {
    double least;  // the n.v up to which nothing is seen
    double held;   // what n.v is held to in masking

    // As engines do; or black, as pbrt does.
    static MIPBAKE_INLINE constexpr TurnedAway rule(bool black) {
        return black ? TurnedAway{kHorizon, kHorizon} : TurnedAway{-2, 1e-4};
    }
};

// One pair for all texels (plain numbers), or one for each texel of a packet. T has the precision of the lobe, and W is
// double; S is the plain number of the precision of T.
template <class S, class W = double, class T = S>
struct Pair {
    Vec3<W> light, view;  // unit vectors in tangent space
    Vec3<W> sum;          // light + view
    Vec3<T> l, v, h;      // light and view in the precision of the lobe; normalize(light + view)
    T scale;              // 1 / |light + view|; 1 where light = -view
    T schlick;            // (1 - l.h)^5
    S least, held;        // of TurnedAway

    static MIPBAKE_INLINE Pair of(const Vec3<T>& l, const Vec3<T>& v, const TurnedAway& rule) {
        Pair p;
        p.least = static_cast<S>(rule.least);
        p.held = static_cast<S>(rule.held);
        p.light = {widen<W>(l.x), widen<W>(l.y), widen<W>(l.z)};
        p.view = {widen<W>(v.x), widen<W>(v.y), widen<W>(v.z)};
        p.sum = p.light + p.view;
        p.l = l;
        p.v = v;
        const Vec3<T> sum = l + v;
        const T length2 = dot(sum, sum);
        const auto usable = length2 > T(1e-30f);
        p.scale = select(usable, T(1) / square_root(larger(length2, T(1e-30f))), T(1));
        p.h = sum * p.scale;
        const T grazing = larger(T(1) - dot(l, p.h), T(0));
        p.schlick = square(square(grazing)) * grazing;
        return p;
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
