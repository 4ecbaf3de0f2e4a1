#include "cpu/splats.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/parallel.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

// Where opacity * exp(-q / 2) is least_alpha, q = a x^2 + 2 b x y + c y^2; its extent along x is sqrt(q c / (a c -
// b^2)). Numbers that are no conic of an ellipse leave an empty box.
SplatBox box_of(const SplatArgs& args, Index splat) {
    const float *center = args.centers + 2 * splat, *conic = args.conics + 3 * splat;
    const double a = conic[0], b = conic[1], c = conic[2], determinant = a * c - b * b;
    const double q = 2 * std::log(static_cast<double>(args.paint[4 * splat + 3]) / least_alpha);
    if (!(a > 0 && c > 0 && determinant > 0 && q > 0)) return {};
    const auto pixel = [](double edge, int size) {  // the first whose centre lies at an edge or behind it
        return static_cast<int>(std::clamp(std::ceil(edge - 0.5), 0.0, static_cast<double>(size)));
    };
    const double width = std::sqrt(q * c / determinant), height = std::sqrt(q * a / determinant);
    if (!std::isfinite(width + height + center[0] + center[1])) return {};
    return {pixel(center[0] - width, args.width), pixel(center[0] + width, args.width),
            pixel(center[1] - height, args.height), pixel(center[1] + height, args.height)};
}

// Calls f(tile) for the tiles that a box reaches into.
template <class F>
void for_each_tile(const SplatBox& box, int across, F&& f) {
    if (box.left >= box.right || box.bottom >= box.top) return;
    for (int y = box.bottom / splat_tile_height; y <= (box.top - 1) / splat_tile_height; ++y)
        for (int x = box.left / splat_tile_width; x <= (box.right - 1) / splat_tile_width; ++x)
            f(static_cast<std::size_t>(y) * static_cast<std::size_t>(across) + static_cast<std::size_t>(x));
}

}  // namespace

void splats_cpu(const SplatArgs& args) {
    const int across = (args.width + splat_tile_width - 1) / splat_tile_width;
    const int up = (args.height + splat_tile_height - 1) / splat_tile_height;
    std::vector<SplatBox> boxes(static_cast<std::size_t>(args.splats));
    constexpr Index splats_per_part = 2048;  // enough to outweigh waking a thread
    parallel_for(args.splats, splats_per_part, [&](Index begin, Index end) {
        for (Index i = begin; i < end; ++i) boxes[static_cast<std::size_t>(i)] = box_of(args, i);
    });
    // A counting sort: the splats of each tile, in order.
    const std::size_t tiles = static_cast<std::size_t>(across) * static_cast<std::size_t>(up);
    std::vector<Index> ends(tiles + 1);
    for (Index i = 0; i < args.listed; ++i)
        for_each_tile(boxes[static_cast<std::size_t>(args.order[i])], across, [&](std::size_t t) { ++ends[t + 1]; });
    for (std::size_t t = 0; t < tiles; ++t) ends[t + 1] += ends[t];
    std::vector<std::int32_t> sorted(static_cast<std::size_t>(ends[tiles]));
    std::vector<Index> cursors(ends.begin(), ends.end() - 1);
    for (Index i = 0; i < args.listed; ++i)
        for_each_tile(boxes[static_cast<std::size_t>(args.order[i])], across,
                      [&](std::size_t t) { sorted[static_cast<std::size_t>(cursors[t]++)] = args.order[i]; });
    parallel_for(static_cast<Index>(tiles), 1, [&](Index begin, Index end) {
        for (Index t = begin; t < end; ++t) {
            const Index first = ends[static_cast<std::size_t>(t)],
                        count = ends[static_cast<std::size_t>(t) + 1] - first;
            MIPBAKE_DISPATCH(draw_splats)
            (args, boxes.data(), sorted.data() + first, count, static_cast<int>(t / across) * splat_tile_height,
             static_cast<int>(t % across) * splat_tile_width);
        }
    });
}

}  // namespace mipbake
