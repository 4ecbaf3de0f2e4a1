// Bakes of networks: a latent network of identities leaves a material as it is and averages its parameters, whatever
// the size; a moment network that corrects nothing leaves a constant material as it is; threads never show.
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "check.h"
#include "core/parallel.h"
#include "ops.h"

using namespace mipbake;

namespace {

using Index = std::int64_t;
using Numbers = std::vector<float>;

std::uint32_t state = 7;

float random_number() {
    state = state * 1664525u + 1013904223u;
    return static_cast<float>(state >> 8) / (1 << 24) - 0.5f;
}

Numbers random_numbers(Index count, float scale) {
    Numbers out;
    for (Index i = 0; i < count; ++i) out.push_back(scale * random_number());
    return out;
}

// A layer with its memory.
struct Layer {
    Numbers weight, bias;
    Index outputs, inputs;
    int taps = 1;

    NetworkLayer view() const { return {weight.data(), bias.data(), outputs, inputs, taps}; }

    static Layer random(Index outputs, Index inputs, int taps) {
        const float scale = 1 / std::sqrt(static_cast<float>(inputs * taps));
        return {random_numbers(outputs * inputs * taps, 2 * scale), random_numbers(outputs, 0.2f), outputs, inputs,
                taps};
    }
    static Layer identity(Index size) {
        Layer out = {Numbers(static_cast<std::size_t>(size * size)), Numbers(static_cast<std::size_t>(size)), size,
                     size};
        for (Index i = 0; i < size; ++i) out.weight[static_cast<std::size_t>(i * size + i)] = 1;
        return out;
    }
    static Layer none(Index outputs, Index inputs) {
        return {Numbers(static_cast<std::size_t>(outputs * inputs)), Numbers(static_cast<std::size_t>(outputs)),
                outputs, inputs};
    }
};

NetworkLimits limits() {
    const float least = 0.045f;
    return {least, 1.0f, std::log(least), 0.0f, std::pow(least, 4.0f), 1.0f};
}

// Box averages of an axis by 2, the last texel of an odd one left out.
struct Halved {
    std::vector<std::int32_t> index;
    Numbers weights;
    int count;

    explicit Halved(Index size) : count(static_cast<int>(size / 2)) {
        for (Index i = 0; i < 2 * count; ++i) {
            index.push_back(static_cast<std::int32_t>(i));
            weights.push_back(0.5f);
        }
    }
    AxisWeights view() const { return {index.data(), weights.data(), weights.data(), count, 2}; }
};

// An axis whose texels all move by one, and the first to the end.
struct Copied {
    std::vector<std::int32_t> index;
    Numbers weights;
    int count;

