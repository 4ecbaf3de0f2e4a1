// Homogeneous edge functions: 2D rasterisation without clipping (Olano and Greer, "Triangle Scan Conversion using 2D
// Homogeneous Coordinates", 1997), with decisions that never depend on rounding.
//
// With V_i = (x_i, y_i, w_i) in clip space, n_0 = V_1 x V_2, n_1 = V_2 x V_0, n_2 = V_0 x V_1 and det = V_0 . n_0, a
// pixel centre p = (x, y, 1) is b_0 V_0 + b_1 V_1 + b_2 V_2 with b_i = n_i . p / det. The triangle covers it where no
// b_i is negative; what is behind the eye has a negative one. So no vertex is ever divided by its w.
//
// A pixel centre is the rational point (px / W, py / H) with the integers px = 2 column + 1 - W and py = 2 row + 1 - H.
// Multiplied by W H, an edge function is a px + b py + c with a = H n_x, b = W n_y, c = W H n_w. It is computed in
// double; where that is too close to zero to be sure, its sign is computed exactly. A centre exactly on an edge counts
// as displaced by (e, e^2), e infinitely small: a displaced centre is on no edge of any triangle, so triangles that
// share edges or a vertex cover it exactly once.
//
// Code that includes this must be compiled without contraction to fused multiply-adds (-ffp-contract=off): the function
// of an edge is then exactly the negative of the function of the reversed edge.
#pragma once

#include <cstdint>

#include "core/real.h"
#include "raster/triple.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Rounded operations that a GPU's compiler does not fuse either.
#if defined(__CUDA_ARCH__)
MIPBAKE_INLINE double times(double a, double b) { return __dmul_rn(a, b); }
MIPBAKE_INLINE double plus(double a, double b) { return __dadd_rn(a, b); }
#else
MIPBAKE_INLINE double times(double a, double b) { return a * b; }
MIPBAKE_INLINE double plus(double a, double b) { return a + b; }
#endif

struct ClipVertex {
    double x, y, z, w;
};

template <class T>
MIPBAKE_INLINE ClipVertex clip_vertex(const T* pos, std::int64_t vertex) {
    const T* const p = pos + 4 * vertex;
    return {static_cast<double>(p[0]), static_cast<double>(p[1]), static_cast<double>(p[2]), static_cast<double>(p[3])};
}

template <class T, class Index>
MIPBAKE_INLINE void load_triangle(const T* pos, const Index* corners, ClipVertex (&v)[3]) {
    for (int i = 0; i < 3; ++i) v[i] = clip_vertex(pos, corners[i]);
}

// A sum of products that is never rounded: components of ascending magnitude that do not overlap (Shewchuk, "Adaptive
// Precision Floating-Point Arithmetic", 1997).
class ExactSum {
  public:
    MIPBAKE_FUNCTION void add(double value) {
        int kept = 0;
        for (int i = 0; i < size_; ++i) {
            const double sum = plus(value, parts_[i]), part = plus(sum, -value);
            const double rest = plus(plus(value, -plus(sum, -part)), plus(parts_[i], -part));
            if (rest != 0) parts_[kept++] = rest;
            value = sum;
        }
        if (value != 0) parts_[kept++] = value;
        size_ = kept;
    }
    MIPBAKE_FUNCTION void add_product(double a, double b) {
        const double high = times(a, b), low = ::fma(a, b, -high);
        if (low != 0) add(low);
        add(high);
    }
    MIPBAKE_FUNCTION void add_product(double a, double b, double c) {
        const double high = times(a, b), low = ::fma(a, b, -high);
        if (low != 0) add_product(low, c);
        add_product(high, c);
    }
    MIPBAKE_FUNCTION int sign() const { return size_ == 0 ? 0 : parts_[size_ - 1] > 0 ? 1 : -1; }

  private:
    double parts_[32];  // six triple products of doubles are 24 components
    int size_ = 0;
};

// The sign of f . (V_a x V_b).
MIPBAKE_FUNCTION int exact_sign(double fx, double fy, double fw, const ClipVertex& a, const ClipVertex& b) {
    ExactSum sum;
    sum.add_product(a.y, b.w, fx);
    sum.add_product(-a.w, b.y, fx);
    sum.add_product(a.w, b.x, fy);
    sum.add_product(-a.x, b.w, fy);
    sum.add_product(a.x, b.y, fw);
    sum.add_product(-a.y, b.x, fw);
    return sum.sign();
}

// The coordinates of the three vertices.
struct VertexTriples {
    Triple x, y, z, w;
};
MIPBAKE_INLINE VertexTriples triples_of(const ClipVertex (&v)[3]) {
    return {Triple(v[0].x, v[1].x, v[2].x), Triple(v[0].y, v[1].y, v[2].y), Triple(v[0].z, v[1].z, v[2].z),
            Triple(v[0].w, v[1].w, v[2].w)};
}

