// Sums of vectors in place: what the adjoints of the lobes add up.
#pragma once

#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Adds a to sum.
template <class T>
MIPBAKE_INLINE void add(Vec3<T>& sum, const Vec3<T>& a) {
    sum = sum + a;
}

// Adds a u, and in the second form a u + b v; vectors of plain numbers, or of the type of the sum.
template <class T, class S>
MIPBAKE_INLINE void accumulate(Vec3<T>& sum, const T& a, const Vec3<S>& u) {
    sum.x = sum.x + a * u.x;
    sum.y = sum.y + a * u.y;
    sum.z = sum.z + a * u.z;
}
template <class T, class S>
MIPBAKE_INLINE void accumulate(Vec3<T>& sum, const T& a, const Vec3<S>& u, const T& b, const Vec3<S>& v) {
    accumulate(sum, a, u);
    accumulate(sum, b, v);
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
