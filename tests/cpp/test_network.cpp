// Bakes of networks: a latent network of identities leaves a material as it is and averages its parameters, whatever
// the size; a moment network that corrects nothing leaves a constant material as it is; threads never show; and the
// passes that cards run, on a machine that is a processor, give the same to rounding.
#include <cmath>
#include <cstdint>
#include <memory>
#include <vector>

#include "check.h"
#include "core/parallel.h"
#include "network/images.h"
#include "ops/networks.h"
#include "ops/runtime.h"

using namespace mipbake;
using mipbake::network::LayerPass;

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

// (height, width, channels) stored channels of a model by its index, valid ones.
Numbers material(Index height, Index width, bool constant, int model = 0) {
    Numbers out;
    const auto share = [] { return random_number() + 0.5f; };
    for (Index i = 0; i < height * width; ++i) {
        if (constant && i > 0) {
            for (std::size_t c = 0; c < 8; ++c) out.push_back(out[c]);
            continue;
        }
        const bool gltf = model < 2;
        for (int c = 0; c < (gltf ? 4 : 6); ++c) out.push_back(share());
        if (gltf) out.push_back(0.1f + 0.8f * share());
        const float x = random_number(), y = random_number();
        out.insert(out.end(), {x, y});
        if (gltf) out.push_back(std::sqrt(1 - x * x - y * y));
        if (model == 1) out.insert(out.end(), {0.6f, 0.8f, share()});
        if (!gltf) out.insert(out.end(), {-8 * share(), -8 * share(), random_number()});
        if (model == 3) out.push_back(random_number());
    }
    return out;
}

struct Baked {
    Numbers top, half, quarter, same;
};

// The machine of network/images.h, one texel after the other. Its memory holds NaN until something is written.
class Host {
  public:
    template <class T>
    T* room(Index count) {
        const auto numbers = static_cast<std::size_t>(std::max<Index>(1, count));
        static_assert(sizeof(T) == sizeof(float), "a float and an int are as large");
        memory_.push_back(std::vector<float>(numbers, std::nanf("")));
        return reinterpret_cast<T*>(memory_.back().data());
    }
    template <class T>
    void put(T* there, const T* here, Index count) const {
        std::copy_n(here, count, there);
    }
    template <class T>
    void get(T* here, const T* there, Index count) const {
        std::copy_n(there, count, here);
    }
    void clear(float* there, Index count) const { std::fill_n(there, count, 0.0f); }

    template <class Pass>
    void each(Index planes, int rows, int columns, const Pass& pass) const {
        for (Index z = 0; z < planes; ++z)
            for (int y = 0; y < rows; ++y)
                for (int x = 0; x < columns; ++x) pass(z, y, x);
    }

    // As the kernel of csrc/cuda/network.cu, with shares of the inputs, and two texels that lie apart.
    template <int G, int taps>
    void layer(const LayerPass& pass) const {
        constexpr int most = 8, apart = 3;
        for (int block = 0; block * G < pass.outputs; ++block)
            for (int y = 0; y < pass.rows; ++y)
                for (int left = 0; left < pass.columns; left += left % apart == apart - 1 ? apart + 1 : 1) {
                    const int x[] = {left, std::min(left + apart, pass.columns - 1)};
                    float sums[2][G];
                    pass.begin(block, sums);
                    for (int first = 0; first < pass.inputs; first += most)
                        pass.add<G, taps>(pass.weight + (static_cast<Index>(block) * pass.inputs + first) * taps * G,
                                          first, std::min(most, pass.inputs - first), y, x, sums);
                    pass.end(block, y, left, sums[0]);
                    if (left + apart < pass.columns) pass.end(block, y, left + apart, sums[1]);
                }
    }

  private:
    std::vector<std::vector<float>> memory_;
};

