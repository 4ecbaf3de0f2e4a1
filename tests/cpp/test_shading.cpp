// Every model in plain numbers, as the GPU runs it (geometry in double, the lobe in float), against the CPU kernels.
#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

#include "check.h"
#include "ops/shading.h"
#include "shading/models.h"
#include "shading/prepare.h"

using namespace mipbake;

namespace {

constexpr int kPairs = 40, kTexels = 83;
constexpr TurnedAway kRule = TurnedAway::rule(false);

struct Case {
    std::vector<float> material, light, view;
};

Case random_case(int channels) {
    std::mt19937 random(1);
    std::uniform_real_distribution<float> uniform(0.05f, 0.95f);
    std::normal_distribution<float> normal;
    Case c;
    for (int i = 0; i < kTexels * channels; ++i) c.material.push_back(uniform(random));
    for (auto* directions : {&c.light, &c.view})
        for (int k = 0; k < kPairs; ++k) {
            const float x = normal(random), y = normal(random), z = normal(random);
            const float length = std::sqrt(x * x + y * y + z * z);
            for (const float w : {x, y, k % 4 == 0 ? z : std::abs(z)}) directions->push_back(w / length);
        }
    return c;
}

Vec3<float> direction(const std::vector<float>& directions, int k) {
    const std::size_t i = 3 * static_cast<std::size_t>(k);
    return {directions[i], directions[i + 1], directions[i + 2]};
}

template <class Model>
void agrees_with_the_kernels(int index) {
    constexpr int C = Model::channels;
    const Case c = random_case(C);
    const ShadeArgs args{index,
                         false,
                         1,
                         kPairs,
                         kTexels,
                         {c.material.data(), {0, C, 1}},
                         {c.light.data(), {0, 3, 1}},
                         {c.view.data(), {0, 3, 1}}};
    std::vector<float> radiance(3 * kPairs * kTexels), weights(radiance.size());
    std::vector<float> adjoint(static_cast<std::size_t>(C) * kTexels), duals(adjoint.size());
    for (std::size_t i = 0; i < weights.size(); ++i) weights[i] = std::sin(static_cast<float>(i));
    shade_cpu(args, radiance.data());
    shade_backward_cpu(args, weights.data(), adjoint.data(), false);
    shade_backward_cpu(args, weights.data(), duals.data(), true);

    double worst = 0, worst_gradient = 0, worst_duals = 0;
    int lit = 0;
    for (int n = 0; n < kTexels; ++n) {
        double channels[C];
        for (int i = 0; i < C; ++i) channels[i] = c.material[static_cast<std::size_t>(n * C + i)];
        const auto surface = Prepare<Model>::template surface<double, float>(channels);
        typename Model::template Surface<float, float> sums;
        Prepare<Model>::zip(sums, sums, [](float& a, float&) { a = 0; });
        for (int k = 0; k < kPairs; ++k) {
            const auto pair = Pair<float>::of(direction(c.light, k), direction(c.view, k), kRule);
            const Vec3<float> f = Model::evaluate(surface, pair);
            const std::size_t at = 3 * static_cast<std::size_t>(k * kTexels + n);
            Model::evaluate_adjoint(surface, pair, Vec3<float>{weights[at], weights[at + 1], weights[at + 2]}, sums);
            const float expected[3] = {f.x, f.y, f.z};
            for (std::size_t i = 0; i < 3; ++i) {
                worst = std::max(worst, std::abs(double(radiance[at + i]) - expected[i]) / (expected[i] + 1e-12));
                lit += expected[i] > 0;
            }
        }
        float gradient[C];
        Prepare<Model>::pull_back(channels, sums, gradient);
        for (int i = 0; i < C; ++i) {
            const std::size_t at = static_cast<std::size_t>(n * C + i);
            const double scale = std::abs(gradient[i]) + 1;
            worst_gradient = std::max(worst_gradient, std::abs(double(adjoint[at]) - gradient[i]) / scale);
            worst_duals = std::max(worst_duals, std::abs(double(duals[at]) - gradient[i]) / scale);
        }
    }
    std::printf("%s: radiance %.1e, gradient %.1e, duals %.1e\n", Model::name, worst, worst_gradient, worst_duals);
    CHECK(lit > kPairs * kTexels);
    CHECK(worst < 3e-6);
    CHECK(worst_gradient < 3e-5);
    CHECK(worst_duals < 3e-5);
}

// Points under many lights: the kernels against plain numbers, and those against the sum of single pairs. Frames are
// the axes of the world in another order, so that both see the same directions without rounding.
template <class Model>
void lights_agree_with_the_kernels(int index) {
    constexpr int C = Model::channels;
    const Case c = random_case(C);
    std::vector<float> frames, views, radiance, out(3 * kTexels);
    for (int n = 0; n < kTexels; ++n) {
        for (int row = 0; row < 3; ++row)
            for (int column = 0; column < 3; ++column) frames.push_back(column == (row + n) % 3 ? 1.0f : 0.0f);
        const Vec3<float> v = direction(c.view, n % kPairs);
        views.insert(views.end(), {v.x, v.y, v.z});
    }
    for (int i = 0; i < 3 * kPairs; ++i) radiance.push_back(0.5f + 0.3f * std::sin(static_cast<float>(i)));
    shade_lit_cpu({index,
                   false,
                   1,
                   kTexels,
                   kPairs,
                   c.material.data(),
                   {0, C, 1},
                   frames.data(),
                   {0, 9, 3, 1},
                   views.data(),
                   {0, 3, 1},
                   c.light.data(),
                   radiance.data()},
                  out.data());

    double worst = 0, worst_sum = 0;
    int lit = 0;
    for (int n = 0; n < kTexels; ++n) {
        double channels[C];
        for (int i = 0; i < C; ++i) channels[i] = c.material[static_cast<std::size_t>(n * C + i)];
        const auto surface = Prepare<Model>::template surface<double, float>(channels);
        const Axes<float> axes = {direction(frames, 3 * n), direction(frames, 3 * n + 1), direction(frames, 3 * n + 2)};
        const auto local = [&](const Vec3<float>& w) {
            return Vec3<float>{dot(axes.t, w), dot(axes.b, w), dot(axes.n, w)};
        };
        const auto seen = Model::template Seen<double, float>::of(surface, axes, direction(views, n), kRule);
        Vec3<float> got = {0, 0, 0};
        double sum[3] = {0, 0, 0};
        for (int k = 0; k < kPairs; ++k) {
            const Vec3<float> l = direction(c.light, k), power = direction(radiance, k);
            const Light<float> light = {{l.x, l.y, l.z}, l, power};
            const float cosine = seen.cosine(light);
            if (seen.lit(cosine)) seen.add(light, cosine, got);
            const Vec3<float> f =
                Model::evaluate(surface, Pair<float>::of(local(l), local(direction(views, n)), kRule));
            sum[0] += double(power.x) * f.x;
            sum[1] += double(power.y) * f.y;
            sum[2] += double(power.z) * f.z;
        }
        const float plain[3] = {got.x, got.y, got.z};
        for (int i = 0; i < 3; ++i) {
            const double kernel = out[static_cast<std::size_t>(3 * n + i)];
            worst = std::max(worst, std::abs(kernel - plain[i]) / (plain[i] + 1e-12));
            worst_sum = std::max(worst_sum, std::abs(kernel - sum[i]) / (sum[i] + 1e-12));
            lit += plain[i] > 0;
        }
    }
    std::printf("%s under lights: %.1e of plain numbers, %.1e of the sum of pairs\n", Model::name, worst, worst_sum);
    CHECK(lit > kTexels);
    CHECK(worst < 3e-6);
    CHECK(worst_sum < 1e-5);
}

// What `beckmann` is made of, against the C library: Gamma, its derivative, and masking.
void beckmann_agrees_with_the_library() {
    double worst = 0, worst_slope = 0;
    for (double x = 1; x <= 6; x += 0.00731) {
        worst = std::max(worst, std::abs(Beckmann::inverse_gamma_function(x) * std::tgamma(x) - 1));
        const auto dual = Beckmann::inverse_gamma_function(Dual<double, 1>::input(x, 0));
        const double h = 1e-4, slope = (std::lgamma(x + h) - std::lgamma(x - h)) / (2 * h);
        worst_slope = std::max(worst_slope, std::abs(dual.d[0] * std::tgamma(x) + slope));
    }
    CHECK(worst < 2e-14);
    CHECK(worst_slope < 1e-7);

    // G(w) = w_n erf(a) + s exp(-a^2) / sqrt(pi), from grazing to normal incidence and nearly smooth surfaces.
    double worst_float = 0, worst_double = 0, worst_erfc = 0;
    for (double log_a = -12; log_a < 12; log_a += 0.0173)
        for (const double w_n : {1e-6, 0.3, 1.0}) {
            const double a = std::exp(log_a), s = w_n / a;
            const double exact = w_n * std::erf(a) + s * std::exp(-a * a) / std::sqrt(3.14159265358979323846);
            const auto m = BeckmannMasking<double>::of(w_n, s * s);
            const auto f = BeckmannMasking<float>::of(static_cast<float>(w_n), static_cast<float>(s * s));
            worst_double = std::max(worst_double, std::abs(m.g / exact - 1));
            worst_float = std::max(worst_float, std::abs(double(f.g) / exact - 1));
            worst_erfc = std::max(worst_erfc, std::abs(m.erfc - std::erfc(a)));
        }
    std::printf("masking: %.1e in float, %.1e in double\n", worst_float, worst_double);
    CHECK(worst_float < 5e-7);
    CHECK(worst_double < 2e-14);
    CHECK(worst_erfc < 2e-14);
}

// Every exponent at the peak itself, where the slope of q^gamma is not bounded, and where the exponential is 0.
void beckmann_is_finite_at_its_ends() {
    for (const double g : {-1.5, -0.5, 0.0, 1.5})
        for (const double log_alpha2 : {-13.0, 0.0, 10.0})
            for (const Vec3<float> l : {Vec3<float>{0, 0, 1}, {0.6f, 0, 0.8f}, {1, 0, 3e-9f}, {0, 1e-20f, 1}}) {
                const double channels[12] = {0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0, 0, log_alpha2, log_alpha2, 0, g};
                const auto surface = Prepare<Beckmann>::surface<double, float>(channels);
                for (const Vec3<float> v : {Vec3<float>{0, 0, 1}, {-0.6f, 0, 0.8f}, {1, 0, 3e-9f}, {-1, 0, 3e-9f}}) {
                    const auto pair = Pair<float>::of(l, v, kRule);
                    const Vec3<float> f = Beckmann::evaluate(surface, pair);
                    CHECK(std::isfinite(f.x));
                    Beckmann::Surface<float, float> sums;
                    Prepare<Beckmann>::zip(sums, sums, [](float& a, float&) { a = 0; });
                    Beckmann::evaluate_adjoint(surface, pair, Vec3<float>{1, 1, 1}, sums);
                    float gradient[12];
                    Prepare<Beckmann>::pull_back(channels, sums, gradient);
                    for (const float each : gradient) CHECK(std::isfinite(each));
                }
            }
}

}  // namespace

int main() {
    beckmann_agrees_with_the_library();
    beckmann_is_finite_at_its_ends();
    for (int i = 0; i < Models::size; ++i)
        Models::visit(i, [&](auto model) {
            agrees_with_the_kernels<decltype(model)>(i);
            lights_agree_with_the_kernels<decltype(model)>(i);
        });
    return report();
}
