#include "cpu/interpolate.h"

#include <atomic>

#include "core/parallel.h"
#include "cpu/triangle_ids.h"

namespace mipbake {

using Index = std::int64_t;

template <class T>
void interpolate_cpu(const InterpolateArgs<T>& args, T* out, T* out_da) {
    constexpr Index grain = 16384;
    const Index pixels = Index(args.height) * args.width, chunks = (pixels + grain - 1) / grain;
    std::atomic<bool> valid{true};
    parallel_for(args.batch * chunks, 1, [&](Index chunk, Index) {
        const Index begin = chunk % chunks * grain, end = std::min(pixels, begin + grain);
        if (!MIPBAKE_DISPATCH(interpolate_pixels<T>)(args, out, out_da, chunk / chunks, begin, end))
            valid.store(false, std::memory_order_relaxed);
    });
    if (valid.load()) return;
    check_triangle_vertices(args.tri, args.triangles, args.vertices);
    check_triangle_ids(args.rast, args.batch, args.height, args.width, args.triangles);
}

template <class T>
void interpolate_backward_cpu(const InterpolateArgs<T>& args, const InterpolateGrads<T>& grads) {
    const PixelGrid grid{args.batch, args.height, args.width};
    if (grads.attr != nullptr) {
        sum_into_vertices<double>(grid, args.vertices, args.attr_batch_stride == 0, args.channels, grads.attr,
                                  [&](const PixelTile& tile, TileSums<double>& sums) {
                                      MIPBAKE_DISPATCH(interpolate_backward_tile<T>)(args, grads, tile, &sums);
                                  });
        return;
    }
    parallel_for(args.batch * args.height, 8, [&](Index begin, Index end) {
        for (Index row = begin; row < end; ++row) {
            const int y = static_cast<int>(row % args.height);
            const PixelTile tile{row / args.height, y, y + 1, 0, args.width};
            MIPBAKE_DISPATCH(interpolate_backward_tile<T>)(args, grads, tile, nullptr);
        }
    });
}

#define MIPBAKE_INSTANTIATE(T)                                           \
    template void interpolate_cpu<T>(const InterpolateArgs<T>&, T*, T*); \
    template void interpolate_backward_cpu<T>(const InterpolateArgs<T>&, const InterpolateGrads<T>&);
MIPBAKE_INSTANTIATE(float)
MIPBAKE_INSTANTIATE(double)

}  // namespace mipbake
