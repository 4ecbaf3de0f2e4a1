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

template <class P>
void exponential_is_exact() {
#ifdef MIPBAKE_VECTORS
    double worst = 0;
    for (double x = -700; x <= 700; x += 0.173) {
        double lanes[P::lanes];
        exponential(P(x)).store(lanes);
        for (const double e : lanes) worst = std::max(worst, std::abs(e / std::exp(x) - 1));
    }
    CHECK(worst < 4.5e-16);
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
        }
}

}  // namespace

int main() {
    every_index_once();
    nested_and_concurrent();
    exponential_is_exact<Lanes<float>::Wide>();
    triples_are_interleaved<float>();
    triples_are_interleaved<double>();
    duals_are_derivatives();
    return report();
}
