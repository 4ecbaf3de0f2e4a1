// Cube maps: directions to faces, the texels around a lookup across edges and corners, and the adjoints.
//
// Faces in OpenGL's order +x -x +y -y +z -z, with its table of (sc, tc, ma) (OpenGL 4.6 core, table 8.19): s and t are
// (sc / |ma| + 1) / 2 and (tc / |ma| + 1) / 2, and row 0 is at t = 0.
#pragma once

#include "core/real.h"
#include "sampling/footprint.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct FaceAxes {
    int sc, tc, ma;                 // which component of the direction
    int sc_sign, tc_sign, ma_sign;  // and with which sign
};

MIPBAKE_INLINE FaceAxes face_axes(int face) {
    const int ma = face >> 1;
    return {ma == 0 ? 2 : 0,    ma == 1 ? 2 : 1,         ma, face == 0 || face == 5 ? -1 : 1,
            face == 2 ? 1 : -1, (face & 1) != 0 ? -1 : 1};
}

template <class T>
MIPBAKE_INLINE T component(T x, T y, T z, int axis) {
    return axis == 0 ? x : axis == 1 ? y : z;
}

// face is -1, and s and t are 1/2, where the direction is zero or not finite.
template <class T>
struct CubePoint {
    int face;
    T s, t;
};

template <class T>
MIPBAKE_INLINE T magnitude_of(T x) {
    return x < 0 ? -x : x;
}

template <class T>
MIPBAKE_INLINE CubePoint<T> cube_point(T x, T y, T z) {
    const T ax = magnitude_of(x), ay = magnitude_of(y), az = magnitude_of(z);
    const int ma = ax >= ay && ax >= az ? 0 : ay >= az ? 1 : 2;
    const T along = component(x, y, z, ma), length = component(ax, ay, az, ma);
    const int face = 2 * ma + (along < 0 ? 1 : 0);
    const FaceAxes axes = face_axes(face);
    const bool valid = x - x == 0 && y - y == 0 && z - z == 0 && length > 0;
    const T divisor = valid ? length : T(1);
    const T sc = static_cast<T>(axes.sc_sign) * component(x, y, z, axes.sc);
    const T tc = static_cast<T>(axes.tc_sign) * component(x, y, z, axes.tc);
    return {valid ? face : -1, valid ? T(0.5) + T(0.5) * (sc / divisor) : T(0.5),
            valid ? T(0.5) + T(0.5) * (tc / divisor) : T(0.5)};
}

// The six derivatives of a direction, ordered (dx/dX, dx/dY, dy/dX, dy/dY, dz/dX, dz/dY), in terms of a face's axes.
template <class T>
struct FaceDerivatives {
    T sigma, tau, length;  // sc / |ma|, tc / |ma|, |ma|
    T sc_x, sc_y, tc_x, tc_y, length_x, length_y;
};

template <class T>
MIPBAKE_INLINE FaceDerivatives<T> face_derivatives(int face, T x, T y, T z, const T (&d)[6]) {
    const FaceAxes a = face_axes(face);
    const T sc = static_cast<T>(a.sc_sign), tc = static_cast<T>(a.tc_sign), ma = static_cast<T>(a.ma_sign);
    FaceDerivatives<T> f;
    f.length = ma * component(x, y, z, a.ma);
    f.sigma = sc * component(x, y, z, a.sc) / f.length;
    f.tau = tc * component(x, y, z, a.tc) / f.length;
    f.sc_x = sc * component(d[0], d[2], d[4], a.sc);
    f.sc_y = sc * component(d[1], d[3], d[5], a.sc);
    f.tc_x = tc * component(d[0], d[2], d[4], a.tc);
    f.tc_y = tc * component(d[1], d[3], d[5], a.tc);
    f.length_x = ma * component(d[0], d[2], d[4], a.ma);
    f.length_y = ma * component(d[1], d[3], d[5], a.ma);
    return f;
}

// Texels of a face of `size` by pixels: the derivative of the projection.
template <class T>
MIPBAKE_INLINE Jacobian<T> cube_jacobian(const FaceDerivatives<T>& f, int size) {
    const T scale = static_cast<T>(size) / (2 * f.length);
    return {(f.sc_x - f.sigma * f.length_x) * scale, (f.sc_y - f.sigma * f.length_y) * scale,
            (f.tc_x - f.tau * f.length_x) * scale, (f.tc_y - f.tau * f.length_y) * scale};
}