// n_i = V_(i + 1) x V_(i + 2). Where positions were float, products are exact and each coefficient is rounded once;
// either way it is exactly the negative with the ends exchanged.
struct Normals {
    Triple x, y, w;
};
MIPBAKE_INLINE Normals normals_of(const VertexTriples& v) {
    const Triple px = following(v.x), py = following(v.y), pw = following(v.w);
    const Triple qx = preceding(v.x), qy = preceding(v.y), qw = preceding(v.w);
    return {py * qw - pw * qy, pw * qx - px * qw, px * qy - py * qx};
}
// The same with sums of magnitudes: what rounding errors of products of doubles are in proportion to.
MIPBAKE_INLINE Normals sizes_of(const VertexTriples& v) {
    const Triple px = magnitude(following(v.x)), py = magnitude(following(v.y)), pw = magnitude(following(v.w));
    const Triple qx = magnitude(preceding(v.x)), qy = magnitude(preceding(v.y)), qw = magnitude(preceding(v.w));
    return {py * qw + pw * qy, pw * qx + px * qw, px * qy + py * qx};
}

// The edge functions of a triangle on the grid of pixel centres, turned so that they are positive inside.
struct Edges {
    Triple a, b, c;

    MIPBAKE_INLINE double at(int edge, double px, double py) const {
        return plus(times(a[edge], px), plus(times(b[edge], py), c[edge]));
    }
    MIPBAKE_INLINE Triple at(double px, double py) const { return a * Triple(px) + (b * Triple(py) + c); }
};

// `turn` is 1 or -1.
MIPBAKE_INLINE Edges edges_of(const Normals& n, double turn, double width, double height) {
    return {n.x * Triple(height * turn), n.y * Triple(width * turn), n.w * Triple(width * height * turn)};
}

// A bound of the error of every edge function at every centre: seven roundings of 2^-53 at most, |px| < W and |py| < H.
// kWide: whether the products of two coordinates are rounded, because they were double.
template <bool kWide>
MIPBAKE_INLINE double error_bound(const VertexTriples& v, const Normals& n, double width, double height) {
    const Normals s = kWide ? sizes_of(v) : n;
    return largest(magnitude(s.x) + magnitude(s.y) + magnitude(s.w)) * (width * height * 1e-15);
}

// Whether edge function `edge` is computed without any rounding at every centre, as it is for vertices on a grid.
MIPBAKE_FUNCTION bool computed_exactly(const ClipVertex& p, const ClipVertex& q, double a, double b, double c,
                                       double width, double height) {
    const double size = (::fabs(a) * width + ::fabs(b) * height) + ::fabs(c);
    if (!(size > 0) || !(size < 1e300)) return false;
    // All three are multiples of a unit, and `size` is less than 2^52 units.
    int exponent;
    static_cast<void>(::frexp(size, &exponent));
    const double unit = ::ldexp(1.0, exponent - 51);
    const auto multiple = [&](double value) { return ::floor(value / unit) == value / unit; };
    if (!multiple(a) || !multiple(b) || !multiple(c)) return false;
    const auto rounded = [](double r, double s, double t, double u, double scale, double result) {
        ExactSum sum;
        sum.add_product(r, s, scale);
        sum.add_product(-t, u, scale);
        sum.add(-result);
        return sum.sign() != 0;
    };
    return !rounded(p.y, q.w, p.w, q.y, height, a) && !rounded(p.w, q.x, p.x, q.w, width, b) &&
           !rounded(p.x, q.y, p.y, q.x, width * height, c);
}

// Whether the displaced centre (px, py) is inside edge i, which leads from v[(i + 1) % 3] to v[(i + 2) % 3]: exact.
MIPBAKE_FUNCTION bool inside_exactly(const ClipVertex (&v)[3], int i, double turn, double px, double py, double width,
                                     double height) {
    const ClipVertex& p = v[(i + 1) % 3];
    const ClipVertex& q = v[(i + 2) % 3];
    int sign = exact_sign(height * px, width * py, width * height, p, q);
    if (sign == 0) sign = exact_sign(1, 0, 0, p, q);
    if (sign == 0) sign = exact_sign(0, 1, 0, p, q);
    return sign * turn > 0;
}

