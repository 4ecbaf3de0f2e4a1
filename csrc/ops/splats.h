// What the core offers for splats.
#pragma once

#include <cstdint>

namespace mipbake {

// Gaussians in the plane, which are drawn over each other. On the CPU alone.
struct SplatArgs {
    std::int64_t splats, listed;
    int height, width, most;
    const std::int32_t* order;  // (listed): splats, nearest first
    const float* centers;       // (splats, 2): x and y in pixels
    const float* conics;        // (splats, 3): a, b, c of a x^2 + 2 b x y + c y^2, the inverse of the covariance
    const float* paint;         // (splats, 4): red, green, blue, opacity
    float* image;               // (height, width, 4): colour, and how much of the pixel is covered
    std::int32_t* shown;        // (height, width, most): splats that make up a pixel, nearest first, -1 behind them
};
constexpr int most_splats_shown = 64;
void splats_cpu(const SplatArgs& args);

}  // namespace mipbake