// Gradients by the direction and by its derivatives, from the gradients by (s, t) and by the Jacobian.
template <class T>
MIPBAKE_INLINE void cube_adjoint(int face, const FaceDerivatives<T>& f, int size, T gs, T gt, const Jacobian<T>& g,
                                 T (&direction)[3], T (&derivatives)[6]) {
    const T scale = static_cast<T>(size) / (2 * f.length);
    const Jacobian<T> j = cube_jacobian(f, size);
    const T sc_x = g.sx * scale, sc_y = g.sy * scale, tc_x = g.tx * scale, tc_y = g.ty * scale;
    const T length_x = -(sc_x * f.sigma + tc_x * f.tau), length_y = -(sc_y * f.sigma + tc_y * f.tau);
    const T sigma = T(0.5) * gs - sc_x * f.length_x - sc_y * f.length_y;
    const T tau = T(0.5) * gt - tc_x * f.length_x - tc_y * f.length_y;
    const T length =
        -(g.sx * j.sx + g.sy * j.sy + g.tx * j.tx + g.ty * j.ty + sigma * f.sigma + tau * f.tau) / f.length;
    const FaceAxes a = face_axes(face);
    const T by[3] = {sigma / f.length * static_cast<T>(a.sc_sign), tau / f.length * static_cast<T>(a.tc_sign),
                     length * static_cast<T>(a.ma_sign)};
    const T by_x[3] = {sc_x * static_cast<T>(a.sc_sign), tc_x * static_cast<T>(a.tc_sign),
                       length_x * static_cast<T>(a.ma_sign)};
    const T by_y[3] = {sc_y * static_cast<T>(a.sc_sign), tc_y * static_cast<T>(a.tc_sign),
                       length_y * static_cast<T>(a.ma_sign)};
    for (int axis = 0; axis < 3; ++axis) {
        const int k = axis == a.sc ? 0 : axis == a.tc ? 1 : 2;
        direction[axis] = by[k];
        derivatives[2 * axis] = by_x[k];
        derivatives[2 * axis + 1] = by_y[k];
    }
}

struct CubeTexel {
    int face, row, column;
};

// The texel at (row, column) of a face, where at most one of the two is -1 or `size`: there it lies on the neighbouring
// face, beside the edge. In units of half a texel the face's texels are at odd or even whole numbers around its middle
// and the face itself at distance `size`; a texel beyond the edge is folded over it.
MIPBAKE_INLINE CubeTexel cube_texel(int face, int row, int column, int size) {
    if (row >= 0 && row < size && column >= 0 && column < size) return {face, row, column};
    const FaceAxes a = face_axes(face);
    int sc = 2 * column + 1 - size, tc = 2 * row + 1 - size;
    const int ma = size - 1;
    sc = sc > size ? size : sc < -size ? -size : sc;
    tc = tc > size ? size : tc < -size ? -size : tc;
    const int x = a.sc == 0 ? sc * a.sc_sign : a.tc == 0 ? tc * a.tc_sign : ma * a.ma_sign;
    const int y = a.sc == 1 ? sc * a.sc_sign : a.tc == 1 ? tc * a.tc_sign : ma * a.ma_sign;
    const int z = a.sc == 2 ? sc * a.sc_sign : a.tc == 2 ? tc * a.tc_sign : ma * a.ma_sign;
    const int axis = x == size || x == -size ? 0 : y == size || y == -size ? 1 : 2;
    const int other = 2 * axis + (component(x, y, z, axis) < 0 ? 1 : 0);
    const FaceAxes b = face_axes(other);
    return {other, (b.tc_sign * component(x, y, z, b.tc) + size - 1) / 2,
            (b.sc_sign * component(x, y, z, b.sc) + size - 1) / 2};
}

// The four texels around a lookup. `missing` is the one that a corner of the cube lacks, or -1; it stands as the texel
// of another of the four.
struct CubeQuadTexels {
    CubeTexel texels[4];
    int missing;
};

MIPBAKE_INLINE CubeQuadTexels cube_quad(int face, int row0, int row1, int column0, int column1, int size) {
    CubeQuadTexels quad;
    quad.missing = -1;
    for (int k = 0; k < 4; ++k) {
        const int row = (k & 2) != 0 ? row1 : row0, column = (k & 1) != 0 ? column1 : column0;
        const bool beyond = (row < 0 || row >= size) && (column < 0 || column >= size);
        if (beyond) quad.missing = k;
        quad.texels[k] = beyond ? CubeTexel{face, row0 < 0 ? row1 : row0, column0 < 0 ? column1 : column0}
                                : cube_texel(face, row, column, size);
    }
    return quad;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