// 1 or -1, the sign of det, or 0 where the triangle has no area, is seen edge-on or passes through the eye.
template <bool kWide>
MIPBAKE_INLINE int orientation(const ClipVertex (&v)[3], const VertexTriples& corners, const Normals& n) {
    const double x = times(v[0].x, n.x[0]), y = times(v[0].y, n.y[0]), w = times(v[0].w, n.w[0]);
    const double det = plus(plus(x, y), w);
    double size = ::fabs(x) + ::fabs(y) + ::fabs(w);
    if (kWide) {
        const Normals s = sizes_of(corners);
        size = ::fabs(v[0].x) * s.x[0] + ::fabs(v[0].y) * s.y[0] + ::fabs(v[0].w) * s.w[0];
    }
    if (::fabs(det) > 1e-15 * size) return det > 0 ? 1 : -1;
    return exact_sign(v[0].x, v[0].y, v[0].w, v[1], v[2]);
}
template <bool kWide>
MIPBAKE_INLINE int orientation(const ClipVertex (&v)[3]) {
    const VertexTriples corners = triples_of(v);
    return orientation<kWide>(v, corners, normals_of(corners));
}

// The edge functions and their turn, for barycentrics. Zeros where the triangle covers nothing.
template <bool kWide>
MIPBAKE_INLINE Edges make_edges(const ClipVertex (&v)[3], double width, double height, double& turn) {
    const VertexTriples corners = triples_of(v);
    const Normals n = normals_of(corners);
    turn = orientation<kWide>(v, corners, n);
    return edges_of(n, turn, width, height);
}

// z/w as a function of the pixel: za px + zb py + zc, held to [low, high], the range over the triangle. (z/w at p is
// sum z_i b_i, because sum w_i b_i is 1.)
struct DepthPlane {
    double a, b, c, low, high;
    double nearest, farthest;  // limits of what is drawn: -1 and 1, infinite where no vertex is beyond the plane
    bool clips;                // whether they are to be tested at all
};

MIPBAKE_INLINE double depth_before_clamp(const DepthPlane& plane, double px, double py) {
    return plus(times(plane.a, px), plus(times(plane.b, py), plane.c));
}

// Everything that rasterising a triangle takes.
struct Triangle {
    ClipVertex v[3];
    Edges edges;
    DepthPlane depth;
    double turn, bound;
};

// False where the triangle covers nothing.
template <bool kWide>
MIPBAKE_INLINE bool prepare(Triangle& t, double width, double height) {
    const VertexTriples corners = triples_of(t.v);
    const Normals n = normals_of(corners);
    t.turn = orientation<kWide>(t.v, corners, n);
    if (t.turn == 0) return false;
    t.edges = edges_of(n, t.turn, width, height);
    t.bound = error_bound<kWide>(corners, n, width, height);
    const Edges& e = t.edges;
    // W H |det|, from the edge functions as they are, so that sum w_i b_i is 1 to rounding.
    const double det = total(corners.w * e.c);
    const double z0 = t.v[0].z, z1 = t.v[1].z, z2 = t.v[2].z;
    DepthPlane& d = t.depth;
    d.low = -1;
    d.high = 1;
    const double w0 = t.v[0].w, w1 = t.v[1].w, w2 = t.v[2].w;
    if (w0 > 0 && w1 > 0 && w2 > 0) {
        const double q0 = z0 / w0, q1 = z1 / w1, q2 = z2 / w2;
        d.low = larger(d.low, smaller(q0, smaller(q1, q2)));
        d.high = smaller(d.high, larger(q0, larger(q1, q2)));
    }
    if (det > 0) {
        const double inverse = 1 / det;
        d.a = times(total(corners.z * e.a), inverse);
        d.b = times(total(corners.z * e.b), inverse);
        d.c = times(total(corners.z * e.c), inverse);
    } else {  // too thin for its plane to be known
        d.a = d.b = 0;
        d.c = 0.5 * (d.low + d.high);
    }
    // Vertices on a plane, as a sky's vertices on the far plane, are never clipped by it, whatever the rounding.
    const bool cuts_near = !(-z0 <= w0 && -z1 <= w1 && -z2 <= w2), cuts_far = !(z0 <= w0 && z1 <= w1 && z2 <= w2);
    d.nearest = cuts_near ? -1.0 : -HUGE_VAL;
    d.farthest = cuts_far ? 1.0 : HUGE_VAL;
    d.clips = cuts_near || cuts_far;
    return true;
}

// Whether the triangle covers a pixel, and if so its z/w.
MIPBAKE_INLINE bool covers(const Triangle& t, double px, double py, double width, double height) {
    for (int i = 0; i < 3; ++i) {
        const double e = t.edges.at(i, px, py);
        if (e > t.bound) continue;
        if (e < -t.bound || !inside_exactly(t.v, i, t.turn, px, py, width, height)) return false;
    }
    return true;
}
MIPBAKE_INLINE bool depth_at(const Triangle& t, double px, double py, double& depth) {
    const double z = depth_before_clamp(t.depth, px, py);
    if (t.depth.clips && !(z >= t.depth.nearest && z <= t.depth.farthest)) return false;
    depth = larger(smaller(z, t.depth.high), t.depth.low);
    return true;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
