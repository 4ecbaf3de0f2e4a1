// Stochastic gradients without Python: signs beside the generator's own text, values worked out by hand, and the same
// bits for any number of threads.
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "check.h"
#include "core/parallel.h"
#include "ops/stochastic.h"

using namespace mipbake;

namespace {

using Index = std::int64_t;
using Vector = std::vector<double>;
using Ints = std::vector<std::int32_t>;

constexpr double infinity = std::numeric_limits<double>::infinity();

// A small linear congruential generator (Numerical Recipes): uniform in [0, 1).
std::uint32_t state = 1;
double random_number() {
    state = state * 1664525u + 1013904223u;
    return (state >> 8) / 16777216.0;
}
Vector random_vector(Index size) {
    Vector out(static_cast<std::size_t>(size));
    for (double& each : out) each = random_number();
    return out;
}

// pcg3d of Jarzynski and Olano 2020, in 64 bits modulo 2^32; the sign is the uppermost bit of its first number.
double sign(std::uint64_t x, std::uint64_t y, std::uint64_t z) {
    const auto word = [](std::uint64_t v) { return v & 0xffffffffu; };
    for (std::uint64_t* v : {&x, &y, &z}) *v = word(*v * 1664525u + 1013904223u);
    x = word(x + word(y * z));
    y = word(y + word(z * x));
    z = word(z + word(x * y));
    for (std::uint64_t* v : {&x, &y, &z}) *v ^= *v >> 16;
    return word(x + word(y * z)) >> 31 ? 1 : -1;
}

struct Channels {
    Vector magnitude, low, high;
    int lifted = -1;

