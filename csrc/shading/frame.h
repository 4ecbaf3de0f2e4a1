// Shading normals and the frames around them (docs/conventions.md).
#pragma once

#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class R>
struct Frame {
    Vec3<R> t, b, n;
};

// n = (x, y, sqrt(1 - x^2 - y^2)); outside the unit disc (x, y) is first scaled back onto it. The slope of the root is
// unbounded at the rim, so over its last 1e-8 the root is replaced by the chord from there to 0.
template <class R>
MIPBAKE_FUNCTION Vec3<R> lift_normal(const R& x, const R& y) {
    const R r2 = x * x + y * y;
    const R shrink = select(r2 > 1.0, 1.0 / square_root(larger(r2, R(1))), R(1));
    const R nx = x * shrink, ny = y * shrink;
    const R z2 = select(r2 < 1.0, 1.0 - r2, R(0));
    return {nx, ny, select(z2 > 1e-8, square_root(larger(z2, R(1e-8))), z2 * 1e4)};
}

// v / |v|; (0, 0, 1), with no gradient, where v is shorter than 1e-6.
template <class R>
MIPBAKE_FUNCTION Vec3<R> unit_normal(const Vec3<R>& v) {
    const R length2 = dot(v, v);
    const auto usable = length2 > 1e-12;
    const R inverse = 1.0 / square_root(larger(length2, R(1e-12)));
    return {select(usable, v.x * inverse, R(0)), select(usable, v.y * inverse, R(0)),
            select(usable, v.z * inverse, R(1))};
}

// The tangent frame t = normalize(x - (x.n) n), b = n x t; t = (0, 0, -sign(n.x)) where n is +x or -x.
// With p = n.y^2 + n.z^2, b = (0, n.z, -n.y) / sqrt(p) and t = b x n.
template <class R>
MIPBAKE_FUNCTION Frame<R> tangent_frame(const Vec3<R>& n) {
    const R p = n.y * n.y + n.z * n.z;
    const auto usable = p > 1e-16;
    const R inverse = 1.0 / square_root(larger(p, R(1e-16)));
    const R by = select(usable, n.z * inverse, R(0));
    const R bz = select(usable, -n.y * inverse, R(0));
    const R side = select(n.x > 0.0, R(-1), R(1));
    Frame<R> frame;
    frame.n = n;
    frame.t = {by * n.z - bz * n.y, bz * n.x, select(usable, -by * n.x, side)};
    frame.b = {R(0), select(usable, by, -side * n.x), bz};
    return frame;
}

// Some frame around n, for lobes that have no direction: smooth but for a jump at n.z = 0 (Duff et al. 2017, "Building
// an orthonormal basis, revisited").
template <class R>
MIPBAKE_FUNCTION Frame<R> any_frame(const Vec3<R>& n) {
    const R sign = select(n.z >= 0.0, R(1), R(-1));
    const R a = -1.0 / (sign + n.z);
    const R c = n.x * n.y * a;
    Frame<R> frame;
    frame.n = n;
    frame.t = {1.0 + sign * n.x * n.x * a, sign * c, -sign * n.x};
    frame.b = {c, sign + n.y * n.y * a, -n.y};
    return frame;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
