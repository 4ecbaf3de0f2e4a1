// Where a lookup lands: coordinates to texels along one axis, level of detail to two levels.
#pragma once

#include <cmath>

#include "core/platform.h"
#include "ops/texture.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

#if defined(__SSE2__) && !defined(__SSE4_1__)
// Before SSE4.1 there is no instruction for it, and a call to the C library would keep loops from vectorising.
MIPBAKE_INLINE float floor_of(float x) {
    const bool is_small = x < 0x1p23f && x > -0x1p23f;  // beyond, every float is whole
    const float whole = static_cast<float>(static_cast<int>(is_small ? x : 0.0f));
    return is_small ? whole - (whole > x ? 1.0f : 0.0f) : x;
}
#else
MIPBAKE_INLINE float floor_of(float x) { return ::floorf(x); }
#endif
MIPBAKE_INLINE double floor_of(double x) { return ::floor(x); }

template <class T>
struct Rounding;
template <>
struct Rounding<float> {
    static constexpr float epsilon = 0x1p-23f;
};
template <>
struct Rounding<double> {
    static constexpr double epsilon = 0x1p-52;
};

// Two texels of one axis and the fraction of the way from the first to the second, in [0, 1). NaN coordinates give a
// NaN fraction and indices that are safe to read.
template <class T>
struct Tap {
    int first, second;
    T fraction;
};

// The texels on both sides of a coordinate along one axis, -1 where there is none (boundary zero); for the face of a
// cube -1 and `size` stand for the first texels beyond its edges.
//
// Texel centres are at (i + 1/2) / size. A coordinate within its own rounding error of a centre is at the centre, so
// that lookups at centres return texels exactly for any size, and the slope there is always the one to the right.
// Beyond the first and last centre of a clamped axis both texels are the edge's, which makes the slope zero.
template <Boundary boundary, class T>
MIPBAKE_INLINE Tap<T> linear_tap(T coordinate, int size) {
    const T extent = static_cast<T>(size);
    const T magnitude = coordinate < 0 ? -coordinate : coordinate;
    // At most half a step of a GPU's 8-bit subtexel grid, however far out the coordinate.
    T error = (magnitude > 1 ? magnitude : T(1)) * extent * Rounding<T>::epsilon;
    error = error > T(0x1p-9) ? T(0x1p-9) : error;
    T position;
    bool below = false;
    if (boundary == Boundary::wrap) {
        position = (coordinate - floor_of(coordinate)) * extent - T(0.5);
    } else if (boundary == Boundary::mirror) {
        position = (coordinate - 2 * floor_of(coordinate * T(0.5))) * extent - T(0.5);
    } else if (boundary == Boundary::clamp) {
        position = coordinate * extent - T(0.5);
        below = position < -error;
        position = position < 0 ? T(0) : position;
        position = position > extent - 1 ? extent - 1 : position;
    } else if (boundary == Boundary::zero) {
        position = coordinate * extent - T(0.5);
        below = position < -1 - error;
        position = position < -1 ? T(-1) : position;
        position = position > extent ? extent : position;
    } else {
        position = coordinate * extent - T(0.5);
    }
    // The position is at least -1, so that truncation rounds down. Only the comparison of NaN with itself fails.
    const int nearest = static_cast<int>(position == position ? position + T(1.5) : T(1)) - 1;
    T offset = position - static_cast<T>(nearest);
    offset = (offset <= error && -offset <= error) ? T(0) : offset;
    const bool before = offset < 0;
    const int index = nearest - (before ? 1 : 0);
    Tap<T> tap;
    tap.first = index;
    tap.second = index + 1;
    tap.fraction = before ? offset + 1 : offset;
    if (boundary == Boundary::wrap) {
        tap.first = tap.first < 0 ? tap.first + size : tap.first;
        tap.first = tap.first >= size ? tap.first - size : tap.first;  // rounded up, where float32 has no halves left
        tap.second = tap.second >= size ? tap.second - size : tap.second;
    } else if (boundary == Boundary::mirror) {
        // From -1 to 2 size; both ends are the first texel.
        tap.first = tap.first >= size ? 2 * size - 1 - tap.first : tap.first;
        tap.first = tap.first < 0 ? 0 : tap.first;
        tap.second = tap.second >= size ? 2 * size - 1 - tap.second : tap.second;
        tap.second = tap.second < 0 ? 0 : tap.second;
    } else if (boundary == Boundary::clamp) {
        tap.second = tap.second >= size ? size - 1 : tap.second;
        tap.second = below ? tap.first : tap.second;
    } else if (boundary == Boundary::zero) {
        tap.second = (tap.second >= size || below) ? -1 : tap.second;
        tap.first = tap.first >= size ? -1 : tap.first;
    }
    return tap;
}

// The texel that holds a coordinate, twice: lerps then give it, and slopes are zero. NaN stays the fraction.
template <Boundary boundary, class T>
MIPBAKE_INLINE Tap<T> nearest_tap(T coordinate, int size) {
    const T extent = static_cast<T>(size);
    T position;
    if (boundary == Boundary::wrap)
        position = (coordinate - floor_of(coordinate)) * extent;
    else if (boundary == Boundary::mirror)
        position = (coordinate - 2 * floor_of(coordinate * T(0.5))) * extent;
    else
        position = coordinate * extent;
    Tap<T> tap;
    tap.fraction = position == position ? T(0) : position;
    position = position >= 0 ? position : T(boundary == Boundary::zero && position < 0 ? -1 : 0);
    const T limit = boundary == Boundary::mirror ? 2 * extent : extent;
    position = position < limit ? position : limit;
    int index = static_cast<int>(position);
    if (boundary == Boundary::mirror) index = index >= size ? 2 * size - 1 - index : index;
    if (boundary == Boundary::mirror) index = index < 0 ? 0 : index;
    if (boundary == Boundary::zero)
        index = index >= size ? -1 : index;
    else
        index = index >= size ? size - 1 : index;  // also where rounding carried the product to the size
    tap.first = tap.second = index;
    return tap;
}

// The levels on both sides of a level of detail, and the way from the finer to the coarser in [0, 1). Where lod is
// clamped both are the same level, which makes the slope zero; NaN gives a NaN blend of levels that exist.
template <class T>
struct LevelPair {
    int finer, coarser;
    T blend;
};

template <class T>
MIPBAKE_INLINE LevelPair<T> level_pair(T lod, int last) {
    const bool below = lod < 0;
    T clamped = below ? T(0) : lod;
    clamped = clamped > static_cast<T>(last) ? static_cast<T>(last) : clamped;
    LevelPair<T> pair;
    pair.finer = static_cast<int>(clamped == clamped ? clamped : T(0));
    pair.coarser = pair.finer + (!below & (pair.finer < last) ? 1 : 0);
    pair.blend = clamped - static_cast<T>(pair.finer);
    return pair;
}

// The one level nearest to a level of detail, halves rounded up.
template <class T>
MIPBAKE_INLINE LevelPair<T> nearest_level(T lod, int last) {
    T rounded = lod + T(0.5);
    rounded = rounded > 0 ? rounded : T(0);
    rounded = rounded < static_cast<T>(last) ? rounded : static_cast<T>(last);
    const int level = static_cast<int>(rounded);
    return {level, level, lod == lod ? T(0) : lod};
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
