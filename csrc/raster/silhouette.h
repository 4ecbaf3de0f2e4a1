// Silhouette edges and where they pass between neighbouring pixels. Laine et al. 2020, section 3.6. Everything is
// computed in double, whatever the type of the positions.
//
// Edge e of a triangle (v_0, v_1, v_2) runs from v_e to v_(e + 1) % 3, and lies opposite to v_(e + 2) % 3.
#pragma once

#include <cmath>
#include <cstdint>

#include "core/platform.h"
#include "raster/edge.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Which way round the eye sees a triangle, the sign of det(v_0, v_1, v_2) of (x, y, w), or 0 where it is seen edge-on:
// exact, as in rasterisation. It is also the side of any of its edges that the triangle lies on: for e, the sign of
// det(v_e, v_(e + 1) % 3, v_(e + 2) % 3).
template <class T>
MIPBAKE_INLINE int facing(const T* pos, const std::int32_t* v) {
    ClipVertex corners[3];
    load_triangle(pos, v, corners);
    return orientation<(sizeof(T) > sizeof(float))>(corners);
}

// Bit e is set where edge e of the triangle is a silhouette: no other triangle of the edge lies strictly on the other
// side of it. facings: of every triangle; next: (triangles, 3), for an edge 3 t + e the next of those that join the
// same two vertices, in a cycle. A triangle seen edge-on is in no pixel, and gets none.
template <class Facing>
MIPBAKE_FUNCTION int silhouette_edges(std::int64_t triangle, const std::int32_t* tri, const std::int32_t* next,
                                      const Facing& facing_of) {
    const int own = facing_of(triangle);
    if (own == 0) return 0;
    int bits = 0;
    for (int e = 0; e < 3; ++e) {
        const std::int64_t edge = 3 * triangle + e;
        bool is_silhouette = true;
        for (std::int64_t other = next[edge]; is_silhouette && other != edge; other = next[other]) {
            const int side = facing_of(other / 3);
            // Seen from an edge that runs the other way, the sides are exchanged.
            is_silhouette = (tri[other] == tri[edge] ? side : -side) != -own;
        }
        bits |= is_silhouette ? 1 << e : 0;
    }
    return bits;
}

// How the segment between the centres of two neighbouring pixels is cut.
struct Crossing {
    int edge;  // of the triangle, or -1 where none crosses
    double d;  // from the first centre, in pixels: 0 to 1
};

// The ends of an edge in pixels from the first centre and scaled with w: `along` the axis of the pair, and `across`.
struct EdgeEnds {
    double along_a, across_a, w_a, along_b, across_b, w_b;
};

// Two neighbouring pixels: the centre of the first in NDC, and the resolution along and across the pair's axis.
struct PixelPair {
    bool horizontal;
    double along, across;
    double pixels_along, pixels_across;
};

MIPBAKE_INLINE PixelPair pixel_pair(bool horizontal, int row, int column, int height, int width) {
    const double x = (2.0 * column + 1) / width - 1, y = (2.0 * row + 1) / height - 1;
    if (horizontal) return {true, x, y, double(width), double(height)};
    return {false, y, x, double(height), double(width)};
}

template <class T>
MIPBAKE_INLINE EdgeEnds edge_ends(const PixelPair& pair, const T* a, const T* b) {
    const int along = pair.horizontal ? 0 : 1, across = 1 - along;
    const double w_a = a[3], w_b = b[3];
    const double half_along = 0.5 * pair.pixels_along, half_across = 0.5 * pair.pixels_across;
    return {plus(a[along], -times(pair.along, w_a)) * half_along,
            plus(a[across], -times(pair.across, w_a)) * half_across,
            w_a,
            plus(b[along], -times(pair.along, w_b)) * half_along,
            plus(b[across], -times(pair.across, w_b)) * half_across,
            w_b};
}

// The first edge of those in `bits` that leans across the axis of the pair rather than along it and passes between the
// centres. corners: the positions of the triangle's vertices.
template <class T>
MIPBAKE_FUNCTION Crossing find_crossing(const PixelPair& pair, const T* const* corners, int bits) {
    for (int e = 0; e < 3; ++e) {
        if ((bits >> e & 1) == 0) continue;
        const T *const a = corners[e], *const b = corners[e == 2 ? 0 : e + 1];
        // The line through the ends is n . (x, y, 1) = 0, so that its direction in pixels is (-n_y W, n_x H).
        const double n_x = double(a[1]) * double(b[3]) - double(a[3]) * double(b[1]);
        const double n_y = double(a[3]) * double(b[0]) - double(a[0]) * double(b[3]);
        const double width = pair.horizontal ? pair.pixels_along : pair.pixels_across;
        const double height = pair.horizontal ? pair.pixels_across : pair.pixels_along;
        if ((fabs(n_x) * height >= fabs(n_y) * width) != pair.horizontal) continue;
        const EdgeEnds ends = edge_ends(pair, a, b);
        if ((ends.across_a < 0) == (ends.across_b < 0)) continue;
        // The edge meets the axis at (across_b a - across_a b) / (across_b - across_a).
        const double w = ends.across_b * ends.w_a - ends.across_a * ends.w_b;
        if (!((ends.across_b > ends.across_a ? w : -w) > 0)) continue;
        const double d = (ends.across_b * ends.along_a - ends.across_a * ends.along_b) / w;
        if (d >= 0 && d <= 1) return {e, d};
    }
    return {-1, 0.0};
}

// The gradients of the (x, y, w) of the two ends, where the gradient of d is `grad`.
struct EndGradients {
    double a[3], b[3];
};
template <class T>
MIPBAKE_FUNCTION EndGradients crossing_gradient(const PixelPair& pair, const T* a, const T* b, double d, double grad) {
    const EdgeEnds ends = edge_ends(pair, a, b);
    const double scale = grad / (ends.across_b * ends.w_a - ends.across_a * ends.w_b);
    const double along_a = scale * ends.across_b, along_b = -scale * ends.across_a;
    const double across_a = scale * (d * ends.w_b - ends.along_b), across_b = scale * (ends.along_a - d * ends.w_a);
    const double half_along = 0.5 * pair.pixels_along, half_across = 0.5 * pair.pixels_across;
    const int along = pair.horizontal ? 0 : 1, across = 1 - along;
    EndGradients out;
    out.a[along] = half_along * along_a;
    out.b[along] = half_along * along_b;
    out.a[across] = half_across * across_a;
    out.b[across] = half_across * across_b;
    out.a[2] = -d * along_a - pair.along * out.a[along] - pair.across * out.a[across];
    out.b[2] = -d * along_b - pair.along * out.b[along] - pair.across * out.b[across];
    return out;
}

// The slab between the centres belongs half to each pixel. A crossing beyond its middle, d > 1/2, brings colour of the
// first pixel into the second, a crossing before it brings colour of the second into the first: (d - 1/2) or (1/2 - d)
// of the difference. In both cases the result grows with d by (first - second).
MIPBAKE_INLINE bool blends_into_second(double d) { return d > 0.5; }
MIPBAKE_INLINE double blend_weight(double d) { return fabs(d - 0.5); }

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
