// The parallel loop, packets and dual numbers.
#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <thread>
#include <vector>

#include "check.h"
#include "core/dual.h"
#include "core/packet.h"
#include "core/packet_series.h"
#include "core/parallel.h"

using namespace mipbake;

namespace {

void every_index_once() {
    for (const int threads : {1, 2, 5})
        for (const std::int64_t n : {0, 1, 7, 1000})
            for (const std::int64_t grain : {1, 3, 64, 5000}) {
                set_num_threads(threads);
                std::vector<std::atomic<int>> hits(static_cast<std::size_t>(n));
                std::atomic<bool> aligned{true};
                parallel_for(n, grain, [&](std::int64_t begin, std::int64_t end) {
                    if (begin % grain != 0 || end != std::min(n, begin + grain)) aligned = false;
                    for (std::int64_t i = begin; i < end; ++i) ++hits[static_cast<std::size_t>(i)];
                });
                CHECK(aligned);
                for (const auto& hit : hits) CHECK(hit == 1);
            }
}

// Loops inside loops, and loops from several threads at once.
void nested_and_concurrent() {
    set_num_threads(4);
    std::atomic<int> total{0};
    const auto work = [&] {
        for (int repeat = 0; repeat < 50; ++repeat)
            parallel_for(10, 1, [&](std::int64_t, std::int64_t) {
                parallel_for(10, 2,
                             [&](std::int64_t begin, std::int64_t end) { total += static_cast<int>(end - begin); });
            });
    };
    std::vector<std::thread> callers;
    for (int i = 0; i < 3; ++i) callers.emplace_back(work);
    for (std::thread& caller : callers) caller.join();
    CHECK(total == 3 * 50 * 100);
}

#ifdef MIPBAKE_VECTORS
// The largest of error(value, x) over lanes and x.
template <class P, class F, class E>
double worst(double first, double last, double step, F f, E error) {
    double most = 0;
    for (double x = first; x <= last; x += step) {
        typename P::Scalar lanes[P::lanes];
        f(x).store(lanes);
        for (const double value : lanes) most = std::max(most, error(value, x));
    }
    return most;
}
double of_exponential(double value, double x) { return std::abs(value / std::exp(x) - 1); }
double of_logarithm(double value, double k) {
    const double exact = std::log(std::exp(k));
    return std::abs(value - exact) / std::max(std::abs(exact), 1.0);
}
#endif

// What the packets of kernels in S make of e^x and ln x, against the C library.
template <class S>
void powers_are_exact() {
#ifdef MIPBAKE_VECTORS
    using W = typename Lanes<S>::Wide;
    using T = typename Lanes<S>::Real;
    constexpr bool narrow = sizeof(S) == 4;
    const double reach = narrow ? 87 : 700;
    CHECK((worst<W>(-700, 700, 0.173, [](double x) { return exponential(W(x)); }, of_exponential) < 4.5e-16));
    // Every binade and its ends; sqrt(1/2), where the mantissa is split, from both sides.
    const auto logarithm_of = [](double k) { return logarithm(W(std::exp(k))); };
    CHECK((worst<W>(-700, 700, 0.0731, logarithm_of, of_logarithm) < 4.5e-16));
    for (const double x : {1.0, 2.0, 0.5, std::sqrt(0.5), std::nextafter(std::sqrt(0.5), 0.0), 1 + 1e-15, 1e-300}) {
        double lanes[W::lanes];
        logarithm(W(x)).store(lanes);
        CHECK(std::abs(lanes[0] - std::log(x)) <= 3e-16 * std::max(std::abs(std::log(x)), std::abs(x - 1)));
    }
    const double tolerance = narrow ? 1e-11 : 4.5e-16;
    CHECK((worst<W>(-700, 700, 0.173, [](double x) { return exponential_for<T>(W(x)); }, of_exponential) < tolerance));
    const auto cheap_logarithm = [](double k) { return logarithm_for<T>(W(std::exp(k))); };
    CHECK((worst<W>(-700, 700, 0.0731, cheap_logarithm, of_logarithm) < tolerance));
    const double rounding = narrow ? 1.5e-7 : 4.5e-16;
    const auto from_wide = [](double x) { return narrow_exponential<T>(W(x)); };
    CHECK((worst<T>(-reach, reach, 0.0173, from_wide, of_exponential) < rounding));
    const auto in_narrow = [](double x) { return exponential(T(static_cast<S>(x))); };
    const auto of_narrow = [](double v, double x) { return of_exponential(v, static_cast<double>(S(x))); };
    CHECK((worst<T>(-reach, reach, 0.0173, in_narrow, of_narrow) < rounding));
#endif
}

template <class T>
void triples_are_interleaved() {
    using P = typename Lanes<T>::Real;
    constexpr int n = Lanes<T>::count;
    T data[3 * n], out[3 * n];
    for (int i = 0; i < 3 * n; ++i) data[i] = static_cast<T>(i);
    const Vec3<P> planes = load_interleaved(data, P());
    T y[n];
    store_lanes(y, planes.y);
    for (int i = 0; i < n; ++i) CHECK(y[i] == 3 * i + 1);
    store_interleaved(out, planes);
    for (int i = 0; i < 3 * n; ++i) CHECK(out[i] == data[i]);
}

template <class T>
T formula(const T& x, const T& y) {
    const T root = square_root(x * x + 2.0 * y + 1.0);
    return exponential(-(x / root)) + clamp(3.0 - y, 0, 2.5) / x - select(x > y, x * 0.5, y * (1 - x)) + larger(x, y);
}

void duals_are_derivatives() {
    using D = Dual<double, 2>;
    const double h = 1e-6;
    for (const double x : {0.3, 1.7})
        for (const double y : {0.4, 1.1}) {
            const D f = formula(D::input(x, 0), D::input(y, 1));
            CHECK(f.v == formula(x, y));
            CHECK(std::abs(f.d[0] - (formula(x + h, y) - formula(x - h, y)) / (2 * h)) < 1e-7);
            CHECK(std::abs(f.d[1] - (formula(x, y + h) - formula(x, y - h)) / (2 * h)) < 1e-7);
            const D log = logarithm(D::input(x, 0) * D::input(y, 1));
            CHECK(std::abs(log.v - std::log(x * y)) < 1e-15);
            CHECK(std::abs(log.d[0] - 1 / x) < 1e-15 && std::abs(log.d[1] - 1 / y) < 1e-15);
        }
}

// A model without an adjoint of its own is differentiated so: directions of each texel are packets that are constants.
void duals_take_packets_that_are_constants() {
#ifdef MIPBAKE_VECTORS
    using P = typename Lanes<double>::Real;
    using D = Dual<P, 1>;
    double values[P::lanes], found[P::lanes], slopes[P::lanes];
    for (int i = 0; i < P::lanes; ++i) values[i] = 0.5 + i;
    const P constant = P::load(values);
    const D x = D::input(P(2.0), 0);
    const D f = x * x * constant + constant;
    f.v.store(found);
    P(f.d[0]).store(slopes);
    for (int i = 0; i < P::lanes; ++i) CHECK(found[i] == 5 * values[i] && slopes[i] == 4 * values[i]);
#endif
}

}  // namespace

int main() {
    every_index_once();
    nested_and_concurrent();
    powers_are_exact<float>();
    powers_are_exact<double>();
    triples_are_interleaved<float>();
    triples_are_interleaved<double>();
    duals_are_derivatives();
    duals_take_packets_that_are_constants();
    return report();
}
