#include "cpu/interpolate.h"
#include "raster/interpolate.h"
#include "raster/triangle_id.h"

// See csrc/cpu/sampling_kernels.cpp.
#if defined(__GNUC__) && !defined(__clang__)
#define MIPBAKE_KERNEL __attribute__((noipa))
#else
#define MIPBAKE_KERNEL
#endif

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;

// The triangle of the pixel before, kept while it stays the same.
template <class T>
struct Current {
    std::int32_t triangle = -1;
    bool valid = true;
    Corners<T> corners{};

    // Whether `next` is a triangle whose vertices exist.
    MIPBAKE_INLINE bool move(const InterpolateArgs<T>& args, const T* attr, std::int32_t next, int channels) {
        if (next < 0) return false;
        if (next == triangle) return true;
        const std::int32_t* const v = args.tri + 3 * Index(next);
        const auto vertices = static_cast<std::uint64_t>(args.vertices);
        if (std::uint64_t(v[0]) >= vertices || std::uint64_t(v[1]) >= vertices || std::uint64_t(v[2]) >= vertices) {
            valid = false;
            return false;
        }
        corners = {attr + Index(v[0]) * channels, attr + Index(v[1]) * channels, attr + Index(v[2]) * channels};
        triangle = next;
        return true;
    }
};

template <int C, class T>
MIPBAKE_KERNEL bool forward(const InterpolateArgs<T>& args, T* out, T* out_da, Index item, Index begin, Index end) {
    const int channels = C > 0 ? C : args.channels, listed = args.listed_count;
    const T count = static_cast<T>(args.triangles);
    const T* const attr = args.attr + item * args.attr_batch_stride;
    const Index first = item * args.height * args.width;
    Current<T> current;
    for (Index p = first + begin; p < first + end; ++p) {
        const T* const pixel = args.rast + 4 * p;
        const bool drawn = current.move(args, attr, triangle_of(pixel[3], count, current.valid), channels);
        T* const values = out + p * channels;
        if (drawn) {
            interpolate_values<C>(current.corners, pixel[0], pixel[1], channels, values);
            if (listed > 0)
                interpolate_derivatives(current.corners, args.rast_db + 4 * p, args.listed, listed,
                                        out_da + 2 * p * listed);
        } else {
            for (int c = 0; c < channels; ++c) values[c] = 0;
            for (int k = 0; k < 2 * listed; ++k) out_da[2 * p * listed + k] = 0;
        }
    }
    return current.valid;
}

template <int C, class T>
MIPBAKE_KERNEL void backward(const InterpolateArgs<T>& args, const InterpolateGrads<T>& grads, const PixelTile& tile,
                             TileSums<double>* sums) {
    const int channels = C > 0 ? C : args.channels, listed = grads.da != nullptr ? args.listed_count : 0;
    const T count = static_cast<T>(args.triangles);
    const T* const attr = args.attr + tile.item * args.attr_batch_stride;
    Current<T> current;
    std::int32_t summed = -1;
    double* rows[3] = {};
    for (int y = tile.y0; y < tile.y1; ++y) {
        const Index row = (tile.item * args.height + y) * args.width;
        for (Index p = row + tile.x0; p < row + tile.x1; ++p) {
            const T* const pixel = args.rast + 4 * p;
            T by_uv[2] = {0, 0}, by_db[4] = {0, 0, 0, 0};
            if (current.move(args, attr, triangle_of(pixel[3], count, current.valid), channels)) {
                const T* const grad = grads.out + p * channels;
                const T* const grad_da = grads.da + 2 * p * listed;
                const T* const db = args.rast_db + 4 * p;
                if (grads.rast != nullptr)
                    barycentric_gradient<C>(current.corners, channels, grad, &by_uv[0], &by_uv[1]);
                if (grads.db != nullptr) derivative_gradient(current.corners, grad_da, args.listed, listed, by_db);
                if (sums != nullptr) {
                    if (summed != current.triangle) {
                        const std::uint16_t* const slots = corners_of(*sums, args.tri, current.triangle);
                        for (int k = 0; k < 3; ++k) rows[k] = sums_of(*sums, slots[k]);
                        summed = current.triangle;
                    }
                    const auto add = [&](int vertex, int c, T value) { rows[vertex][c] += static_cast<double>(value); };
                    value_contributions<C>(pixel[0], pixel[1], channels, grad, add);
                    if (listed > 0) derivative_contributions(db, grad_da, args.listed, listed, add);
                }
            }
            if (grads.rast != nullptr) {
                T* const target = grads.rast + 4 * p;
                target[0] = by_uv[0];
                target[1] = by_uv[1];
                target[2] = target[3] = 0;
            }
            if (grads.db != nullptr)
                for (int i = 0; i < 4; ++i) grads.db[4 * p + i] = by_db[i];
        }
    }
}

template <int C>
struct Channels {
    static constexpr int value = C;
};

// Calls f with the number of channels as a constant where it is a common one, or with 0.
template <class F>
auto with_channels(int channels, F&& f) {
    switch (channels) {
        case 1:
            return f(Channels<1>());
        case 2:
            return f(Channels<2>());
        case 3:
            return f(Channels<3>());
        case 4:
            return f(Channels<4>());
        default:
            return f(Channels<0>());
    }
}

}  // namespace

template <class T>
bool interpolate_pixels(const InterpolateArgs<T>& args, T* out, T* out_da, Index item, Index begin, Index end) {
    return with_channels(args.channels, [&](auto c) { return forward<c.value>(args, out, out_da, item, begin, end); });
}

template <class T>
void interpolate_backward_tile(const InterpolateArgs<T>& args, const InterpolateGrads<T>& grads, const PixelTile& tile,
                               TileSums<double>* sums) {
    with_channels(args.channels, [&](auto c) { backward<c.value>(args, grads, tile, sums); });
}

#define MIPBAKE_INSTANTIATE(T)                                                                        \
    template bool interpolate_pixels<T>(const InterpolateArgs<T>&, T*, T*, Index, Index, Index);      \
    template void interpolate_backward_tile<T>(const InterpolateArgs<T>&, const InterpolateGrads<T>&, \
                                               const PixelTile&, TileSums<double>*);
MIPBAKE_INSTANTIATE(float)
MIPBAKE_INSTANTIATE(double)

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
