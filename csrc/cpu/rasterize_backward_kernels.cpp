// The gradient of the rasteriser, compiled once per instruction set.
#include "cpu/rasterize.h"
#include "raster/barycentric.h"
#include "raster/triangle_id.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;

struct TileTriangle {
    Edges edges, sums;
    double turn;
};

}  // namespace

template <class T>
std::int64_t raster_backward_tile(const RasterizeBackwardArgs<T>& args, const PixelTile& tile, TileSums<double>& sums) {
    constexpr bool is_wide = sizeof(T) == sizeof(double);
    const T* const pos = args.pos + (args.shared ? 0 : tile.item) * args.vertices * 4;
    const double width = args.width, height = args.height;
    TileTriangle triangles[kTileTriangles];
    std::int32_t last = -1;
    TileTriangle* current = nullptr;
    Index wrong = -1;
    for (int y = tile.y0; y < tile.y1; ++y) {
        const Index row = (tile.item * args.height + y) * args.width;
        const double py = 2 * y + 1 - args.height;
        for (int x = tile.x0; x < tile.x1; ++x) {
            const Index at = (row + x) * 4;
            bool valid = true;
            const std::int32_t name = triangle_of(args.rast[at + 3], triangle_id<T>(args.triangles), valid);
            if (!valid && wrong < 0) wrong = row + x;
            if (name < 0) continue;
            const double gu = static_cast<double>(args.grad_rast[at]), gv = static_cast<double>(args.grad_rast[at + 1]);
            double h[4] = {0, 0, 0, 0};
            if (args.grad_db != nullptr)
                for (int i = 0; i < 4; ++i) h[i] = static_cast<double>(args.grad_db[at + i]);
            if (gu == 0 && gv == 0 && h[0] == 0 && h[1] == 0 && h[2] == 0 && h[3] == 0) continue;
            if (name != last) {
                last = name;
                const int known = sums.triangle_count, index = index_of(sums, name);
                current = triangles + index;
                if (index == known) {
                    ClipVertex v[3];
                    load_triangle(pos, args.tri + 3 * Index(name), v);
                    current->edges = make_edges<is_wide>(v, width, height, current->turn);
                    current->sums = {Triple(0), Triple(0), Triple(0)};
                }
            }
            const double px = 2 * x + 1 - args.width;
            const Barycentrics b = barycentrics(current->edges, px, py);
            if (args.grad_db != nullptr) {
                barycentric_adjoint<true>(current->edges, px, py, b, gu, gv, h, current->sums);
            } else {
                barycentric_adjoint<false>(current->edges, px, py, b, gu, gv, h, current->sums);
            }
        }
    }
    for (int i = 0; i < sums.triangle_count; ++i) {
        const std::int32_t* const corners = args.tri + 3 * Index(sums.tables->triangles[i]);
        const TileTriangle& t = triangles[i];
        ClipVertex v[3];
        load_triangle(pos, corners, v);
        Vec3<double> g[3];
        pull_back(v, t.sums, t.turn, width, height, g);
        for (int k = 0; k < 3; ++k) {
            double* const to = sums_of(sums, slot_of(sums, corners[k]));
            to[0] += g[k].x;
            to[1] += g[k].y;
            to[3] += g[k].z;
        }
    }
    return wrong;
}

template std::int64_t raster_backward_tile<float>(const RasterizeBackwardArgs<float>&, const PixelTile&,
                                                  TileSums<double>&);
template std::int64_t raster_backward_tile<double>(const RasterizeBackwardArgs<double>&, const PixelTile&,
                                                   TileSums<double>&);

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