    ElementChannels<double> view() const {
        return {static_cast<int>(magnitude.size()), lifted, magnitude.data(), low.data(), high.data()};
    }
};

struct Sides {
    Vector plus, minus;
};

Sides perturbed(const Vector& values, const Channels& channels, SignKey key, const Ints* listed = nullptr) {
    Sides sides{values, values};
    const Index all = static_cast<Index>(values.size() / channels.magnitude.size());
    const ElementList list{listed != nullptr ? listed->data() : nullptr,
                           listed != nullptr ? static_cast<Index>(listed->size()) : all};
    perturb_cpu<double>({values.data(), channels.view(), list, key, sides.plus.data(), sides.minus.data()});
    return sides;
}

void test_signs() {
    const Channels free{{1, 1}, {-infinity, -infinity}, {infinity, infinity}};
    for (const SignKey key : {SignKey{0, 0}, SignKey{5, 0}, SignKey{0, 5}, SignKey{0xffffffffu, 0x80000001u}}) {
        const Sides sides = perturbed(Vector(5000), free, key);
        bool equal = true;
        for (std::size_t i = 0; i < sides.plus.size(); ++i)
            equal = equal && sides.plus[i] == sign(i, key.step, key.seed) && sides.minus[i] == -sides.plus[i];
        CHECK(equal);
    }
}

void test_perturbing_by_hand() {
    // Too near to both limits, in the middle, beyond a limit, and a channel that stays.
    const Channels channels{{0.25, 0.25, 0.25, 0}, {0, 0, 0, 0}, {1, 1, 1, 1}};
    const Vector values = {0.125, 0.5, 3, 7};
    const Sides sides = perturbed(values, channels, {1, 2});
    const Vector middle = {0.25, 0.5, 0.75, 7};
    for (std::size_t c = 0; c < 4; ++c) {
        CHECK(sides.plus[c] == middle[c] + sign(c, 1, 2) * channels.magnitude[c]);
        CHECK(sides.minus[c] == middle[c] - sign(c, 1, 2) * channels.magnitude[c]);
    }

    // Listed elements alone, with the signs that they have in the whole.
    const Vector many = random_vector(40);
    const Ints listed = {7, 2};
    const Sides some = perturbed(many, channels, {3, 4}, &listed), whole = perturbed(many, channels, {3, 4});
    for (std::size_t i = 0; i < many.size(); ++i) {
        const bool is_listed = i / 4 == 7 || i / 4 == 2;
        CHECK(some.plus[i] == (is_listed ? whole.plus[i] : many[i]));
        CHECK(some.minus[i] == (is_listed ? whole.minus[i] : many[i]));
    }

    // Rounding does not carry anything beyond a limit.
    bool within = true;
    for (int i = 0; i < 20000; ++i) {
        const double low = random_number() - 0.5, high = low + random_number();
        const Channels narrow{{0.499 * (high - low) * random_number()}, {low}, {high}};
        const Sides both = perturbed({low + (high - low) * random_number()}, narrow, {0, 0});
        for (const double side : {both.plus[0], both.minus[0]}) within = within && side >= low && side <= high;
    }
    CHECK(within);
}

void test_lifting() {
    const Channels channels{{0.1, 0.1, 0}, {0, 0, 0}, {1, 1, 1}, 0};
    const Sides sides = perturbed(random_vector(3000), channels, {0, 0});
    double worst = 0, lowest = 1;
    for (const Vector* side : {&sides.plus, &sides.minus})
        for (std::size_t i = 0; i < side->size(); i += 3) {
            double square = 0;
            for (std::size_t c = i; c < i + 3; ++c) square += (2 * (*side)[c] - 1) * (2 * (*side)[c] - 1);
            worst = std::fmax(worst, std::fabs(square - 1));
            lowest = std::fmin(lowest, (*side)[i + 2]);
        }
    CHECK(worst < 1e-14);
    CHECK(lowest >= 0.5);
}

void test_differences_by_hand() {
    const Vector plus = {1, 2, 3, 4}, minus = {1, 1, 5, 4}, reference = {0, 0, 4, 2}, weights = {2, -1};
    Vector out(2);
    differences_cpu<double>(plus.data(), minus.data(), reference.data(), nullptr, 2, 2, out.data());
    CHECK(out == Vector({3, 0}));  // (1 + 4) - (1 + 1), and (1 + 4) - (1 + 4)
    differences_cpu<double>(plus.data(), minus.data(), reference.data(), weights.data(), 2, 2, out.data());
    CHECK(out == Vector({6, 0}));
}

void test_contributions_by_hand() {
    const Ints touched = {2, 0, 2, -1, -1, -1, 0, 2, 0};  // three pixels
    Ints counts(4), pixels(4);
    count_contributions_cpu(touched.data(), 3, 3, 4, counts.data());
    CHECK(counts == Ints({2, 0, 2, 0}));
    std::vector<Index> cursors = {0, 2, 2, 4};
    fill_contributions_cpu(touched.data(), 3, 3, 4, cursors.data(), pixels.data());
    CHECK(pixels == Ints({0, 2, 0, 2}));
    CHECK(cursors == std::vector<Index>({2, 2, 4, 4}));
}

void test_gradients() {
    const Vector magnitude = {0.5, 0, 0.25}, differences = {1, 10, 100};
    const std::vector<Index> starts = {0, 2, 3};
    const Ints pixels = {0, 2, 1}, listed = {4, 1};
    Vector gradient(15, 1);
    gradient_cpu<double>({differences.data(),
                          3,
                          starts.data(),
                          pixels.data(),
                          {listed.data(), 2},
                          {3, -1, magnitude.data(), nullptr, nullptr},
                          {6, 7},
                          gradient.data()});
    Vector expected(15, 1);
    expected[12] += 101 * sign(12, 6, 7);  // over 2 * 0.5
    expected[14] += 202 * sign(14, 6, 7);
    expected[3] += 10 * sign(3, 6, 7);
    expected[5] += 20 * sign(5, 6, 7);
    CHECK(gradient == expected);
}

void test_adam() {
    // The first step is the rate against the gradient's sign, the second along the moments as Kingma and Ba have them.
    const Channels rates{{0.5, 0.5, 0}, {-1, -10, -10}, {1, 10, 10}};
    Vector values = {0.75, 2, 3, 9, 9, 9}, gradient = {-4, 0.01, 5, 7, 7, 7}, first(6), second(6);
    Ints steps(2);
    const Ints listed = {0};
    const auto step = [&] {
        adam_cpu<double>({values.data(),
                          gradient.data(),
                          first.data(),
                          second.data(),
                          steps.data(),
                          rates.view(),
                          {listed.data(), 1},
                          0.9,
                          0.99,
                          1e-30});
    };
    step();
    CHECK(values[0] == 1);  // the limit
    CHECK(std::fabs(values[1] - 1.5) < 1e-14 && values[2] == 3);
    CHECK(gradient == Vector({0, 0, 0, 7, 7, 7}));
    CHECK(steps == Ints({1, 0}) && first[3] == 0 && second[3] == 0 && values[3] == 9);
    gradient[1] = -0.02;
    step();
    const double m = (0.9 * 0.1 * 0.01 + 0.1 * -0.02) / (1 - 0.81);
    const double v = (0.99 * 0.01 * 1e-4 + 0.01 * 4e-4) / (1 - 0.9801);
    CHECK(std::fabs(values[1] - (1.5 - 0.5 * m / std::sqrt(v))) < 1e-13);
    CHECK(steps == Ints({2, 0}));
}

Ints touched(std::vector<float> uv, std::vector<float> lod, Filter filter, Boundary boundary, int most,
             const std::vector<float>& uv_da = {}) {
    TouchedArgs args{};
    const int sizes[] = {4, 2, 1};
    args.level_count = 3;
    for (int l = 0; l < 3; ++l) args.heights[l] = args.widths[l] = sizes[l];
    args.points = static_cast<Index>(uv.size() / 2);
    args.uv = uv.data();
    args.lod = lod.empty() ? nullptr : lod.data();
    args.uv_da = uv_da.empty() ? nullptr : uv_da.data();
    args.filter = filter;
    args.boundary_u = args.boundary_v = boundary;
    args.most = most;
    Ints out(uv.size() / 2 * static_cast<std::size_t>(most));
    touched_cpu(args, out.data());
    return out;
}

void test_touched_by_hand() {
    constexpr Filter trilinear = Filter::linear_mipmap_linear;
    const float none = std::nanf("");
    // A texel's centre of level 0; between the levels 1 and 2, at a centre of both; between four texels, around a
    // corner.
    CHECK(touched({0.375f, 0.125f}, {0}, trilinear, Boundary::wrap, 8) == Ints({1, -1, -1, -1, -1, -1, -1, -1}));
    CHECK(touched({0.25f, 0.75f}, {1.5f}, trilinear, Boundary::wrap, 8) == Ints({18, 20, -1, -1, -1, -1, -1, -1}));
    CHECK(touched({0, 0}, {0}, trilinear, Boundary::wrap, 8) == Ints({15, 12, 3, 0, -1, -1, -1, -1}));
    CHECK(touched({0, 0}, {0}, trilinear, Boundary::clamp, 8) == Ints({0, -1, -1, -1, -1, -1, -1, -1}));
    CHECK(touched({0, 0}, {0}, trilinear, Boundary::zero, 8) == Ints({0, -1, -1, -1, -1, -1, -1, -1}));
    CHECK(touched({-3, 0.5f}, {0}, trilinear, Boundary::zero, 8) == Ints(8, -1));
    // The level that is nearest, halves rounded up.
    CHECK(touched({0.3f, 0.9f, 0.3f, 0.9f}, {0.4f, 0.5f}, Filter::nearest, Boundary::wrap, 1) == Ints({13, 18}));
    // No place, and no level.
    CHECK(touched({none, 0.5f, 0.5f, none}, {0, 0}, trilinear, Boundary::wrap, 8) == Ints(16, -1));
    CHECK(touched({HUGE_VALF, 0.5f}, {0}, trilinear, Boundary::wrap, 8) == Ints(8, -1));
    CHECK(touched({0.5f, 0.5f}, {none}, trilinear, Boundary::wrap, 8) == Ints(8, -1));
    CHECK(touched({0.5f, 0.5f}, {none}, Filter::nearest, Boundary::wrap, 1) == Ints({-1}));
    // A footprint of 4 texels by 1 texel: lookups at the centres of a whole row of level 0.
    const std::vector<float> wide = {1, 0, 0, 0.25f};
    Ints row = touched({0.5f, 0.375f}, {}, Filter::anisotropic, Boundary::clamp, 128, wide);
    CHECK(row[0] == 4 && row[1] == 5 && row[2] == 6 && row[3] == 7 && row[4] == -1 && row[127] == -1);
    CHECK(touched({0.5f, 0.375f}, {}, trilinear, Boundary::clamp, 8, wide) == Ints({20, -1, -1, -1, -1, -1, -1, -1}));
}

// All kernels, on enough elements and pixels for several threads.
Vector everything() {
    state = 1;
    const Channels channels{{0.1, 0.1, 0, 0.3}, {0, 0, 0, 0}, {1, 1, 1, 1}, 0};
    const Index elements = 9001, count = 20011;
    Vector values = random_vector(4 * elements);
    const Sides sides = perturbed(values, channels, {1, 2});
    const Vector a = random_vector(3 * count), b = random_vector(3 * count), r = random_vector(3 * count);
    Vector differences(static_cast<std::size_t>(count)), gradient(values.size());
    differences_cpu<double>(a.data(), b.data(), r.data(), nullptr, count, 3, differences.data());
    Ints named, counts(elements), pixels(static_cast<std::size_t>(count)), all;
    for (Index i = 0; i < count; ++i) named.push_back(static_cast<std::int32_t>(random_number() * elements));
    count_contributions_cpu(named.data(), count, 1, elements, counts.data());
    std::vector<Index> starts = {0};
    for (Index e = 0; e < elements; ++e) {
        all.push_back(static_cast<std::int32_t>(e));
        starts.push_back(starts.back() + counts[static_cast<std::size_t>(e)]);
    }
    std::vector<Index> cursors(starts.begin(), starts.end() - 1);
    fill_contributions_cpu(named.data(), count, 1, elements, cursors.data(), pixels.data());
    CHECK(cursors == std::vector<Index>(starts.begin() + 1, starts.end()));
    gradient_cpu<double>({differences.data(),
                          count,
                          starts.data(),
                          pixels.data(),
                          {all.data(), elements},
                          channels.view(),
                          {1, 2},
                          gradient.data()});
    Vector first(values.size()), second(values.size()), out = gradient;
    Ints steps(elements);
    adam_cpu<double>({values.data(),
                      gradient.data(),
                      first.data(),
                      second.data(),
                      steps.data(),
                      channels.view(),
                      {nullptr, elements},
                      0.9,
                      0.999,
                      1e-30});
    for (const Vector& each : {sides.plus, sides.minus, differences, values, first, second})
        out.insert(out.end(), each.begin(), each.end());
    std::vector<float> uv, uv_da;
    for (Index i = 0; i < 4 * count; ++i) {
        if (i < 2 * count) uv.push_back(static_cast<float>(3 * random_number() - 1));
        uv_da.push_back(static_cast<float>(random_number() - 0.5));
    }
    for (const std::int32_t texel : touched(uv, {}, Filter::anisotropic, Boundary::mirror, 128, uv_da))
        out.push_back(texel);
    return out;
}

void test_threads() {
    set_num_threads(1);
    const Vector expected = everything();
    for (const int count : {2, 3, 5}) {
        set_num_threads(count);
        CHECK(everything() == expected);
    }
}

}  // namespace

int main() {
    test_signs();
    test_perturbing_by_hand();
    test_lifting();
    test_differences_by_hand();
    test_contributions_by_hand();
    test_gradients();
    test_adam();
    test_touched_by_hand();
    test_threads();
    return report();
}
