// Perspective-correct barycentrics of a pixel, their derivatives along the image, and the adjoint of both.
//
// With the edge functions E_i of edge.h (any common factor cancels) and S = E_0 + E_1 + E_2: u = E_0 / S, v = E_1 / S;
// and with A_i the derivative of E_i along an axis of the image, du/dX = (A_0 - u (A_0 + A_1 + A_2)) / S.
#pragma once

#include "raster/edge.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct Barycentrics {
    double u, v, inverse;  // inverse: 1 / S, or 0 where the triangle has no extent at the pixel
};

MIPBAKE_INLINE Barycentrics barycentrics(const Edges& e, double px, double py) {
    // Covered pixels have no negative E; rounding may.
    const double e0 = larger(e.at(0, px, py), 0.0), e1 = larger(e.at(1, px, py), 0.0),
                 e2 = larger(e.at(2, px, py), 0.0);
    const double sum = e0 + e1 + e2;
    if (!(sum > 0)) return {1.0 / 3, 1.0 / 3, 0};
    const double inverse = 1 / sum;
    return {smaller(e0 * inverse, 1.0), smaller(e1 * inverse, 1.0), inverse};
}

// (du/dX, du/dY, dv/dX, dv/dY) in pixels, of which one is 2 units of px or py.
MIPBAKE_INLINE void barycentric_derivatives(const Edges& e, const Barycentrics& b, double (&out)[4]) {
    const double f = 2 * b.inverse, ax = e.a[0] + e.a[1] + e.a[2], ay = e.b[0] + e.b[1] + e.b[2];
    out[0] = (e.a[0] - b.u * ax) * f;
    out[1] = (e.b[0] - b.u * ay) * f;
    out[2] = (e.a[1] - b.v * ax) * f;
    out[3] = (e.b[1] - b.v * ay) * f;
}

// Adds the gradient by the coefficients of the edge functions, from that by u and v (g) and by their derivatives (h).
// Eq. 2 of the paper is this and pull_back.
template <bool kDerivatives>
MIPBAKE_INLINE void barycentric_adjoint(const Edges& e, double px, double py, const Barycentrics& b, double gu,
                                        double gv, const double (&h)[4], Edges& sums) {
    const double f = b.inverse;
    double common = 0, hx = 0, hy = 0, step = 0;
    if (kDerivatives) {
        step = 2 * f;
        const double ax = e.a[0] + e.a[1] + e.a[2], ay = e.b[0] + e.b[1] + e.b[2];
        const double ux = (e.a[0] - b.u * ax) * step, uy = (e.b[0] - b.u * ay) * step;
        const double vx = (e.a[1] - b.v * ax) * step, vy = (e.b[1] - b.v * ay) * step;
        common = (h[0] * ux + h[1] * uy) + (h[2] * vx + h[3] * vy);  // by S, times -S
        gu -= step * (h[0] * ax + h[1] * ay);
        gv -= step * (h[2] * ax + h[3] * ay);
        hx = h[0] * b.u + h[2] * b.v;
        hy = h[1] * b.u + h[3] * b.v;
    }
    const double t = (gu * b.u + gv * b.v) + common;
    const double ge[3] = {f * (gu - t), f * (gv - t), -f * t};
    const double gx[3] = {step * (h[0] - hx), step * (h[2] - hx), -step * hx};
    const double gy[3] = {step * (h[1] - hy), step * (h[3] - hy), -step * hy};
    for (int i = 0; i < 3; ++i) {
        sums.a[i] += kDerivatives ? ge[i] * px + gx[i] : ge[i] * px;
        sums.b[i] += kDerivatives ? ge[i] * py + gy[i] : ge[i] * py;
        sums.c[i] += ge[i];
    }
}

// The gradient by the coefficients that make_edges gave, as one by (x, y, w) of each vertex.
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
