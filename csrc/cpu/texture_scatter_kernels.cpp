// The adjoint of lookups in the texels: sums into the levels' gradients, over the lookups of a range or of a bin's
// list.
#include "cpu/texture_block.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

constexpr int tap_bits = 4;  // of a list's entry
static_assert(max_taps == 1 << tap_bits, "an entry holds the number of a tap");

// What a lookup does to one level: two rows and two columns of a plane, which may lack some where the texture is
// surrounded by zeros, or four texels of a cube.
enum class Layout { plane, sparse_plane, cube };

template <class T>
Layout layout_of(const TextureArgs<T>& args) {
    if (args.boundary_u == Boundary::cube) return Layout::cube;
    const bool is_sparse = args.boundary_u == Boundary::zero || args.boundary_v == Boundary::zero;
    return is_sparse || args.filter == Filter::nearest ? Layout::sparse_plane : Layout::plane;
}

// Adds one lookup's gradient to the texels of a level, where rows [row_begin, row_end) are wanted. The order (upper
// row before lower, left before right) is the same for every caller.
template <Layout layout, int C, class T>
MIPBAKE_INLINE void scatter_quad(T* level, const Block<T>& b, int s, int i, int channels, T weight, Index row_begin,
                                 Index row_end, const T* grad) {
    const int n = C > 0 ? C : channels;
    const int width = b.width[s][i], x0 = b.x0[s][i], x1 = b.x1[s][i], y0 = b.y0[s][i], y1 = b.y1[s][i];
    const T x = b.x[s][i], y = b.y[s][i];
    if constexpr (layout == Layout::cube) {
        const CubeQuadTexels quad = cube_quad(b.face[i], y0, y1, x0, x1, width);
        T weights[4];
        quad_weights(x, y, weight, quad.missing, weights);
        for (int k = 0; k < 4; ++k) {
            const Index row = Index(quad.texels[k].face) * width + quad.texels[k].row;
            if (weights[k] != 0 && row >= row_begin && row < row_end)
                add_texel<C>(level + (row * width + quad.texels[k].column) * n, weights[k], channels, grad);
        }
    } else {
        constexpr bool is_sparse = layout == Layout::sparse_plane;
        const T upper = weight * (1 - y), lower = weight * y;
        if (y0 >= row_begin && y0 < row_end) {  // never so for row -1
            T* const row = level + Index(y0) * width * n;
            if (!is_sparse || x0 >= 0) add_texel<C>(row + Index(x0) * n, upper * (1 - x), channels, grad);
            if (!is_sparse || (x1 >= 0 && x != 0)) add_texel<C>(row + Index(x1) * n, upper * x, channels, grad);
        }
        if (y1 >= row_begin && y1 < row_end && (!is_sparse || y != 0)) {
            T* const row = level + Index(y1) * width * n;
            if (!is_sparse || x0 >= 0) add_texel<C>(row + Index(x0) * n, lower * (1 - x), channels, grad);
            if (!is_sparse || (x1 >= 0 && x != 0)) add_texel<C>(row + Index(x1) * n, lower * x, channels, grad);
        }
    }
}

template <class F>
void with_layout(Layout layout, F&& f) {
    switch (layout) {
        case Layout::plane:
            return f(std::integral_constant<Layout, Layout::plane>());
        case Layout::sparse_plane:
            return f(std::integral_constant<Layout, Layout::sparse_plane>());
        case Layout::cube:
            return f(std::integral_constant<Layout, Layout::cube>());
    }
}

template <Layout layout, class T, class F>
void with_specialised_channels(int channels, F&& f) {
    if constexpr (layout == Layout::plane)
        with_channels<T>(channels, f);
    else
        f(Channels<0>());
}

template <class T>
Index rows_of(const TextureArgs<T>& args, int level) {
    return Index(args.heights[level]) * (args.boundary_u == Boundary::cube ? 6 : 1);
}

template <class T>
T* level_grad(const TextureArgs<T>& args, const TextureGrads<T>& grads, int level, Index item) {
    const Index size = rows_of(args, level) * args.widths[level] * args.channels;
    return grads.levels[level] + (grads.level_batch[level] > 1 ? item * size : 0);
}

