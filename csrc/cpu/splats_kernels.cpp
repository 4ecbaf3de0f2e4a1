// A tile of splats: each is blended, over the pixels that it reaches, behind those before it (Kerbl et al., 3D Gaussian
// Splatting for Real-Time Radiance Field Rendering, 2023).
#include <cstring>

#include "core/packet.h"
#include "core/packet_series.h"
#include "core/real.h"
#include "cpu/splats.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;
using P = Lanes<float>::Real;

constexpr int width = splat_tile_width, height = splat_tile_height, lanes = Lanes<float>::count;
constexpr float largest_alpha = 0.99f;     // so that no splat hides all behind it
constexpr float least_through = 1e-4f;     // where less light comes through, nothing more is drawn
constexpr int splats_between_checks = 16;  // of whether a tile is opaque
static_assert(width % lanes == 0, "a row of a tile is a whole number of packets");

constexpr float places[] = {0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
static_assert(sizeof places / sizeof *places == width, "a place for each pixel of a row");

MIPBAKE_INLINE P load(const float* data) {
    P p;
    std::memcpy(&p, data, sizeof p);
    return p;
}
MIPBAKE_INLINE void store(float* data, const P& p) { std::memcpy(data, &p, sizeof p); }

struct Tile {
    float through[height * width];   // how much light comes through what was drawn
    float color[3][height * width];  // red, green and blue
    int filled[height * width];      // how many splats are listed
    float weights[height * width][most_splats_shown];
};

// Lists a splat of a pixel. A full list loses its smallest weight, be it the new one.
MIPBAKE_INLINE void list(std::int32_t* shown, float* weights, int& filled, int most, std::int32_t splat, float weight) {
    if (filled == most) {
        int smallest = 0;
        for (int k = 1; k < most; ++k) smallest = weights[k] < weights[smallest] ? k : smallest;
        if (weights[smallest] >= weight) return;
        for (int k = smallest; k + 1 < most; ++k) {
            weights[k] = weights[k + 1];
            shown[k] = shown[k + 1];
        }
        --filled;
    }
    weights[filled] = weight;
    shown[filled++] = splat;
}

MIPBAKE_INLINE bool is_opaque(const Tile& tile) {
    P most = load(tile.through);
    for (int i = lanes; i < height * width; i += lanes) most = larger(most, load(tile.through + i));
    return !any(most >= P(least_through));
}

}  // namespace

void draw_splats(const SplatArgs& args, const SplatBox* boxes, const std::int32_t* splats, Index count, int row,
                 int column) {
    Tile tile;
    for (float& each : tile.through) each = 1;
    std::memset(tile.color, 0, sizeof tile.color);
    std::memset(tile.filled, 0, sizeof tile.filled);
    const int rows = args.height - row < height ? args.height - row : height;
    const int columns = args.width - column < width ? args.width - column : width;
    for (Index i = 0; i < count; ++i) {
        if (i % splats_between_checks == 0 && i > 0 && is_opaque(tile)) break;
        const std::int32_t s = splats[i];
        const SplatBox& box = boxes[s];
        const float *const conic = args.conics + 3 * s, *const paint = args.paint + 4 * s;
        const P a(conic[0]), b(conic[1]), c(conic[2]);
        const int from = box.bottom > row ? box.bottom - row : 0, to = box.top - row < rows ? box.top - row : rows;
        for (int first = 0; first < width; first += lanes) {
            if (box.left >= column + first + lanes || box.right <= column + first) continue;
            const P place = load(places + first);
            const P x = place + P(static_cast<float>(column) + 0.5f - args.centers[2 * s]);
            // Beyond the box rounding may lift alpha over its least, in a packet that is wide enough to get there.
            const P opacity = select(both(place >= P(static_cast<float>(box.left - column)),
                                          place < P(static_cast<float>(box.right - column))),
                                     P(paint[3]), P(0.0f));
            for (int y = from; y < to; ++y) {
                const P up(static_cast<float>(row + y) + 0.5f - args.centers[2 * s + 1]);
                const P q = a * x * x + P(2.0f) * b * x * up + c * up * up;
                const P alpha = smaller(P(largest_alpha), opacity * exponential(larger(P(-0.5f) * q, P(-80.0f))));
                const int at = y * width + first;
                const P through = load(tile.through + at);
                const P drawn = select(alpha >= P(least_alpha), alpha, P(0.0f));
                const P weight = select(through >= P(least_through), drawn * through, P(0.0f));
                if (!any(weight > P(0.0f))) continue;
                store(tile.through + at, through - weight);
                for (int channel = 0; channel < 3; ++channel) {
                    float* const color = tile.color[channel] + at;
                    store(color, load(color) + weight * P(paint[channel]));
                }
                if (args.most == 0) continue;
                float weights[lanes];
                store(weights, weight);
                for (int lane = 0; lane < lanes && first + lane < columns; ++lane) {
                    if (weights[lane] < least_alpha) continue;
                    const Index pixel = Index(row + y) * args.width + column + first + lane;
                    list(args.shown + pixel * args.most, tile.weights[at + lane], tile.filled[at + lane], args.most, s,
                         weights[lane]);
                }
            }
        }
    }
    for (int y = 0; y < rows; ++y)
        for (int x = 0; x < columns; ++x) {
            const int at = y * width + x;
            const Index pixel = Index(row + y) * args.width + column + x;
            for (int channel = 0; channel < 3; ++channel) args.image[4 * pixel + channel] = tile.color[channel][at];
            args.image[4 * pixel + 3] = 1 - tile.through[at];
            for (int k = tile.filled[at]; k < args.most; ++k) args.shown[pixel * args.most + k] = -1;
        }
}

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
