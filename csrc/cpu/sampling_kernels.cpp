// Lookups in blocks: coordinates of a block are computed lane by lane in loops that vectorise, the block's texels are
// requested from memory, and only then is the block before it interpolated, so that misses overlap with work.
#include "sampling/coordinates.h"
#include "sampling/interpolate.h"

// After the headers above, which make this instruction set's namespace an inline one.
#include "cpu/sampling.h"

#if defined(_MSC_VER)
#include <xmmintrin.h>
#define MIPBAKE_PREFETCH(p) _mm_prefetch(reinterpret_cast<const char*>(p), _MM_HINT_T0)
#else
#define MIPBAKE_PREFETCH(p) __builtin_prefetch(p)
#endif

// GCC 12.2 with -O3 and AVX2 takes some of these kernels for functions without effect, and leaves their calls out,
// unless it is kept from looking into them (or -fno-ipa-modref is given). tests/test_sampling_isas.py would tell.
#if defined(__GNUC__) && !defined(__clang__)
#define MIPBAKE_KERNEL __attribute__((noipa))
#else
#define MIPBAKE_KERNEL
#endif

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

constexpr int block_size = 32;

using Index = std::int64_t;

// The coordinates of up to block_size lookups, read and converted. Index 0 of [2] is the finer level, 1 the coarser.
template <class T>
struct Block {
    int count;
    bool blended;  // whether any lookup needs its coarser level
    T u[block_size], v[block_size], lod[block_size], blend[block_size];
    int level[2][block_size], height[2][block_size], width[2][block_size];
    int x0[2][block_size], x1[2][block_size], y0[2][block_size], y1[2][block_size];
    T x[2][block_size], y[2][block_size];
};

// Sizes of the levels as small tables to gather from.
template <class T>
struct Sizes {
    int height[max_levels], width[max_levels];

    explicit Sizes(const SampleArgs<T>& args) {
        for (int l = 0; l < args.level_count; ++l) {
            height[l] = args.levels[l].height;
            width[l] = args.levels[l].width;
        }
    }
};

template <bool wrap, class T>
void taps_with(int count, const T* __restrict coordinate, const int* __restrict size, int* __restrict first,
               int* __restrict second, T* __restrict fraction) {
    for (int i = 0; i < count; ++i) {
        const Tap<T> tap = axis_tap<wrap>(coordinate[i], size[i]);
        first[i] = tap.first;
        second[i] = tap.second;
        fraction[i] = tap.fraction;
    }
}

template <class T>
void taps(bool wrap, int count, const T* coordinate, const int* size, int* first, int* second, T* fraction) {
    if (wrap)
        taps_with<true>(count, coordinate, size, first, second, fraction);
    else
        taps_with<false>(count, coordinate, size, first, second, fraction);
}

template <class T>
void level_pairs(int count, const T* __restrict lod, int last, int* __restrict finer, int* __restrict coarser,
                 T* __restrict blend) {
    for (int i = 0; i < count; ++i) {
        const LevelPair<T> pair = level_pair(lod[i], last);
        finer[i] = pair.finer;
        coarser[i] = pair.coarser;
        blend[i] = pair.blend;
    }
}

inline void gather(int count, const int* __restrict table, const int* __restrict index, int* __restrict out) {
    for (int i = 0; i < count; ++i) out[i] = table[index[i]];
}

template <class T>
bool any_blend(int count, const T* blend) {
    int mixed = 0;
    for (int i = 0; i < count; ++i) mixed |= static_cast<int>(blend[i] != 0);
    return mixed != 0;
}

// Needs block.lod; where args repeats one lod, its first element only.
template <class T>
void choose_levels(const SampleArgs<T>& args, const Sizes<T>& sizes, bool always_both, Block<T>& block) {
    const int last = args.level_count - 1;
    if (args.lod_point_stride == 0) {
        const LevelPair<T> pair = level_pair(block.lod[0], last);
        block.blended = pair.blend != 0 || always_both;
        for (int i = 0; i < block.count; ++i) block.blend[i] = pair.blend;
        for (int s = 0; s < (block.blended ? 2 : 1); ++s) {
            const int level = s == 0 ? pair.finer : pair.coarser;
            for (int i = 0; i < block.count; ++i) block.level[s][i] = level;
            for (int i = 0; i < block.count; ++i) block.height[s][i] = sizes.height[level];
            for (int i = 0; i < block.count; ++i) block.width[s][i] = sizes.width[level];
        }
        return;
    }
    level_pairs(block.count, block.lod, last, block.level[0], block.level[1], block.blend);
    block.blended = any_blend(block.count, block.blend) || always_both;
    for (int s = 0; s < (block.blended ? 2 : 1); ++s) {
        gather(block.count, sizes.height, block.level[s], block.height[s]);
        gather(block.count, sizes.width, block.level[s], block.width[s]);
    }
}

