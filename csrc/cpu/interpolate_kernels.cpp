#include "cpu/interpolate.h"
#include "raster/interpolate.h"
#include "raster/triangle_id.h"

// GCC 12.2 must be kept from looking into kernels; see csrc/cpu/texture_block.h.
#if defined(__GNUC__) && !defined(__clang__)
#define MIPBAKE_KERNEL __attribute__((noipa))
#else
#define MIPBAKE_KERNEL
#endif

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;

constexpr int block_size = 64;

// The triangles of consecutive pixels, -1 where there is none, and where the attributes of their vertices begin. They
// are found for all pixels before any is used: the lookups then do not wait for one another.
template <class T>
struct Block {
    std::int32_t triangle[block_size];
    Corners<T> corners[block_size];
};

// `valid` is cleared where an id or a vertex is not in the mesh; the pixel then counts as empty.
template <class T>
MIPBAKE_INLINE void locate(const InterpolateArgs<T>& args, const T* attr, int channels, Index first, int count,
                           Block<T>& block, bool& valid) {
    const T* const pixels = args.rast + 4 * first;
    const T triangles = triangle_id<T>(args.triangles);
    const auto vertices = static_cast<std::uint64_t>(args.vertices);
    bool good = true;
    for (int i = 0; i < count; ++i) block.triangle[i] = triangle_of(pixels[4 * i + 3], triangles, good);
    if (args.triangles > 0) {
        for (int i = 0; i < count; ++i) {
            const std::int32_t* const v = args.tri + 3 * Index(block.triangle[i] < 0 ? 0 : block.triangle[i]);
            const std::uint64_t v0(v[0]), v1(v[1]), v2(v[2]);  // negative ones become too large
            if (v0 >= vertices || v1 >= vertices || v2 >= vertices) {
                good = false;
                block.triangle[i] = -1;
            } else {
                block.corners[i] = {attr + Index(v0) * channels, attr + Index(v1) * channels,
                                    attr + Index(v2) * channels};
            }
        }
    }
    valid = valid && good;
}

template <int C, int K, class T>
MIPBAKE_KERNEL bool forward(const InterpolateArgs<T>& args, T* out, T* out_da, Index item, Index begin, Index end) {
    const Listed listed{args.listed, args.listed_count};
    const int channels = C > 0 ? C : args.channels, derivatives = 2 * listed_count<K>(listed);
    const T* const attr = args.attr + item * args.attr_batch_stride;
    const Index origin = item * args.height * args.width;
    Block<T> block;
    bool valid = true;
    for (Index first = origin + begin; first < origin + end; first += block_size) {
        const int count = static_cast<int>(origin + end - first < block_size ? origin + end - first : block_size);
        locate(args, attr, channels, first, count, block, valid);
        for (int i = 0; i < count; ++i) {
            const Index p = first + i;
            const T* const pixel = args.rast + 4 * p;
            T* const values = out + p * channels;
            T* const slopes = out_da + p * derivatives;
            if (block.triangle[i] >= 0) {
                interpolate_values<C>(block.corners[i], pixel[0], pixel[1], channels, values);
                if (derivatives > 0) interpolate_derivatives<K>(block.corners[i], args.rast_db + 4 * p, listed, slopes);
            } else {
                for (int c = 0; c < channels; ++c) values[c] = 0;
                for (int k = 0; k < derivatives; ++k) slopes[k] = 0;
            }
        }
    }
    return valid;
}