// Calls f(block) for the lookups, or taps, of [begin, end), located: of planes, by their rows alone where `only_rows`.
template <bool only_rows, class T, class F>
void for_each_block(const TextureArgs<T>& args, Index begin, Index end, F&& f) {
    Block<T> run, taps;
    Axes<T> axes;
    for_each_run(begin, end, args.points, [&](Index item, Index point, int count) {
        read_lookups(args, item, point, count, run);
        if (args.filter != Filter::anisotropic) {
            if (only_rows)
                locate_rows(args, run);
            else
                locate(args, false, run);
            f(run);
            return;
        }
        find_axes(args, run, axes);
        taps.count = 0;
        taps.item = item;
        taps.point = point;
        for (int owner = 0; owner < count; ++owner)
            for (int ordinal = 0; ordinal < axes.taps[owner]; ++ordinal) {
                add_tap(run, axes, owner, ordinal, taps);
                const bool is_last = owner == count - 1 && ordinal == axes.taps[owner] - 1;
                if (taps.count < block_size && !is_last) continue;
                locate(args, false, taps);
                f(taps);
                taps.count = 0;
            }
    });
}

template <Layout layout, int C, class T>
MIPBAKE_KERNEL void scatter_with(const TextureArgs<T>& args, const TextureGrads<T>& grads, Index begin, Index end) {
    const bool has_taps = args.filter == Filter::anisotropic;
    for_each_block<false>(args, begin, end, [&](const Block<T>& b) {
        const T* const first = grads.out + (b.item * args.points + b.point) * args.channels;
        for (int i = 0; i < b.count; ++i) {
            if (is_void(args, b, i)) continue;
            const T* const grad = first + Index(has_taps ? b.owner[i] : i) * args.channels;
            const T share = has_taps ? b.weight[i] : T(1);
            for (int s = 0; s < (b.blend[i] != 0 ? 2 : 1); ++s) {
                const int level = b.level[s][i];
                scatter_quad<layout, C>(level_grad(args, grads, level, b.item), b, s, i, args.channels,
                                        share * (s == 0 ? 1 - b.blend[i] : b.blend[i]), 0, rows_of(args, level), grad);
            }
        }
    });
}

// Calls f(bin, entry) once for every bin that a lookup or tap of [begin, end) touches.
template <Layout layout, class T, class F>
void for_each_touch(const TextureArgs<T>& args, const TextureBins& bins, Index begin, Index end, Index origin, F&& f) {
    const bool has_taps = args.filter == Filter::anisotropic;
    for_each_block<layout != Layout::cube>(args, begin, end, [&](const Block<T>& b) {
        const std::uint32_t lookup = static_cast<std::uint32_t>(b.item * args.points + b.point - origin);
        for (int i = 0; i < b.count; ++i) {
            const std::uint32_t entry = has_taps ? (lookup + static_cast<std::uint32_t>(b.owner[i])) * max_taps +
                                                       static_cast<std::uint32_t>(b.ordinal[i])
                                                 : lookup + static_cast<std::uint32_t>(i);
            for (int s = 0; s < (b.blend[i] != 0 ? 2 : 1); ++s) {
                const int level = b.level[s][i], shift = bins.shift[level];
                const Index first = bins.first[level];
                if (first == bins.first[level + 1]) continue;
                if constexpr (layout == Layout::cube) {
                    if (b.face[i] < 0) continue;
                    const CubeQuadTexels quad =
                        cube_quad(b.face[i], b.y0[s][i], b.y1[s][i], b.x0[s][i], b.x1[s][i], b.width[s][i]);
                    Index touched[4];
                    for (int k = 0; k < 4; ++k) {
                        const CubeTexel& t = quad.texels[k];
                        touched[k] = first + ((Index(t.face) * b.width[s][i] + t.row) >> shift);
                        bool is_new = true;
                        for (int other = 0; other < k; ++other) is_new = is_new && touched[other] != touched[k];
                        if (is_new) f(touched[k], entry);
                    }
                } else {
                    constexpr bool is_sparse = layout == Layout::sparse_plane;
                    const int y0 = b.y0[s][i], y1 = b.y1[s][i];
                    const Index upper = first + (y0 >> shift), lower = first + (y1 >> shift);
                    if (!is_sparse || y0 >= 0) f(upper, entry);
                    if ((!is_sparse || y1 >= 0) && (lower != upper || (is_sparse && y0 < 0))) f(lower, entry);
                }
            }
        }
    });
}