template <class T>
void rows_of(const SampleArgs<T>& args, Block<T>& block) {
    for (int s = 0; s < (block.blended ? 2 : 1); ++s)
        taps(args.wrap_v, block.count, block.v, block.height[s], block.y0[s], block.y1[s], block.y[s]);
}

template <class T>
void columns_of(const SampleArgs<T>& args, Block<T>& block) {
    for (int s = 0; s < (block.blended ? 2 : 1); ++s)
        taps(args.wrap_u, block.count, block.u, block.width[s], block.x0[s], block.x1[s], block.x[s]);
}

// Forced inline, so that a constant stride makes wide loads of it.
template <class T>
MIPBAKE_INLINE void deinterleave(int count, const T* __restrict uv, Index stride, T* __restrict u, T* __restrict v) {
    for (int i = 0; i < count; ++i) {
        u[i] = uv[i * stride];
        v[i] = uv[i * stride + 1];
    }
}

// Reads lookups [point, point + block.count) of one batch item.
template <class T>
void load(const SampleArgs<T>& args, Index item, Index point, Block<T>& block) {
    const T* const uv = args.uv + item * args.uv_batch_stride + point * args.uv_point_stride;
    const T* const lod = args.lod + item * args.lod_batch_stride + point * args.lod_point_stride;
    if (args.uv_point_stride == 2)
        deinterleave(block.count, uv, 2, block.u, block.v);
    else
        deinterleave(block.count, uv, args.uv_point_stride, block.u, block.v);
    if (args.lod_point_stride == 1)
        for (int i = 0; i < block.count; ++i) block.lod[i] = lod[i];
    else
        for (int i = 0; i < block.count; ++i) block.lod[i] = lod[i * args.lod_point_stride];
}

