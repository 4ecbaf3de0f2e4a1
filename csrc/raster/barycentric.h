// Perspective-correct barycentrics of a pixel, their derivatives along the image, and the adjoint of both.
//
// With the edge functions E_i of edge.h (any common factor cancels) and S = E_0 + E_1 + E_2: u = E_0 / S, v = E_1 / S;
// and with A_i the derivative of E_i along an axis of the image, du/dX = (A_0 - u (A_0 + A_1 + A_2)) / S.
#pragma once

#include "raster/edge.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct Barycentrics {
    Triple of;       // u, v, 1 - u - v
    double inverse;  // 1 / S, or 0 where the triangle has no extent at the pixel
};

MIPBAKE_INLINE Barycentrics barycentrics(const Edges& edges, double px, double py) {
    const Triple e = not_negative(edges.at(px, py));  // covered pixels have no negative E; rounding may
    const double sum = total(e);
    if (!(sum > 0)) return {Triple(1.0 / 3), 0};
    const double inverse = 1 / sum;
    return {e * Triple(inverse), inverse};
}
MIPBAKE_INLINE double held_to_one(double value) { return value < 1 ? value : 1; }

// The derivatives of the three barycentrics along X and Y in pixels; a pixel is 2 units of px or py.
MIPBAKE_INLINE Triple along(const Triple& slopes, const Barycentrics& b) {
    return (slopes - b.of * Triple(total(slopes))) * Triple(2 * b.inverse);
}
// (du/dX, du/dY, dv/dX, dv/dY)
MIPBAKE_INLINE void barycentric_derivatives(const Edges& e, const Barycentrics& b, double (&out)[4]) {
    const Triple x = along(e.a, b), y = along(e.b, b);
    out[0] = x[0];
    out[1] = y[0];
    out[2] = x[1];
    out[3] = y[1];
}

// Adds the gradient by the coefficients of the edge functions, from the gradient by u and v (g) and by their
// derivatives (h). Eq. 2 of the paper is this and pull_back.
template <bool kDerivatives>
MIPBAKE_INLINE void barycentric_adjoint(const Edges& e, double px, double py, const Barycentrics& b, double gu,
                                        double gv, const double (&h)[4], Edges& sums) {
    Triple g(gu, gv, 0);
    if (kDerivatives) {
        const double step = 2 * b.inverse, ax = total(e.a), ay = total(e.b);
        const Triple hx(h[0], h[2], 0), hy(h[1], h[3], 0);
        const Triple x = (e.a - b.of * Triple(ax)) * Triple(step), y = (e.b - b.of * Triple(ay)) * Triple(step);
        g = g - (hx * Triple(ax) + hy * Triple(ay)) * Triple(step);
        // The gradient by S: both 1 / S and the sums of slopes are functions of S.
        const double common = total(g * b.of + (hx * x + hy * y));
        const Triple ge = (g - Triple(common)) * Triple(b.inverse);
        const Triple gx = (hx - Triple(total(hx * b.of))) * Triple(step);
        const Triple gy = (hy - Triple(total(hy * b.of))) * Triple(step);
        sums.a = sums.a + (ge * Triple(px) + gx);
        sums.b = sums.b + (ge * Triple(py) + gy);
        sums.c = sums.c + ge;
    } else {
        const Triple ge = (g - Triple(total(g * b.of))) * Triple(b.inverse);
        sums.a = sums.a + ge * Triple(px);
        sums.b = sums.b + ge * Triple(py);
        sums.c = sums.c + ge;
    }
}

// Turns the gradient by the coefficients that edges_of gave into a gradient by (x, y, w) of each vertex.
MIPBAKE_INLINE void pull_back(const ClipVertex (&v)[3], const Edges& sums, double turn, double width, double height,
                              Vec3<double> (&out)[3]) {
    for (int i = 0; i < 3; ++i) out[i] = {0, 0, 0};
    for (int i = 0; i < 3; ++i) {
        const int p = (i + 1) % 3, q = (i + 2) % 3;
        const Vec3<double> g{sums.a[i] * (height * turn), sums.b[i] * (width * turn),
                             sums.c[i] * (width * height * turn)};
        // n = V_p x V_q:  g_p += V_q x g,  g_q += g x V_p.
        out[p].x += v[q].y * g.z - v[q].w * g.y;
        out[p].y += v[q].w * g.x - v[q].x * g.z;
        out[p].z += v[q].x * g.y - v[q].y * g.x;
        out[q].x += g.y * v[p].w - g.z * v[p].y;
        out[q].y += g.z * v[p].x - g.x * v[p].w;
        out[q].z += g.x * v[p].y - g.y * v[p].x;
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
