// Three doubles, one for each vertex or edge of a triangle, that are computed with as one. On a CPU they are one or two
// registers, with a fourth lane that nobody reads; on a GPU three numbers.
#pragma once

#include "core/platform.h"

#if defined(__GNUC__) && !defined(__CUDACC__)
#define MIPBAKE_TRIPLE_VECTOR
#endif

namespace mipbake {
inline namespace MIPBAKE_ISA {

struct Triple {
#ifdef MIPBAKE_TRIPLE_VECTOR
    typedef double V __attribute__((vector_size(32)));
    V v;

    Triple() = default;
    explicit MIPBAKE_INLINE Triple(V values) : v(values) {}
    MIPBAKE_INLINE Triple(double all) : v(all - V{}) {}
    MIPBAKE_INLINE Triple(double x, double y, double z) : v(V{x, y, z, 0}) {}
#else
    double v[3];

    Triple() = default;
    MIPBAKE_INLINE Triple(double all) : v{all, all, all} {}
    MIPBAKE_INLINE Triple(double x, double y, double z) : v{x, y, z} {}
#endif
    MIPBAKE_INLINE double operator[](int i) const { return v[i]; }
};

// No contraction on a GPU either; see edge.h.
#ifdef MIPBAKE_TRIPLE_VECTOR
MIPBAKE_INLINE Triple operator+(const Triple& a, const Triple& b) { return Triple(a.v + b.v); }
MIPBAKE_INLINE Triple operator-(const Triple& a, const Triple& b) { return Triple(a.v - b.v); }
MIPBAKE_INLINE Triple operator*(const Triple& a, const Triple& b) { return Triple(a.v * b.v); }
MIPBAKE_INLINE Triple not_negative(const Triple& a) { return Triple(a.v > 0 ? a.v : Triple::V{}); }
MIPBAKE_INLINE Triple magnitude(const Triple& a) { return Triple(a.v < 0 ? -a.v : a.v); }
#else
#if defined(__CUDA_ARCH__)
MIPBAKE_INLINE double product_of(double a, double b) { return __dmul_rn(a, b); }
#else
MIPBAKE_INLINE double product_of(double a, double b) { return a * b; }
#endif
MIPBAKE_INLINE Triple operator+(const Triple& a, const Triple& b) {
    return {a.v[0] + b.v[0], a.v[1] + b.v[1], a.v[2] + b.v[2]};
}
MIPBAKE_INLINE Triple operator-(const Triple& a, const Triple& b) {
    return {a.v[0] - b.v[0], a.v[1] - b.v[1], a.v[2] - b.v[2]};
}
MIPBAKE_INLINE Triple operator*(const Triple& a, const Triple& b) {
    return {product_of(a.v[0], b.v[0]), product_of(a.v[1], b.v[1]), product_of(a.v[2], b.v[2])};
}
MIPBAKE_INLINE Triple not_negative(const Triple& a) {
    return {a.v[0] > 0 ? a.v[0] : 0, a.v[1] > 0 ? a.v[1] : 0, a.v[2] > 0 ? a.v[2] : 0};
}
MIPBAKE_INLINE Triple magnitude(const Triple& a) { return {::fabs(a.v[0]), ::fabs(a.v[1]), ::fabs(a.v[2])}; }
#endif
MIPBAKE_INLINE double total(const Triple& a) { return a[0] + a[1] + a[2]; }
MIPBAKE_INLINE double largest(const Triple& a) {
    const double first = a[0] > a[1] ? a[0] : a[1];
    return first > a[2] ? first : a[2];
}
// (a_1, a_2, a_0) and (a_2, a_0, a_1): of each edge i, which leads from vertex i + 1 to i + 2, the two ends.
MIPBAKE_INLINE Triple following(const Triple& a) { return {a[1], a[2], a[0]}; }
MIPBAKE_INLINE Triple preceding(const Triple& a) { return {a[2], a[0], a[1]}; }

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