// NaN in any of them makes the whole lookup NaN: it then adds to no gradient.
template <class T>
bool is_nan(const Block<T>& block, int i) {
    const T sum = block.x[0][i] + block.y[0][i] + block.blend[i];  // each is in [0, 1] or NaN
    return sum != sum;
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

template <class T>
struct BlockQuads {
    Block<T> block;
    Quad<T> quads[2][block_size];
    Index first;  // number of the block's first lookup
};

template <int C, class T>
void prefetch_row(const T* left, const T* right, int channels) {
    const int bytes = (C > 0 ? C : channels) * static_cast<int>(sizeof(T));
    MIPBAKE_PREFETCH(left);
    if (bytes > 32) MIPBAKE_PREFETCH(right);
    MIPBAKE_PREFETCH(reinterpret_cast<const char*>(right) + bytes - 1);
}

// Where the texels of every lookup lie; with `fetch`, asks for them ahead of their use.
template <int C, bool fetch, class T>
void find_texels(const SampleArgs<T>& args, Index item, BlockQuads<T>& b) {
    for (int s = 0; s < (b.block.blended ? 2 : 1); ++s)
        for (int i = 0; i < b.block.count; ++i) {
            const TextureLevel<T>& level = args.levels[b.block.level[s][i]];
            const T* const texels = level.texels + item * level.batch_stride;
            const T* const row0 = texels + b.block.y0[s][i] * level.row_stride;
            const T* const row1 = texels + b.block.y1[s][i] * level.row_stride;
            const Index left = b.block.x0[s][i] * level.texel_stride, right = b.block.x1[s][i] * level.texel_stride;
            b.quads[s][i] = {row0 + left, row0 + right, row1 + left, row1 + right, b.block.x[s][i], b.block.y[s][i]};
            if (fetch) {
                prefetch_row<C>(row0 + left, row0 + right, args.channels);
                prefetch_row<C>(row1 + left, row1 + right, args.channels);
            }
        }
}

// Prepares each block while the one before it is still to be consumed.
template <int C, bool fetch, class T, class F>
void pipeline(const SampleArgs<T>& args, bool always_both, Index begin, Index end, F&& consume) {
    const Sizes<T> sizes(args);
    BlockQuads<T> blocks[2];
    int current = 0;
    bool waiting = false;
    for_each_run(begin, end, args.points, [&](Index item, Index point, int count) {
        BlockQuads<T>& b = blocks[current];
        b.block.count = count;
        b.first = item * args.points + point;
        load(args, item, point, b.block);
        choose_levels(args, sizes, always_both, b.block);
        rows_of(args, b.block);
        columns_of(args, b.block);
        find_texels<C, fetch>(args, item, b);
        current ^= 1;
        if (waiting) consume(blocks[current]);
        waiting = true;
    });
    if (waiting) consume(blocks[current ^ 1]);
}

// Whether level 0 is too large to stay near a core, so that its texels are worth asking for ahead.
template <class T>
bool is_large(const SampleArgs<T>& args) {
    const TextureLevel<T>& level = args.levels[0];
    return Index(level.height) * level.width * args.channels * Index(sizeof(T)) > (Index(1) << 18);
}

template <int C, bool fetch, class T>
MIPBAKE_KERNEL void sample_with(const SampleArgs<T>& args, T* out, Index begin, Index end) {
    pipeline<C, fetch>(args, false, begin, end, [&](const BlockQuads<T>& b) {
        T* texel = out + b.first * args.channels;
        for (int i = 0; i < b.block.count; ++i, texel += C > 0 ? C : args.channels) {
            if (b.block.blended && b.block.blend[i] != 0)
                sample_levels<C>(b.quads[0][i], b.quads[1][i], b.block.blend[i], args.channels, texel);
            else
                sample_level<C>(b.quads[0][i], args.channels, texel);
        }
    });
}

template <int C, bool fetch, class T>
MIPBAKE_KERNEL void slopes_with(const SampleArgs<T>& args, const SampleGrads<T>& grads, Index begin, Index end) {
    pipeline<C, fetch>(args, grads.lod != nullptr, begin, end, [&](const BlockQuads<T>& b) {
        for (int i = 0; i < b.block.count; ++i) {
            const Index lookup = b.first + i;
            T du = 0, dv = 0, dlod = 0;
            if (!is_nan(b.block, i)) {
                const T* const grad = grads.out + lookup * args.channels;
                const TextureLevel<T>& finer = args.levels[b.block.level[0][i]];
                const QuadSlopes<T> fine = quad_slopes<C>(b.quads[0][i], args.channels, grad);
                du = fine.x * static_cast<T>(finer.width);
                dv = fine.y * static_cast<T>(finer.height);
                if (b.block.blended && b.block.level[0][i] != b.block.level[1][i]) {
                    const TextureLevel<T>& coarser = args.levels[b.block.level[1][i]];
                    const QuadSlopes<T> coarse = quad_slopes<C>(b.quads[1][i], args.channels, grad);
                    du = lerp(du, coarse.x * static_cast<T>(coarser.width), b.block.blend[i]);
                    dv = lerp(dv, coarse.y * static_cast<T>(coarser.height), b.block.blend[i]);
                    dlod = coarse.value - fine.value;
                }
            }
            if (grads.uv != nullptr) {
                grads.uv[2 * lookup] = du;
                grads.uv[2 * lookup + 1] = dv;
            }
            if (grads.lod != nullptr) grads.lod[lookup] = dlod;
        }
    });
}

// Adds a lookup's gradient to the texels of two rows of one level, of which [row_begin, row_end) are wanted. The order
// (upper row before lower, left before right) is the same for every caller.
template <int C, class T>
void scatter_quad(T* level, int width, int channels, int x0, int x1, int y0, int y1, T x, T y, T weight, int row_begin,
                  int row_end, const T* grad) {
    const int n = C > 0 ? C : channels;
    const T upper = weight * (1 - y), lower = weight * y;
    if (y0 >= row_begin && y0 < row_end) {
        T* const row = level + Index(y0) * width * n;
        add_texel<C>(row + Index(x0) * n, upper * (1 - x), channels, grad);
        add_texel<C>(row + Index(x1) * n, upper * x, channels, grad);
    }
    if (y1 >= row_begin && y1 < row_end) {
        T* const row = level + Index(y1) * width * n;
        add_texel<C>(row + Index(x0) * n, lower * (1 - x), channels, grad);
        add_texel<C>(row + Index(x1) * n, lower * x, channels, grad);
    }
}

template <class T>
T* level_grad(const SampleArgs<T>& args, const SampleGrads<T>& grads, int level, Index item) {
    const TextureLevel<T>& l = args.levels[level];
    return grads.levels[level] + (grads.level_batch > 1 ? item * l.height * l.width * args.channels : 0);
}

template <int C, class T>
MIPBAKE_KERNEL void scatter_with(const SampleArgs<T>& args, const SampleGrads<T>& grads, Index begin, Index end) {
    const Sizes<T> sizes(args);
    Block<T> block;
    for_each_run(begin, end, args.points, [&](Index item, Index point, int count) {
        block.count = count;
        load(args, item, point, block);
        choose_levels(args, sizes, false, block);
        rows_of(args, block);
        columns_of(args, block);
        const T* grad = grads.out + (item * args.points + point) * args.channels;
        for (int i = 0; i < count; ++i, grad += args.channels) {
            if (is_nan(block, i)) continue;
            for (int s = 0; s < (block.blend[i] != 0 ? 2 : 1); ++s)
                scatter_quad<C>(level_grad(args, grads, block.level[s][i], item), block.width[s][i], args.channels,
                                block.x0[s][i], block.x1[s][i], block.y0[s][i], block.y1[s][i], block.x[s][i],
                                block.y[s][i], s == 0 ? 1 - block.blend[i] : block.blend[i], 0, block.height[s][i],
                                grad);
        }
    });
}

// Calls f(bin, lookup) once for every bin that a lookup of [begin, end) touches.
template <class T, class F>
void for_each_bin(const SampleArgs<T>& args, const SampleBins& bins, Index begin, Index end, F&& f) {
    const Sizes<T> sizes(args);
    Block<T> block;
    for_each_run(begin, end, args.points, [&](Index item, Index point, int count) {
        block.count = count;
        load(args, item, point, block);
        choose_levels(args, sizes, false, block);
        rows_of(args, block);
        const Index lookup = item * args.points + point;
        for (int i = 0; i < count; ++i) {
            for (int s = 0; s < (block.blend[i] != 0 ? 2 : 1); ++s) {
                const int level = block.level[s][i];
                const Index upper = bins.first[level] + (block.y0[s][i] >> bins.shift[level]);
                const Index lower = bins.first[level] + (block.y1[s][i] >> bins.shift[level]);
                f(upper, lookup + i);
                if (lower != upper) f(lower, lookup + i);
            }
        }
    });
}

// A block of the lookups of one bin. Their gradients lie apart in memory, and are asked for on reading.
template <class T>
struct BinBlock {
    int count;
    T u[block_size], v[block_size], lod[block_size], weight[block_size];
    int x0[block_size], x1[block_size], y0[block_size], y1[block_size], size[block_size];
    T x[block_size], y[block_size];
    const T* grad[block_size];
};

// one_item: the batch item of every lookup, or -1 where each has its own.
template <class T>
void load_listed(const SampleArgs<T>& args, const SampleGrads<T>& grads, Index one_item, const std::uint32_t* lookups,
                 Index origin, BinBlock<T>& block) {
    for (int i = 0; i < block.count; ++i) {
        const Index lookup = origin + lookups[i];
        Index item = one_item;
        if (one_item < 0) item = lookup / args.points;
        const Index point = lookup - item * args.points;
        const T* const uv = args.uv + item * args.uv_batch_stride + point * args.uv_point_stride;
        block.u[i] = uv[0];
        block.v[i] = uv[1];
        block.lod[i] = args.lod[item * args.lod_batch_stride + point * args.lod_point_stride];
        block.grad[i] = grads.out + lookup * args.channels;
        MIPBAKE_PREFETCH(block.grad[i]);
    }
}

template <class T>
void locate_listed(const SampleArgs<T>& args, int level, BinBlock<T>& block) {
    const int last = args.level_count - 1;
    for (int i = 0; i < block.count; ++i) block.size[i] = args.levels[level].width;
    taps(args.wrap_u, block.count, block.u, block.size, block.x0, block.x1, block.x);
    for (int i = 0; i < block.count; ++i) block.size[i] = args.levels[level].height;
    taps(args.wrap_v, block.count, block.v, block.size, block.y0, block.y1, block.y);
    for (int i = 0; i < block.count; ++i) {
        const LevelPair<T> pair = level_pair(block.lod[i], last);
        block.weight[i] = pair.finer == level ? 1 - pair.blend : pair.blend;
    }
}

template <int C, class T>
MIPBAKE_KERNEL void scatter_bin_with(const SampleArgs<T>& args, const SampleGrads<T>& grads, int level, int row_begin,
                                     int row_end, const std::uint32_t* lookups, Index count, Index origin) {
    const bool is_one_item = args.batch == 1 || grads.level_batch > 1;
    const Index first_item = origin / args.points;
    T* const target = level_grad(args, grads, level, first_item);
    const int width = args.levels[level].width;
    BinBlock<T> block;
    for (Index begin = 0; begin < count; begin += block_size) {
        block.count = static_cast<int>(count - begin < block_size ? count - begin : block_size);
        load_listed(args, grads, is_one_item ? first_item : -1, lookups + begin, origin, block);
        locate_listed(args, level, block);
        for (int i = 0; i < block.count; ++i) {
            const T sum = block.x[i] + block.y[i] + block.weight[i];
            if (sum != sum) continue;
            scatter_quad<C>(target, width, args.channels, block.x0[i], block.x1[i], block.y0[i], block.y1[i],
                            block.x[i], block.y[i], block.weight[i], row_begin, row_end, block.grad[i]);
        }
    }
}

// Calls f with the number of channels as a constant where a specialised kernel exists (the channel counts of images and
// of the material models), or with 0.
template <int C>
struct Channels {
    static constexpr int value = C;
};

template <class F>
void with_channels(int channels, F&& f) {
    switch (channels) {
        case 1:
            return f(Channels<1>());
        case 2:
            return f(Channels<2>());
        case 3:
            return f(Channels<3>());
        case 4:
            return f(Channels<4>());
        case 8:
            return f(Channels<8>());
        case 11:
            return f(Channels<11>());
        default:
            return f(Channels<0>());
    }
}

}  // namespace

