// The texels of a MIP stack that a lookup reads. CPU and CUDA share this.
#pragma once

#include "ops/stochastic.h"
#include "sampling/footprint.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Numbers of texels, each once.
struct TexelList {
    std::int32_t* texels;
    int count, most;

    MIPBAKE_INLINE void add(std::int64_t texel) {
        const std::int32_t number = static_cast<std::int32_t>(texel);
        for (int i = 0; i < count; ++i)
            if (texels[i] == number) return;
        if (count < most) texels[count++] = number;
    }
};

template <class T>
MIPBAKE_INLINE Tap<T> tap_along(Boundary boundary, T coordinate, int size, bool nearest) {
    switch (boundary) {
        case Boundary::clamp:
            return nearest ? nearest_tap<Boundary::clamp>(coordinate, size)
                           : linear_tap<Boundary::clamp>(coordinate, size);
        case Boundary::mirror:
            return nearest ? nearest_tap<Boundary::mirror>(coordinate, size)
                           : linear_tap<Boundary::mirror>(coordinate, size);
        case Boundary::zero:
            return nearest ? nearest_tap<Boundary::zero>(coordinate, size)
                           : linear_tap<Boundary::zero>(coordinate, size);
        default:
            return nearest ? nearest_tap<Boundary::wrap>(coordinate, size)
                           : linear_tap<Boundary::wrap>(coordinate, size);
    }
}

// Texels that have no weight (a lookup at a texel's centre, or at a whole level of detail) are left out: what they hold
// does not show.
MIPBAKE_INLINE void add_level(const TouchedArgs& args, int level, float u, float v, bool nearest, TexelList& list) {
    std::int64_t base = 0;
    for (int l = 0; l < level; ++l) base += std::int64_t(args.heights[l]) * args.widths[l];
    const int width = args.widths[level];
    const Tap<float> x = tap_along(args.boundary_u, u, width, nearest);
    const Tap<float> y = tap_along(args.boundary_v, v, args.heights[level], nearest);
    if (x.fraction != x.fraction || y.fraction != y.fraction) return;  // undefined: such lookups have no gradient
    for (int i = 0; i < 2; ++i)
        for (int j = 0; j < 2; ++j) {
            const int row = i ? y.second : y.first, column = j ? x.second : x.first;
            const bool weighs = (i == 0 || y.fraction > 0) && (j == 0 || x.fraction > 0);
            if (weighs && row >= 0 && column >= 0) list.add(base + std::int64_t(row) * width + column);
        }
}

MIPBAKE_INLINE void add_lookup(const TouchedArgs& args, float u, float v, float lod, TexelList& list) {
    const LevelPair<float> pair = level_pair(lod, args.level_count - 1);
    add_level(args, pair.finer, u, v, false, list);
    if (pair.coarser != pair.finer && pair.blend > 0) add_level(args, pair.coarser, u, v, false, list);
}

MIPBAKE_INLINE void add_touched(const TouchedArgs& args, std::int64_t point, std::int32_t* texels) {
    TexelList list{texels, 0, args.most};
    const float u = args.uv[2 * point], v = args.uv[2 * point + 1];
    const bool seen = (args.seen == nullptr || args.seen[point] != 0) && u == u && v == v;
    if (seen) {
        float lod = args.lod != nullptr ? args.lod[point] : 0.0f;
        AxisTaps<float> taps{1, 0, 0, lod};
        const float width = static_cast<float>(args.widths[0]), height = static_cast<float>(args.heights[0]);
        if (args.uv_da != nullptr) {
            const float* const d = args.uv_da + 4 * point;
            const Jacobian<float> j{d[0] * width, d[1] * width, d[2] * height, d[3] * height};
            const Ellipse<float> e = ellipse_of(j);
            lod = lod_of(e);
            taps.lod = lod;
            if (args.filter == Filter::anisotropic) taps = axis_taps(j, e);
        }
        if (!(taps.lod == taps.lod)) {
            // Undefined as well.
        } else if (args.filter == Filter::nearest) {
            add_level(args, nearest_level(lod, args.level_count - 1).finer, u, v, true, list);
        } else {
            for (int k = 0; k < taps.count; ++k) {
                const float along = (static_cast<float>(k) + 0.5f) / static_cast<float>(taps.count) - 0.5f;
                add_lookup(args, u + along * taps.s / width, v + along * taps.t / height, taps.lod, list);
            }
        }
    }
    for (int i = list.count; i < args.most; ++i) texels[i] = -1;
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
