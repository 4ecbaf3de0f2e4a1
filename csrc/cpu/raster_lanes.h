// Eight pixels of a row at a time, in double, and their depth test against a row of T and triangles.
#pragma once

#include <cstdint>
#include <cstring>

#include "core/packet.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

constexpr int kRun = 8;

#ifdef MIPBAKE_VECTORS

using Run = Packet<double, kRun>;

// One bit per lane.
MIPBAKE_INLINE unsigned bits(const Mask<double, kRun>& mask) {
    unsigned out = 0;
    for (int i = 0; i < Mask<double, kRun>::registers; ++i) {
#if defined(__AVX512DQ__)
        out |= static_cast<unsigned>(_mm512_movepi64_mask((__m512i)mask.r[i])) << (8 * i);
#elif defined(__AVX2__)
        out |= static_cast<unsigned>(_mm256_movemask_pd((__m256d)mask.r[i])) << (4 * i);
#elif defined(__SSE2__)
        out |= static_cast<unsigned>(_mm_movemask_pd((__m128d)mask.r[i])) << (2 * i);
#else
        constexpr int lanes = Register<double>::lanes;
        for (int k = 0; k < lanes; ++k) out |= (mask.r[i][k] != 0 ? 1u : 0u) << (lanes * i + k);
#endif
    }
    return out;
}

MIPBAKE_INLINE unsigned above(const Run& a, double limit) { return bits(a > Run(limit)); }
MIPBAKE_INLINE unsigned at_least(const Run& a, double limit) { return bits(a >= Run(limit)); }
MIPBAKE_INLINE Run lesser(const Run& a, const Run& b) { return select(a < b, a, b); }
MIPBAKE_INLINE Run greater(const Run& a, const Run& b) { return select(a > b, a, b); }

#else

struct Run {
    double lane[kRun];

    Run() = default;
    MIPBAKE_INLINE Run(double value) {
        for (double& l : lane) l = value;
    }
    static MIPBAKE_INLINE Run load(const double* data) {
        Run out;
        std::memcpy(out.lane, data, sizeof out.lane);
        return out;
    }
    MIPBAKE_INLINE void store(double* data) const { std::memcpy(data, lane, sizeof lane); }
};
MIPBAKE_INLINE Run operator+(Run a, const Run& b) {
    for (int i = 0; i < kRun; ++i) a.lane[i] += b.lane[i];
    return a;
}
MIPBAKE_INLINE Run operator*(Run a, const Run& b) {
    for (int i = 0; i < kRun; ++i) a.lane[i] *= b.lane[i];
    return a;
}
MIPBAKE_INLINE unsigned above(const Run& a, double limit) {
    unsigned out = 0;
    for (int i = 0; i < kRun; ++i) out |= (a.lane[i] > limit ? 1u : 0u) << i;
    return out;
}
MIPBAKE_INLINE unsigned at_least(const Run& a, double limit) {
    unsigned out = 0;
    for (int i = 0; i < kRun; ++i) out |= (a.lane[i] >= limit ? 1u : 0u) << i;
    return out;
}
MIPBAKE_INLINE Run lesser(Run a, const Run& b) {
    for (int i = 0; i < kRun; ++i) a.lane[i] = smaller(a.lane[i], b.lane[i]);
    return a;
}
MIPBAKE_INLINE Run greater(Run a, const Run& b) {
    for (int i = 0; i < kRun; ++i) a.lane[i] = larger(a.lane[i], b.lane[i]);
    return a;
}

#endif

// Where `covered` and nearer than what is there (or as near, with a lower triangle), and beyond `floor` if that is not
// null: the depth, rounded to T, and the triangle are written.
template <class T>
MIPBAKE_INLINE void depth_test(unsigned covered, const Run& depth, std::int32_t triangle, const T* floor, T* depths,
                               std::int32_t* triangles) {
#if defined(MIPBAKE_VECTORS) && defined(__AVX512VL__)
    if constexpr (sizeof(T) == sizeof(float)) {
        const __m256 z = _mm512_cvtpd_ps(depth.r[0]), old = _mm256_loadu_ps(depths);
        __mmask8 mask = static_cast<__mmask8>(covered);
        if (floor != nullptr) mask = _mm256_mask_cmp_ps_mask(mask, z, _mm256_loadu_ps(floor), _CMP_GT_OQ);
        const __m256i name = _mm256_set1_epi32(triangle);
        const __mmask8 equal = _mm256_mask_cmp_ps_mask(mask, z, old, _CMP_EQ_OQ);
        mask = _mm256_mask_cmp_ps_mask(mask, z, old, _CMP_LT_OQ);
        if (equal != 0) {
            const __m256i names = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(triangles));
            mask = static_cast<__mmask8>(mask | _mm256_mask_cmplt_epi32_mask(equal, name, names));
        }
        _mm256_mask_storeu_ps(depths, mask, z);
        _mm256_mask_storeu_epi32(triangles, mask, name);
        return;
    }
#elif defined(MIPBAKE_VECTORS) && defined(__AVX2__)
    if constexpr (sizeof(T) == sizeof(float)) {
        if (covered == 0) return;
        const __m256 z =
            _mm256_insertf128_ps(_mm256_castps128_ps256(_mm256_cvtpd_ps(depth.r[0])), _mm256_cvtpd_ps(depth.r[1]), 1);
        const __m256 old = _mm256_loadu_ps(depths);
        const __m256i lane = _mm256_setr_epi32(1, 2, 4, 8, 16, 32, 64, 128);
        const __m256i chosen = _mm256_and_si256(_mm256_set1_epi32(static_cast<int>(covered)), lane);
        __m256 mask = _mm256_castsi256_ps(_mm256_cmpeq_epi32(chosen, lane));
        if (floor != nullptr) mask = _mm256_and_ps(mask, _mm256_cmp_ps(z, _mm256_loadu_ps(floor), _CMP_GT_OQ));
        const __m256i name = _mm256_set1_epi32(triangle);
        const __m256i names = _mm256_loadu_si256(reinterpret_cast<const __m256i*>(triangles));
        const __m256 lower = _mm256_castsi256_ps(_mm256_cmpgt_epi32(names, name));
        const __m256 equal = _mm256_and_ps(_mm256_cmp_ps(z, old, _CMP_EQ_OQ), lower);
        mask = _mm256_and_ps(mask, _mm256_or_ps(_mm256_cmp_ps(z, old, _CMP_LT_OQ), equal));
        _mm256_storeu_ps(depths, _mm256_blendv_ps(old, z, mask));
        _mm256_storeu_si256(reinterpret_cast<__m256i*>(triangles),
                            _mm256_blendv_epi8(names, name, _mm256_castps_si256(mask)));
        return;
    }
#endif
    double lanes[kRun];
    depth.store(lanes);
    for (; covered != 0; covered &= covered - 1) {
        int i = 0;
#if defined(__GNUC__)
        i = __builtin_ctz(covered);
#else
        while ((covered >> i & 1) == 0) ++i;
#endif
        const T z = static_cast<T>(lanes[i]);
        if (floor != nullptr && !(z > floor[i])) continue;
        if (z < depths[i] || (z == depths[i] && triangle < triangles[i])) {
            depths[i] = z;
            triangles[i] = triangle;
        }
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