template <int C, int K, class T>
MIPBAKE_KERNEL void backward(const InterpolateArgs<T>& args, const InterpolateGrads<T>& grads, const PixelTile& tile,
                             TileSums<double>* sums) {
    const Listed listed{args.listed, grads.da != nullptr ? args.listed_count : 0};
    const int channels = C > 0 ? C : args.channels, derivatives = 2 * listed_count<K>(listed);
    const T* const attr = args.attr + tile.item * args.attr_batch_stride;
    Block<T> block;
    const std::uint16_t* slots[block_size];
    std::int32_t summed = -1;
    const std::uint16_t* summed_slots = nullptr;
    bool valid = true;  // the forward pass has told
    for (int y = tile.y0; y < tile.y1; ++y) {
        const Index begin = (tile.item * args.height + y) * args.width + tile.x0, end = begin + tile.x1 - tile.x0;
        for (Index first = begin; first < end; first += block_size) {
            const int count = static_cast<int>(end - first < block_size ? end - first : block_size);
            locate(args, attr, channels, first, count, block, valid);
            if (sums != nullptr)
                for (int i = 0; i < count; ++i) {
                    if (block.triangle[i] >= 0 && block.triangle[i] != summed) {
                        summed = block.triangle[i];
                        summed_slots = corners_of(*sums, args.tri, summed);
                    }
                    slots[i] = summed_slots;
                }
            for (int i = 0; i < count; ++i) {
                const Index p = first + i;
                const T* const pixel = args.rast + 4 * p;
                T by_uv[2] = {0, 0}, by_db[4] = {0, 0, 0, 0};
                if (block.triangle[i] >= 0) {
                    const T* const grad = grads.out + p * channels;
                    const T* const grad_da = grads.da + p * derivatives;
                    const T* const db = args.rast_db + 4 * p;
                    if (grads.rast != nullptr)
                        barycentric_gradient<C>(block.corners[i], channels, grad, &by_uv[0], &by_uv[1]);
                    if (grads.db != nullptr) derivative_gradient<K>(block.corners[i], grad_da, listed, by_db);
                    if (sums != nullptr) {
                        double* const rows[3] = {sums_of(*sums, slots[i][0]), sums_of(*sums, slots[i][1]),
                                                 sums_of(*sums, slots[i][2])};
                        if constexpr (C > 0 && K >= 0) {
                            add_contributions<C, K>(pixel[0], pixel[1], db, grad, grad_da, rows);
                        } else {
                            const auto add = [&](int vertex, int c, T value) {
                                rows[vertex][c] += static_cast<double>(value);
                            };
                            value_contributions(pixel[0], pixel[1], channels, grad, add);
                            derivative_contributions(db, grad_da, listed, add);
                        }
                    }
                }
                if (grads.rast != nullptr) {
                    T* const target = grads.rast + 4 * p;
                    target[0] = by_uv[0];
                    target[1] = by_uv[1];
                    target[2] = target[3] = 0;
                }
                if (grads.db != nullptr)
                    for (int k = 0; k < 4; ++k) grads.db[4 * p + k] = by_db[k];
            }
        }
    }
}

template <int C, int K>
struct Counts {
    static constexpr int channels = C, listed = K;
};

// Calls f with the counts of channels and of derivatives as constants where they are common ones: up to four channels
// with no derivatives, with derivatives of the first two (texture coordinates), or of all.
template <int C, class F>
auto with_derivatives(int listed, F&& f) {
    if (listed == C) return f(Counts<C, C>());
    if (listed == 0) return f(Counts<C, 0>());
    if constexpr (C > 2)
        if (listed == 2) return f(Counts<C, 2>());
    return f(Counts<0, -1>());
}
template <class T, class F>
auto with_counts(const InterpolateArgs<T>& args, bool has_derivatives, F&& f) {
    const int listed = has_derivatives ? args.listed_count : 0;
    bool in_order = true;
    for (int k = 0; k < listed; ++k) in_order = in_order && args.listed[k] == k;
    if (!in_order || args.channels > 4) return f(Counts<0, -1>());
    switch (args.channels) {
        case 1:
            return with_derivatives<1>(listed, f);
        case 2:
            return with_derivatives<2>(listed, f);
        case 3:
            return with_derivatives<3>(listed, f);
        case 4:
            return with_derivatives<4>(listed, f);
        default:
            return f(Counts<0, -1>());
    }
}

}  // namespace

template <class T>
bool interpolate_pixels(const InterpolateArgs<T>& args, T* out, T* out_da, Index item, Index begin, Index end) {
    return with_counts(args, true, [&](auto n) {
        return forward<decltype(n)::channels, decltype(n)::listed>(args, out, out_da, item, begin, end);
    });
}

template <class T>
void interpolate_backward_tile(const InterpolateArgs<T>& args, const InterpolateGrads<T>& grads, const PixelTile& tile,
                               TileSums<double>* sums) {
    with_counts(args, grads.da != nullptr,
                [&](auto n) { backward<decltype(n)::channels, decltype(n)::listed>(args, grads, tile, sums); });
}

#define MIPBAKE_INSTANTIATE(T)                                                                        \
    template bool interpolate_pixels<T>(const InterpolateArgs<T>&, T*, T*, Index, Index, Index);      \
    template void interpolate_backward_tile<T>(const InterpolateArgs<T>&, const InterpolateGrads<T>&, \
                                               const PixelTile&, TileSums<double>*);
MIPBAKE_INSTANTIATE(float)
MIPBAKE_INSTANTIATE(double)

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