// Level 0 by `sharp` and `plain`, box averages by 2 as level 1, by 2 again as level 2, and level 0 without a filter.
Baked bake(const NetworkArgs& network, const Numbers& stored, Index height, Index width, const Numbers& sharp,
           const Numbers& plain, const Numbers& bias, bool by_passes = false) {
    const Halved rows(height), columns(width), fewer_rows(rows.count), fewer_columns(columns.count);
    const Copied all_rows(height), all_columns(width);
    const Index channels = network_counts(network.kind, network.read, network.made).made;
    const auto level = [&](Index high, Index wide) {
        return Numbers(static_cast<std::size_t>(high * wide * channels));
    };
    Baked out = {level(height, width), level(rows.count, columns.count), level(fewer_rows.count, fewer_columns.count),
                 level(height, width)};
    // A box that is not decoded, and a level that has the same texels.
    std::vector<NetworkSink> sinks = {{-1, rows.view(), columns.view(), nullptr, nullptr},
                                      {-1, rows.view(), columns.view(), out.half.data(), bias.data()},
                                      {-1, all_rows.view(), all_columns.view(), out.same.data(), bias.data()}};
    if (fewer_rows.count > 0 && fewer_columns.count > 0)
        sinks.push_back({0, fewer_rows.view(), fewer_columns.view(), out.quarter.data(), bias.data()});
    const NetworkBakeArgs args = {stored.data(), height,         width,        true,
                                  false,         sharp.data(),   plain.data(), static_cast<int>(sharp.size() / 2),
                                  bias.data(),   out.top.data(), sinks.data(), static_cast<int>(sinks.size())};
    if (by_passes) {
        Host host;
        mipbake::network::ImageBake<Host>(host, network, args, 300).run();
        return out;
    }
    NetworkBake running(packed_network(network), args);
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
    const NetworkArgs network = {NetworkKind::latents, 0, 0, limits(), same.view(), nullptr, 0, same.view(), &last, 1};
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

// A moment network whose corrections are zero, or random ones, and a latent network.
struct Example {
    std::vector<Layer> kept;
    std::vector<NetworkLayer> encoder, decoder;
    NetworkArgs args;
    Numbers bias;

    static Example moments(bool random, int model = 0) {
        const NetworkCounts counts = network_counts(NetworkKind::moments, model, model);
        const Index growth = 5, learned = 6, wide = 33, seen = counts.features + learned + wide + counts.detail;
        const Index said = counts.outputs + (model == 0 ? 3 : 6);
        return Example(
            NetworkKind::moments, model, model,
            {Layer::random(growth, counts.inputs, 9), Layer::random(growth, counts.inputs + growth, 1),
             Layer::random(learned, counts.inputs + 2 * growth, 1), Layer::random(wide, counts.features + learned, 1),
             random ? Layer::random(said, seen, 1) : Layer::none(said, seen)});
    }
    static Example latents(int read, int made) {
        const NetworkCounts counts = network_counts(NetworkKind::latents, read, made);
        const Index first = 9, second = 20, learned = 40, wide = 17, seen = counts.inputs + first + second;
        return Example(
            NetworkKind::latents, read, made,
            {Layer::random(first, counts.inputs, 9), Layer::random(second, counts.inputs + first, 9),
             Layer::random(learned, seen, 1), Layer::random(wide, learned, 1),
             Layer::random(counts.outputs, learned + wide, 1), Layer::random(counts.inputs, counts.inputs, 1)});
    }

  private:
    Example(NetworkKind kind, int read, int made, std::vector<Layer> layers) : kept(std::move(layers)) {
        encoder = {kept[0].view(), kept[1].view()};
        decoder = {kept[3].view(), kept[4].view()};
        args = {kind, read, made, limits(), {}, encoder.data(), 2, kept[2].view(), decoder.data(), 2};
        if (kind == NetworkKind::latents) args.whiten = kept[5].view();
        bias = kept[3].bias;
        bias.insert(bias.end(), kept[4].bias.begin(), kept[4].bias.end());
    }
};

const Numbers kPlain = {0.25f, 0.5f, 0.25f};
const Numbers kSharp = {-0.025f, 0.2f, 0.65f, 0.2f, -0.025f};

void test_constant_material() {
    const Example network = Example::moments(false);
    const Numbers stored = material(21, 100, true);
    const Baked found = bake(network.args, stored, 21, 100, kSharp, kPlain, network.bias);
    CHECK(farthest(found.top, stored) < 1e-4f);
    CHECK(farthest(found.half, Numbers(stored.begin(), stored.begin() + static_cast<Index>(found.half.size()))) <
          1e-4f);
    CHECK(farthest(found.quarter, Numbers(stored.begin(), stored.begin() + static_cast<Index>(found.quarter.size()))) <
          1e-4f);
}

void test_threads() {
    const Example network = Example::moments(true);
    const Numbers stored = material(35, 203, false);
    set_num_threads(1);
    const Baked one = bake(network.args, stored, 35, 203, kSharp, kPlain, network.bias);
    set_num_threads(4);
    const Baked four = bake(network.args, stored, 35, 203, kSharp, kPlain, network.bias);
    CHECK(one.top == four.top && one.half == four.half && one.quarter == four.quarter && one.same == four.same);
    for (const float each : one.top) CHECK(std::isfinite(each));
}

// Bands of 300 texels are some rows each, and images are smaller and larger than what filters reach.
void test_passes() {
    const auto compare = [](const Example& example, Index height, Index width, const Numbers& sharp,
                            const Numbers& plain) {
        // Moment networks read gltf also where they make its anisotropic variant.
        const bool reads_less = example.args.kind == NetworkKind::moments && example.args.read == 1;
        const Numbers stored = material(height, width, false, reads_less ? 0 : example.args.read);
        const Baked here = bake(example.args, stored, height, width, sharp, plain, example.bias);
        const Baked there = bake(example.args, stored, height, width, sharp, plain, example.bias, true);
        // Directions and logarithms of lobes magnify what rounding differs by, most where texels are not filtered.
        const float most = example.args.made == 0 ? 1e-5f : 1e-3f;
        CHECK(farthest(here.top, there.top) < most && farthest(here.half, there.half) < most);
        CHECK(farthest(here.quarter, there.quarter) < most && farthest(here.same, there.same) < most);
        for (const Numbers* const each : {&there.top, &there.half, &there.quarter, &there.same})
            for (const float number : *each) CHECK(std::isfinite(number));
    };
    for (int model = 0; model < 4; ++model) {
        compare(Example::moments(true, model), 35, 67, kSharp, kPlain);
        compare(Example::latents(model, 3 - model), 35, 67, {1.0f}, {});
    }
    for (const auto& [height, width] : {std::pair<Index, Index>{4, 131}, {37, 6}, {2, 2}}) {
        compare(Example::moments(true), height, width, kSharp, kPlain);
        compare(Example::latents(0, 0), height, width, {1.0f}, {});
    }
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
    test_passes();
    test_layers_that_do_not_fit();
    return report();
}