template <class T>
void sample_range(const SampleArgs<T>& args, T* out, Index begin, Index end) {
    with_channels(args.channels, [&](auto c) {
        if (is_large(args))
            sample_with<c.value, true>(args, out, begin, end);
        else
            sample_with<c.value, false>(args, out, begin, end);
    });
}

template <class T>
void sample_slopes_range(const SampleArgs<T>& args, const SampleGrads<T>& grads, Index begin, Index end) {
    with_channels(args.channels, [&](auto c) {
        if (is_large(args))
            slopes_with<c.value, true>(args, grads, begin, end);
        else
            slopes_with<c.value, false>(args, grads, begin, end);
    });
}

template <class T>
void scatter_range(const SampleArgs<T>& args, const SampleGrads<T>& grads, Index begin, Index end) {
    with_channels(args.channels, [&](auto c) { scatter_with<c.value>(args, grads, begin, end); });
}

template <class T>
void bins_count(const SampleArgs<T>& args, const SampleBins& bins, Index begin, Index end, std::uint32_t* counts) {
    for_each_bin(args, bins, begin, end, [&](Index bin, Index) { ++counts[bin]; });
}

template <class T>
void bins_fill(const SampleArgs<T>& args, const SampleBins& bins, Index begin, Index end, Index origin,
               std::uint32_t* cursors, std::uint32_t* lookups) {
    for_each_bin(args, bins, begin, end, [&](Index bin, Index lookup) {
        lookups[cursors[bin]++] = static_cast<std::uint32_t>(lookup - origin);
    });
}