template <Layout layout, int C, class T>
MIPBAKE_KERNEL void scatter_list(const TextureArgs<T>& args, const TextureGrads<T>& grads, int level, Index row_begin,
                                 Index row_end, const BinList& list) {
    const bool has_taps = args.filter == Filter::anisotropic;
    const int shift = has_taps ? tap_bits : 0;
    T* const target = level_grad(args, grads, level, grads.level_batch[level] > 1 ? list.origin / args.points : 0);
    Block<T> block, taps;
    Axes<T> axes;
    const T* gradients[block_size];
    for (Index begin = 0; begin < list.count; begin += block_size) {
        const int count = static_cast<int>(list.count - begin < block_size ? list.count - begin : block_size);
        const std::uint32_t* const entries = list.entries + begin;
        for (int i = 0; i < count; ++i) {
            gradients[i] = grads.out + (list.origin + (entries[i] >> shift)) * args.channels;
            MIPBAKE_PREFETCH(gradients[i]);
        }
        read_listed(args, list.origin, entries, shift, count, block);
        if (has_taps) {
            find_axes(args, block, axes);
            taps.count = 0;
            for (int i = 0; i < count; ++i) add_tap(block, axes, i, static_cast<int>(entries[i] % max_taps), taps);
        }
        Block<T>& located = has_taps ? taps : block;
        locate_in_level(args, level, located);
        for (int i = 0; i < count; ++i) {
            if (is_void(args, located, i)) continue;
            const T weight = has_taps ? taps.weight[i] * located.blend[i] : located.blend[i];
            scatter_quad<layout, C>(target, located, 0, i, args.channels, weight, row_begin, row_end, gradients[i]);
        }
    }
}

}  // namespace

template <class T>
void texture_scatter_range(const TextureArgs<T>& args, const TextureGrads<T>& grads, Index begin, Index end) {
    with_layout(layout_of(args), [&](auto layout) {
        with_specialised_channels<layout.value, T>(
            args.channels, [&](auto c) { scatter_with<layout.value, c.value>(args, grads, begin, end); });
    });
}

template <class T>
void texture_bins_count(const TextureArgs<T>& args, const TextureBins& bins, Index begin, Index end,
                        std::uint32_t* counts) {
    with_layout(layout_of(args), [&](auto layout) {
        for_each_touch<layout.value>(args, bins, begin, end, 0, [&](Index bin, std::uint32_t) { ++counts[bin]; });
    });
}

template <class T>
void texture_bins_fill(const TextureArgs<T>& args, const TextureBins& bins, Index begin, Index end, Index origin,
                       std::uint32_t* cursors, std::uint32_t* entries) {
    with_layout(layout_of(args), [&](auto layout) {
        for_each_touch<layout.value>(args, bins, begin, end, origin,
                                     [&](Index bin, std::uint32_t entry) { entries[cursors[bin]++] = entry; });
    });
}

template <class T>
void texture_scatter_bin(const TextureArgs<T>& args, const TextureGrads<T>& grads, int level, Index row_begin,
                         Index row_end, const BinList& list) {
    with_layout(layout_of(args), [&](auto layout) {
        with_specialised_channels<layout.value, T>(args.channels, [&](auto c) {
            scatter_list<layout.value, c.value>(args, grads, level, row_begin, row_end, list);
        });
    });
}

#define MIPBAKE_INSTANTIATE(T)                                                                                         \
    template void texture_scatter_range<T>(const TextureArgs<T>&, const TextureGrads<T>&, Index, Index);               \
    template void texture_bins_count<T>(const TextureArgs<T>&, const TextureBins&, Index, Index, std::uint32_t*);      \
    template void texture_bins_fill<T>(const TextureArgs<T>&, const TextureBins&, Index, Index, Index, std::uint32_t*, \
                                       std::uint32_t*);                                                                \
    template void texture_scatter_bin<T>(const TextureArgs<T>&, const TextureGrads<T>&, int, Index, Index,             \
                                         const BinList&);
MIPBAKE_INSTANTIATE(float)
MIPBAKE_INSTANTIATE(double)

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