    explicit Copied(Index size) : weights(static_cast<std::size_t>(size), 1.0f), count(static_cast<int>(size)) {
        for (Index i = 0; i < size; ++i) index.push_back(static_cast<std::int32_t>((i + 1) % size));
    }
    AxisWeights view() const { return {index.data(), weights.data(), weights.data(), count, 1}; }
};

// (height, width, 8) stored channels of gltf, valid ones.
Numbers material(Index height, Index width, bool constant) {
    Numbers out;
    for (Index i = 0; i < height * width; ++i) {
        if (constant && i > 0) {
            for (std::size_t c = 0; c < 8; ++c) out.push_back(out[c]);
            continue;
        }
        for (int c = 0; c < 4; ++c) out.push_back(random_number() + 0.5f);
        out.push_back(0.1f + 0.8f * (random_number() + 0.5f));
        const float x = random_number(), y = random_number();
        out.insert(out.end(), {x, y, std::sqrt(1 - x * x - y * y)});
    }
    return out;
}

struct Baked {
    Numbers top, half, quarter, same;
};

// Level 0 by `sharp` and `plain`, box averages by 2 as level 1, by 2 again as level 2, and level 0 without a filter.
Baked bake(const std::shared_ptr<const Network>& network, const Numbers& stored, Index height, Index width,
           const Numbers& sharp, const Numbers& plain, const Numbers& bias) {
    const Halved rows(height), columns(width), fewer_rows(rows.count), fewer_columns(columns.count);
    const Copied all_rows(height), all_columns(width);
    Baked out = {Numbers(stored.size()), Numbers(static_cast<std::size_t>(8 * rows.count * columns.count)),
                 Numbers(static_cast<std::size_t>(8 * fewer_rows.count * fewer_columns.count)), Numbers(stored.size())};
    // A box that is not decoded, and a level that has the same texels.
    std::vector<NetworkSink> sinks = {{-1, rows.view(), columns.view(), nullptr, nullptr},
                                      {-1, rows.view(), columns.view(), out.half.data(), bias.data()},
                                      {-1, all_rows.view(), all_columns.view(), out.same.data(), bias.data()}};
    if (fewer_rows.count > 0 && fewer_columns.count > 0)
        sinks.push_back({0, fewer_rows.view(), fewer_columns.view(), out.quarter.data(), bias.data()});
    NetworkBake running(network, {stored.data(), height, width, true, false, sharp.data(), plain.data(),
                                  static_cast<int>(sharp.size() / 2), bias.data(), out.top.data(), sinks.data(),
                                  static_cast<int>(sinks.size())});
    while (running.rows_done() < height) running.advance();
    return out;
}

float farthest(const Numbers& a, const Numbers& b) {
    float most = 0;
    for (std::size_t i = 0; i < a.size(); ++i) most = std::max(most, std::fabs(a[i] - b[i]));
    return most;
}

void test_identities() {
    const NetworkCounts counts = network_counts(NetworkKind::latents, 0, 0);
    CHECK(counts.read == 8 && counts.made == 8 && counts.inputs == 7 && counts.outputs == 7);
    const Layer same = Layer::identity(7);
    const NetworkLayer last = same.view();
    const auto network =
        packed_network({NetworkKind::latents, 0, 0, limits(), same.view(), nullptr, 0, same.view(), &last, 1});
    for (const auto& [height, width] : {std::pair<Index, Index>{2, 2}, {5, 131}, {37, 9}}) {
        const Numbers stored = material(height, width, false);
        const Baked found = bake(network, stored, height, width, {1.0f}, {}, Numbers(7));
        CHECK(farthest(found.top, stored) < 2e-6f);
        for (Index y = 0; y < height; ++y)
            for (Index x = 0; x < width; ++x)
                for (Index c = 0; c < 8; ++c) {
                    const Index from = (y + 1) % height * width + (x + 1) % width;
                    CHECK(found.same[static_cast<std::size_t>(8 * (y * width + x) + c)] ==
                          found.top[static_cast<std::size_t>(8 * from + c)]);
                }
        // Colours and the logarithm of roughness are averaged, and normals lifted again.
        const Index across = width / 2;
        for (Index y = 0; y < height / 2; ++y)
            for (Index x = 0; x < across; ++x) {
                float metal = 0, log_roughness = 0;
                for (const Index at : {2 * y * width + 2 * x, 2 * y * width + 2 * x + 1, (2 * y + 1) * width + 2 * x,
                                       (2 * y + 1) * width + 2 * x + 1}) {
                    metal += stored[static_cast<std::size_t>(8 * at + 3)] / 4;
                    log_roughness += std::log(stored[static_cast<std::size_t>(8 * at + 4)]) / 4;
                }
                const std::size_t here = static_cast<std::size_t>(8 * (y * across + x));
                CHECK(std::fabs(found.half[here + 3] - metal) < 1e-6f);
                CHECK(std::fabs(found.half[here + 4] - std::exp(log_roughness)) < 2e-6f);
                const float *const n = found.half.data() + here + 5, length = n[0] * n[0] + n[1] * n[1] + n[2] * n[2];
                CHECK(std::fabs(length - 1) < 1e-5f);
            }
    }
}

// A moment network whose corrections are zero, or random ones.
std::shared_ptr<const Network> moments(bool random, std::vector<Layer>& kept) {
    const NetworkCounts counts = network_counts(NetworkKind::moments, 0, 0);
    const Index growth = 5, learned = 6, wide = 7;
    kept = {Layer::random(growth, counts.inputs, 9), Layer::random(growth, counts.inputs + growth, 1),
            Layer::random(learned, counts.inputs + 2 * growth, 1), Layer::random(wide, counts.features + learned, 1)};
    const Index seen = counts.features + learned + wide + counts.detail;
    kept.push_back(random ? Layer::random(counts.outputs + 3, seen, 1) : Layer::none(counts.outputs + 3, seen));
    const NetworkLayer encoder[] = {kept[0].view(), kept[1].view()}, decoder[] = {kept[3].view(), kept[4].view()};
    return packed_network({NetworkKind::moments, 0, 0, limits(), {}, encoder, 2, kept[2].view(), decoder, 2});
}

const Numbers kPlain = {0.25f, 0.5f, 0.25f};
const Numbers kSharp = {-0.025f, 0.2f, 0.65f, 0.2f, -0.025f};

void test_constant_material() {
    std::vector<Layer> kept;
    const auto network = moments(false, kept);
    Numbers bias = kept[3].bias;
    bias.insert(bias.end(), kept[4].bias.begin(), kept[4].bias.end());
    const Numbers stored = material(21, 100, true);
    const Baked found = bake(network, stored, 21, 100, kSharp, kPlain, bias);
    CHECK(farthest(found.top, stored) < 1e-4f);
    CHECK(farthest(found.half, Numbers(stored.begin(), stored.begin() + static_cast<Index>(found.half.size()))) <
          1e-4f);
    CHECK(farthest(found.quarter, Numbers(stored.begin(), stored.begin() + static_cast<Index>(found.quarter.size()))) <
          1e-4f);
}

void test_threads() {
    std::vector<Layer> kept;
    const auto network = moments(true, kept);
    Numbers bias = kept[3].bias;
    bias.insert(bias.end(), kept[4].bias.begin(), kept[4].bias.end());
    const Numbers stored = material(35, 203, false);
    set_num_threads(1);
    const Baked one = bake(network, stored, 35, 203, kSharp, kPlain, bias);
    set_num_threads(4);
    const Baked four = bake(network, stored, 35, 203, kSharp, kPlain, bias);
    CHECK(one.top == four.top && one.half == four.half && one.quarter == four.quarter && one.same == four.same);
    for (const float each : one.top) CHECK(std::isfinite(each));
}

void test_layers_that_do_not_fit() {
    const Layer same = Layer::identity(7), other = Layer::identity(6);
    const NetworkLayer last = other.view();
    const NetworkArgs args = {NetworkKind::latents, 0, 0, limits(), same.view(), nullptr, 0, same.view(), &last, 1};
    CHECK(complaint([&] { packed_network(args); }) == "layers of a network do not fit");
}

}  // namespace

int main() {
    test_identities();
    test_constant_material();
    test_threads();
    test_layers_that_do_not_fit();
    return report();
}
