// The pixels that a triangle may cover, from its vertices divided by w. Only ever too many: edge functions decide.
#pragma once

#include <cstdint>

#include "core/real.h"

namespace mipbake {

// Both ends are included; x1 < x0 where there are none.
struct PixelBox {
    std::uint16_t x0, x1, y0, y1;
};

inline namespace MIPBAKE_ISA {

// x of the clip space's [-1, 1] in pixels, whose centres are integers. Rounding is far below kMargin.
constexpr double kMargin = 1.0 / 32;

template <class T>
MIPBAKE_INLINE int first_pixel(T low, int size) {  // the first centre at or after low - kMargin
    const T held = smaller(larger(low, T(-1)), T(size + 1));
    return size + 1 - static_cast<int>(T(size + 1) - held + T(kMargin));
}
template <class T>
MIPBAKE_INLINE int last_pixel(T high, int size) {  // the last centre at or before high + kMargin
    const T held = smaller(larger(high, T(-1)), T(size));
    return static_cast<int>(held + T(1 + kMargin)) - 1;
}

// The pixels that a triangle may cover, and the least z/w over it.
template <class T>
MIPBAKE_INLINE PixelBox box_of(const T* a, const T* b, const T* c, int width, int height, float& nearest) {
    // Outside of one plane of the frustum with all three vertices: x > w is 1, x < -w 2, y 4 and 8, z 16 and 32.
    const auto outside = [](const T* p) {
        const T w = p[3];
        return (p[0] > w ? 1 : 0) | (p[0] < -w ? 2 : 0) | (p[1] > w ? 4 : 0) | (p[1] < -w ? 8 : 0) |
               (p[2] > w ? 16 : 0) | (p[2] < -w ? 32 : 0);
    };
    if ((outside(a) & outside(b) & outside(c)) != 0) return PixelBox{1, 0, 1, 0};
    nearest = -1;
    const PixelBox everything{0, static_cast<std::uint16_t>(width - 1), 0, static_cast<std::uint16_t>(height - 1)};
    if (!(a[3] > 0 && b[3] > 0 && c[3] > 0))
        return a[3] <= 0 && b[3] <= 0 && c[3] <= 0 ? PixelBox{1, 0, 1, 0} : everything;
    const T ia = 1 / a[3], ib = 1 / b[3], ic = 1 / c[3];
    // Where w is so small that it has no inverse, 0 times infinity is not a number: the box is everything then.
    const T xa = a[0] * ia, xb = b[0] * ib, xc = c[0] * ic, ya = a[1] * ia, yb = b[1] * ib, yc = c[1] * ic;
    const T za = a[2] * ia, zb = b[2] * ib, zc = c[2] * ic;
    const T all = (xa + xb + xc) * 0 + (ya + yb + yc) * 0 + (za + zb + zc) * 0;
    if (!(all == 0)) return everything;
    const T fx = T(width) / 2, fy = T(height) / 2, ox = fx - T(0.5), oy = fy - T(0.5);
    const int x0 = first_pixel(smaller(xa, smaller(xb, xc)) * fx + ox, width);
    const int x1 = last_pixel(larger(xa, larger(xb, xc)) * fx + ox, width);
    const int y0 = first_pixel(smaller(ya, smaller(yb, yc)) * fy + oy, height);
    const int y1 = last_pixel(larger(ya, larger(yb, yc)) * fy + oy, height);
    const int left = larger(x0, 0), right = smaller(x1, width - 1), low = larger(y0, 0), high = smaller(y1, height - 1);
    if (right < left || high < low) return PixelBox{1, 0, 1, 0};
    const float z = static_cast<float>(smaller(za, smaller(zb, zc)));
    nearest = larger(z - (z < 0 ? -z : z) * 5e-7f - 1e-30f, -1.0f);  // below any depth that rounding may give
    return {static_cast<std::uint16_t>(left), static_cast<std::uint16_t>(right), static_cast<std::uint16_t>(low),
            static_cast<std::uint16_t>(high)};
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
