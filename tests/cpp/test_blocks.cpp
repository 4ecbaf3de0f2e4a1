// Block compression: what encoders make comes back as near as the formats allow, for any number of threads and any
// size, and no brute search of BC4's endpoints does better.
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <vector>

#include "check.h"
#include "core/parallel.h"
#include "ops/blocks.h"

using namespace mipbake;

namespace {

using Index = std::int64_t;

std::uint32_t state = 7;

float random_number() {
    state = state * 1664525u + 1013904223u;
    return static_cast<float>(state >> 8) / (1 << 24);
}

std::vector<std::uint8_t> encoded(BlockFormat format, Index height, Index width, const std::vector<float>& values,
                                  const std::vector<float>& weights = {}) {
    std::vector<std::uint8_t> blocks(static_cast<std::size_t>((height + 3) / 4 * ((width + 3) / 4) * bytes_of(format)));
    encode_blocks_cpu({format, height, width, values.data(), weights.empty() ? nullptr : weights.data()},
                      blocks.data());
    return blocks;
}

std::vector<float> decoded(BlockFormat format, Index height, Index width, const std::vector<std::uint8_t>& blocks) {
    std::vector<float> values(static_cast<std::size_t>(height * width * channels_of(format)));
    decode_blocks_cpu(format, height, width, blocks.data(), values.data());
    return values;
}

// The root of the mean squared error of some channels, in 255ths.
double error_of(const std::vector<float>& a, const std::vector<float>& b, int channels, int from, int to) {
    double sum = 0;
    std::size_t count = 0;
    for (std::size_t i = 0; i < a.size(); ++i) {
        const int c = static_cast<int>(i) % channels;
        if (c < from || c >= to) continue;
        const double off = 255 * (static_cast<double>(a[i]) - static_cast<double>(b[i]));
        sum += off * off;
        ++count;
    }
    return std::sqrt(sum / static_cast<double>(count));
}

// A slope in one direction, in the channels alike: every format has lines for it.
std::vector<float> slope(Index height, Index width, int channels) {
    std::vector<float> values;
    for (Index y = 0; y < height; ++y)
        for (Index x = 0; x < width; ++x)
            for (int c = 0; c < channels; ++c)
                values.push_back(0.3f + 0.002f * static_cast<float>(x + 2 * y) * (c == 1 ? -1.0f : 1.0f));
    return values;
}

std::vector<float> noise(Index height, Index width, int channels, float size) {
    std::vector<float> values;
    for (Index i = 0; i < height * width * channels; ++i) values.push_back(0.5f + size * (random_number() - 0.5f));
    return values;
}

void slopes_come_back() {
    // Steps of the slope in a block: 0.018, 4.6 of 255.
    const struct {
        BlockFormat format;
        double most;
    } cases[] = {{BlockFormat::bc1, 2.5}, {BlockFormat::bc4, 0.25}, {BlockFormat::bc5, 0.25}, {BlockFormat::bc7, 0.45}};
    for (const auto& [format, most] : cases) {
        const int channels = channels_of(format);
        const std::vector<float> values = slope(23, 30, channels);
        const std::vector<float> back = decoded(format, 23, 30, encoded(format, 23, 30, values));
        CHECK(error_of(values, back, channels, 0, std::min(channels, 3)) < most);
    }
}

void threads_and_sizes_do_not_matter() {
    for (const BlockFormat format : {BlockFormat::bc1, BlockFormat::bc4, BlockFormat::bc5, BlockFormat::bc7}) {
        const std::vector<float> values = noise(70, 90, channels_of(format), 0.4f);
        set_num_threads(1);
        const std::vector<std::uint8_t> alone = encoded(format, 70, 90, values);
        set_num_threads(3);
        CHECK(alone == encoded(format, 70, 90, values));
        // A block by itself is the block among others.
        const std::size_t row = static_cast<std::size_t>(90 * channels_of(format));
        std::vector<float> first;
        for (std::size_t y = 0; y < 4; ++y)
            first.insert(first.end(), values.begin() + static_cast<std::ptrdiff_t>(y * row),
                         values.begin() + static_cast<std::ptrdiff_t>(y * row + 4 * row / 90));
        const std::vector<std::uint8_t> block = encoded(format, 4, 4, first);
        CHECK(std::equal(block.begin(), block.end(), alone.begin()));
    }
}

// What the best two endpoints of all 65,536 leave as error.
double least_error(const float* texels) {
    double least = 1e30;
    for (int first = 0; first < 256; ++first)
        for (int second = 0; second < 256; ++second) {
            double error = 0;
            for (int i = 0; i < 16; ++i) {
                double nearest = 1e30;
                const int steps = first > second ? 7 : 5;
                for (int s = 0; s <= steps; ++s)
                    nearest = std::min(nearest, std::abs(255.0 * static_cast<double>(texels[i]) -
                                                         (first + (second - first) * static_cast<double>(s) / steps)));
                if (steps == 5) {
                    nearest = std::min(nearest, 255.0 * static_cast<double>(texels[i]));
                    nearest = std::min(nearest, 255.0 - 255.0 * static_cast<double>(texels[i]));
                }
                error += nearest * nearest;
            }
            least = std::min(least, error);
        }
    return least;
}

void ramps_are_nearly_the_best() {
    double found = 0, least = 0;
    for (const float size : {0.004f, 0.01f, 0.03f, 0.1f, 0.5f, 1.0f}) {
        std::vector<float> values = noise(4, 4, 1, size);
        if (size == 1.0f) values[3] = values[7] = 0.0f, values[12] = 1.0f;
        const double off =
            error_of(values, decoded(BlockFormat::bc4, 4, 4, encoded(BlockFormat::bc4, 4, 4, values)), 1, 0, 1);
        const double best = std::sqrt(least_error(values.data()) / 16);
        CHECK(off < 1.25 * best + 0.01);
        found += off / best;
        least += 1;
    }
    CHECK(found / least < 1.1);
}

void weights_count() {
    // Roughness and metallic that have nothing to do with each other: what counts keeps its channel.
    const std::vector<float> values = noise(64, 64, 4, 0.8f);
    std::vector<float> weights(values.size(), 0.01f);
    for (std::size_t i = 1; i < weights.size(); i += 4) weights[i] = 1.0f;
    const std::vector<float> plain = decoded(BlockFormat::bc7, 64, 64, encoded(BlockFormat::bc7, 64, 64, values));
    const std::vector<float> weighed =
        decoded(BlockFormat::bc7, 64, 64, encoded(BlockFormat::bc7, 64, 64, values, weights));
    CHECK(error_of(values, weighed, 4, 1, 2) < 0.4 * error_of(values, plain, 4, 1, 2));
}

void opaque_blocks_stay_opaque() {
    std::vector<float> values = noise(32, 32, 4, 0.9f);
    for (std::size_t i = 3; i < values.size(); i += 4) values[i] = 1.0f;
    const std::vector<float> back = decoded(BlockFormat::bc7, 32, 32, encoded(BlockFormat::bc7, 32, 32, values));
    CHECK(error_of(values, back, 4, 3, 4) == 0);
    CHECK(error_of(values, back, 4, 0, 3) > 0);
}

}  // namespace

int main() {
    slopes_come_back();
    threads_and_sizes_do_not_matter();
    ramps_are_nearly_the_best();
    weights_count();
    opaque_blocks_stay_opaque();
    return report();
}
