// Lookups in blocks: what a block holds, and the pipeline that prepares one while the one before it waits for its
// texels. Included by kernels alone.
#pragma once

#include "sampling/cube.h"
#include "sampling/quads.h"

// After the headers above, which make this instruction set's namespace an inline one.
#include "cpu/texture.h"

#if defined(__F16C__)
#include <immintrin.h>
#endif
#if defined(_MSC_VER)
#include <xmmintrin.h>
#define MIPBAKE_PREFETCH(p) _mm_prefetch(reinterpret_cast<const char*>(p), _MM_HINT_T0)
#else
#define MIPBAKE_PREFETCH(p) __builtin_prefetch(p)
#endif

// GCC 12.2 with -O3 and AVX2 takes some of these kernels for functions without effect, and leaves their calls out,
// unless it is kept from looking into them (or -fno-ipa-modref is given). tests/test_every_door.py would tell.
#if defined(__GNUC__) && !defined(__clang__)
#define MIPBAKE_KERNEL __attribute__((noipa))
#else
#define MIPBAKE_KERNEL
#endif

namespace mipbake {
inline namespace MIPBAKE_ISA {

using Index = std::int64_t;

constexpr int block_size = 32;

// Up to block_size lookups. Index 0 of [2] is the finer level, 1 the coarser.
//
// Anisotropic filtering makes several lookups of one: a block then holds taps, each with its owner among the lookups of
// a run, the share of the owner's mean, and its place along the owner's axis.
template <class T>
struct Block {
    int count;
    Index item, point;  // of the first lookup; the others follow it
    bool blended;       // whether any lookup needs its coarser level
    T u[block_size], v[block_size], lod[block_size], blend[block_size];
    int level[2][block_size], height[2][block_size], width[2][block_size];
    int x0[2][block_size], x1[2][block_size], y0[2][block_size], y1[2][block_size];
    T x[2][block_size], y[2][block_size];
    // What was read: derivatives, bias, direction; then the face of a direction.
    T da[6][block_size], bias[block_size], direction[3][block_size];
    int face[block_size];
    // The lookup that each tap belongs to, its number there, its weight and its place.
    int owner[block_size], ordinal[block_size];
    T weight[block_size], place[block_size];
};

// The axes of a run of lookups, in units of the texture.
template <class T>
struct Axes {
    int taps[block_size];
    T u[block_size], v[block_size];
};

// Gradients of a run of lookups by the coordinates in the texture or face, the level of detail and the axis.
template <class T>
struct Slopes {
    T u[block_size], v[block_size], lod[block_size], axis_u[block_size], axis_v[block_size];
};

// Reads lookups [point, point + count) of an item into a block, and computes their coordinates and levels of detail.
template <class T>
void read_lookups(const TextureArgs<T>& args, Index item, Index point, int count, Block<T>& block);
// The same for lookups that are listed: number `first + (list[i] >> shift)`, counted on from batch item to batch item.
template <class T>
void read_listed(const TextureArgs<T>& args, Index first, const std::uint32_t* list, int shift, int count,
                 Block<T>& block);
// The axes and levels of detail of lookups that were read.
template <class T>
void find_axes(const TextureArgs<T>& args, Block<T>& block, Axes<T>& axes);
// The levels and texels of lookups; `always_both` asks for the coarser level also where its share is 0.
template <class T>
void locate(const TextureArgs<T>& args, bool always_both, Block<T>& block);
// The same for a plane, without the columns.
template <class T>
void locate_rows(const TextureArgs<T>& args, Block<T>& block);
// The same for taps, all in one level, with `blend` the share of that level.
template <class T>
void locate_in_level(const TextureArgs<T>& args, int level, Block<T>& block);
// Writes the gradients of a block's lookups. `axes` is null except for anisotropic filtering.
template <class T>
void write_slopes(const TextureArgs<T>& args, const TextureGrads<T>& grads, const Block<T>& block, const Axes<T>* axes,
                  const Slopes<T>& slopes);

// NaN in any of them makes the whole lookup NaN: it then adds to no gradient. Nor does a lookup without a direction.
template <class T>
bool is_void(const TextureArgs<T>& args, const Block<T>& block, int i) {
    const T sum = block.x[0][i] + block.y[0][i] + block.blend[i];  // each is in [0, 1] or NaN
    return sum != sum || (args.boundary_u == Boundary::cube && block.face[i] < 0);
}

inline bool is_mipmapped(Filter filter) { return filter != Filter::nearest && filter != Filter::linear; }

// Whether one level of detail serves all lookups.
template <class T>
bool is_uniform(const TextureArgs<T>& args) {
    return !is_mipmapped(args.filter) ||
           (args.uv_da == nullptr &&
            (args.bias == nullptr || (args.bias_point_stride == 0 && args.bias_batch_stride == 0)));
}

// Adds to `taps`, at `place` along the axis of lookup `owner` of a run, its tap number `ordinal`.
template <class T>
void add_tap(const Block<T>& run, const Axes<T>& axes, int owner, int ordinal, Block<T>& taps) {
    const int i = taps.count++, n = axes.taps[owner];
    const T weight = T(1) / static_cast<T>(n), place = (static_cast<T>(ordinal) + T(0.5)) * weight - T(0.5);
    taps.owner[i] = owner;
    taps.ordinal[i] = ordinal;
    taps.weight[i] = weight;
    taps.place[i] = place;
    taps.u[i] = n > 1 ? run.u[owner] + place * axes.u[owner] : run.u[owner];
    taps.v[i] = n > 1 ? run.v[owner] + place * axes.v[owner] : run.v[owner];
    taps.lod[i] = run.lod[owner];
}

// Calls f(item, point, count) for runs of at most block_size lookups of [begin, end) that lie in one batch item.
template <class F>
void for_each_run(Index begin, Index end, Index points, F&& f) {
    while (begin < end) {
        const Index item = begin / points, point = begin - item * points;
        Index count = points - point;
        if (count > end - begin) count = end - begin;
        if (count > block_size) count = block_size;
        f(item, point, static_cast<int>(count));
        begin += count;
    }
}

template <class Q, class T>
struct BlockQuads {
    Block<T> block;
    Q quads[2][block_size];
};

// A quad with its numbers where they can be computed with: itself, unless they are of a type that the processor widens
// several at once.
template <int C, class Q>
MIPBAKE_INLINE Q widened(const Q& quad) {
    return quad;
}

#if defined(__F16C__)
template <int C>
struct WidenedQuad {
    using Real = float;
    float numbers[4][4];
    float x, y;

    MIPBAKE_INLINE float at(int k, int c) const { return numbers[k][c]; }
};

template <int C, std::enable_if_t<C == 3 || C == 4, int> = 0>
MIPBAKE_INLINE WidenedQuad<C> widened(const PlanarQuad<Float16>& quad) {
    WidenedQuad<C> wide;
    for (int k = 0; k < 4; ++k) {
        std::int64_t bits = 0;
        std::memcpy(&bits, quad.texels[k], C * sizeof(Float16));
        _mm_storeu_ps(wide.numbers[k], _mm_cvtph_ps(_mm_cvtsi64_si128(bits)));
    }
    wide.x = quad.x;
    wide.y = quad.y;
    return wide;
}
#endif

inline void prefetch_row(const char* left, const char* right, int bytes) {
    MIPBAKE_PREFETCH(left);
    if (bytes > 32) MIPBAKE_PREFETCH(right);
    MIPBAKE_PREFETCH(right + bytes - 1);
}

// Where the texels of every lookup lie. zero: some may lie outside, where `zeros` stands for them; fetch: asks for them
// ahead of their use.
template <bool zero, bool fetch, class S, class T>
void find_planar(const TextureArgs<T>& args, const S* zeros, BlockQuads<PlanarQuad<S>, T>& b) {
    const Index item = b.block.item;
    const int bytes = args.channels * static_cast<int>(sizeof(S));
    for (int s = 0; s < (b.block.blended ? 2 : 1); ++s)
        for (int i = 0; i < b.block.count; ++i) {
            const TextureImage& level = args.levels[b.block.level[s][i]];
            const S* const texels = static_cast<const S*>(level.texels) + item * level.batch_stride;
            const int x0 = b.block.x0[s][i], x1 = b.block.x1[s][i], y0 = b.block.y0[s][i], y1 = b.block.y1[s][i];
            const S* const row0 = texels + y0 * level.row_stride;
            const S* const row1 = texels + y1 * level.row_stride;
            const Index left = x0 * level.texel_stride, right = x1 * level.texel_stride;
            PlanarQuad<S>& quad = b.quads[s][i];
            quad.texels[0] = zero && (x0 | y0) < 0 ? zeros : row0 + left;
            quad.texels[1] = zero && (x1 | y0) < 0 ? zeros : row0 + right;
            quad.texels[2] = zero && (x0 | y1) < 0 ? zeros : row1 + left;
            quad.texels[3] = zero && (x1 | y1) < 0 ? zeros : row1 + right;
            quad.x = b.block.x[s][i];
            quad.y = b.block.y[s][i];
            if (fetch) {
                prefetch_row(reinterpret_cast<const char*>(quad.texels[0]),
                             reinterpret_cast<const char*>(quad.texels[1]), bytes);
                prefetch_row(reinterpret_cast<const char*>(quad.texels[2]),
                             reinterpret_cast<const char*>(quad.texels[3]), bytes);
            }
        }
}

template <class S, class T>
void find_texels(const TextureArgs<T>& args, bool fetch, const S* zeros, BlockQuads<PlanarQuad<S>, T>& b) {
    const bool zero = args.boundary_u == Boundary::zero || args.boundary_v == Boundary::zero;
    if (zero)
        (fetch ? find_planar<true, true, S, T> : find_planar<true, false, S, T>)(args, zeros, b);
    else
        (fetch ? find_planar<false, true, S, T> : find_planar<false, false, S, T>)(args, zeros, b);
}

// The same for cubes. Without a direction all texels are zeros.
template <class S, class T>
void find_texels(const TextureArgs<T>& args, bool, const S* zeros, BlockQuads<GeneralQuad<S>, T>& b) {
    const Index item = b.block.item;
    for (int s = 0; s < (b.block.blended ? 2 : 1); ++s)
        for (int i = 0; i < b.block.count; ++i) {
            GeneralQuad<S>& quad = b.quads[s][i];
            quad.missing = -1;
            quad.x = b.block.x[s][i];
            quad.y = b.block.y[s][i];
            if (b.block.face[i] < 0) {
                for (const S*& texel : quad.texels) texel = zeros;
                continue;
            }
            const TextureImage& level = args.levels[b.block.level[s][i]];
            const S* const texels = static_cast<const S*>(level.texels) + item * level.batch_stride;
            const CubeQuadTexels found = cube_quad(b.block.face[i], b.block.y0[s][i], b.block.y1[s][i],
                                                   b.block.x0[s][i], b.block.x1[s][i], b.block.width[s][i]);
            quad.missing = found.missing;
            for (int k = 0; k < 4; ++k) {
                const CubeTexel& t = found.texels[k];
                quad.texels[k] =
                    texels + t.face * level.face_stride + t.row * level.row_stride + t.column * level.texel_stride;
                MIPBAKE_PREFETCH(quad.texels[k]);
            }
        }
}

// Level 0 is too large to stay near a core, so that its texels are worth asking for ahead.
template <class S, class T>
bool is_large(const TextureArgs<T>& args) {
    return Index(args.heights[0]) * args.widths[0] * args.channels * Index(sizeof(S)) > (Index(1) << 18);
}

// Calls consume(quads) for blocks of lookups [begin, end), each prepared while the one before it is still to be
// consumed.
template <class Q, class T, class F>
void pipeline(const TextureArgs<T>& args, const void* zeros, bool always_both, Index begin, Index end, F&& consume) {
    using S = typename Q::Storage;
    const bool fetch = is_large<S>(args);
    BlockQuads<Q, T> blocks[2];
    int current = 0;
    bool waiting = false;
    for_each_run(begin, end, args.points, [&](Index item, Index point, int count) {
        BlockQuads<Q, T>& b = blocks[current];
        read_lookups(args, item, point, count, b.block);
        locate(args, always_both, b.block);
        find_texels(args, fetch, static_cast<const S*>(zeros), b);
        current ^= 1;
        if (waiting) consume(blocks[current]);
        waiting = true;
    });
    if (waiting) consume(blocks[current ^ 1]);
}

// The same for anisotropic filtering: consume(quads of taps) for the blocks of a run of lookups, then
// finish(lookups, axes).
template <class Q, class T, class F, class G>
void pipeline_taps(const TextureArgs<T>& args, const void* zeros, bool always_both, Index begin, Index end, F&& consume,
                   G&& finish) {
    using S = typename Q::Storage;
    const bool fetch = is_large<S>(args);
    BlockQuads<Q, T> blocks[2];
    Block<T> run;
    Axes<T> axes;
    for_each_run(begin, end, args.points, [&](Index item, Index point, int count) {
        read_lookups(args, item, point, count, run);
        find_axes(args, run, axes);
        int current = 0;
        bool waiting = false;
        blocks[0].block.count = 0;
        for (int owner = 0; owner < count; ++owner)
            for (int ordinal = 0; ordinal < axes.taps[owner]; ++ordinal) {
                Block<T>& taps = blocks[current].block;
                add_tap(run, axes, owner, ordinal, taps);
                const bool is_last = owner == count - 1 && ordinal == axes.taps[owner] - 1;
                if (taps.count < block_size && !is_last) continue;
                taps.item = item;
                taps.point = point;
                locate(args, always_both, taps);
                find_texels(args, fetch, static_cast<const S*>(zeros), blocks[current]);
                current ^= 1;
                if (waiting) consume(blocks[current]);
                waiting = true;
                blocks[current].block.count = 0;
            }
        if (waiting) consume(blocks[current ^ 1]);
        finish(run, axes);
    });
}

// Calls f with the number of channels as a constant where a specialised kernel exists (for texels in float the channel
// counts of images and of the material models, for others the channel counts of colours), or with 0.
template <int C>
struct Channels {
    static constexpr int value = C;
};

template <class S, class F>
void with_channels(int channels, F&& f) {
    if constexpr (sizeof(S) == sizeof(float)) {
        switch (channels) {
            case 1:
                return f(Channels<1>());
            case 2:
                return f(Channels<2>());
            case 8:
                return f(Channels<8>());
            case 11:
                return f(Channels<11>());
        }
    }
    if (channels == 3) return f(Channels<3>());
    return channels == 4 ? f(Channels<4>()) : f(Channels<0>());
}

// Calls f with a value of the type that texels are stored in, of those that are computed in T.
template <class T, class F>
void with_storage(Storage storage, F&& f) {
    if constexpr (sizeof(T) == sizeof(double)) {
        static_cast<void>(storage);
        return f(double());
    } else {
        if (storage == Storage::float16) return f(Float16());
        if (storage == Storage::bfloat16) return f(Bfloat16());
        return f(float());
    }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