template <class T>
void scatter_bin(const SampleArgs<T>& args, const SampleGrads<T>& grads, int level, int row_begin, int row_end,
                 const std::uint32_t* lookups, Index count, Index origin) {
    with_channels(args.channels, [&](auto c) {
        scatter_bin_with<c.value>(args, grads, level, row_begin, row_end, lookups, count, origin);
    });
}

#define MIPBAKE_INSTANTIATE(T)                                                                                     \
    template void sample_range<T>(const SampleArgs<T>&, T*, Index, Index);                                         \
    template void sample_slopes_range<T>(const SampleArgs<T>&, const SampleGrads<T>&, Index, Index);               \
    template void scatter_range<T>(const SampleArgs<T>&, const SampleGrads<T>&, Index, Index);                     \
    template void bins_count<T>(const SampleArgs<T>&, const SampleBins&, Index, Index, std::uint32_t*);            \
    template void bins_fill<T>(const SampleArgs<T>&, const SampleBins&, Index, Index, Index, std::uint32_t*,       \
                               std::uint32_t*);                                                                    \
    template void scatter_bin<T>(const SampleArgs<T>&, const SampleGrads<T>&, int, int, int, const std::uint32_t*, \
                                 Index, Index);
MIPBAKE_INSTANTIATE(float)
MIPBAKE_INSTANTIATE(double)

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
