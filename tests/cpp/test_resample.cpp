// Resampling beside plain sums in the order that ops/resample.h promises: the same bits on every instruction set and
// for any number of threads.
#include <cstdint>
#include <vector>

#include "check.h"
#include "core/parallel.h"
#include "ops/resample.h"
#include "ops/runtime.h"

using namespace mipbake;

namespace {

using Index = std::int64_t;

std::uint32_t state = 1;

double random_number() {
    state = state * 1664525u + 1013904223u;
    return static_cast<double>(state >> 8) / (1 << 24) - 0.5;
}

// Random taps of one axis.
template <class T>
struct Axis {
    std::vector<Index> index;
    std::vector<T> weights;
    Index count, taps;

    Axis(Index size, Index count, Index taps) : count(count), taps(taps) {
        for (Index i = 0; i < count * taps; ++i) {
            index.push_back(static_cast<Index>((random_number() + 0.5) * static_cast<double>(size)));
            weights.push_back(static_cast<T>(random_number()));
        }
    }

    ResampleAxis<T> view() const { return {index.data(), weights.data(), count, taps}; }
};

// A product and a sum that the compiler cannot contract.
template <class T>
T add_product(T sum, T a, T b) {
    const volatile T product = a * b;
    return sum + product;
}

template <class T>
void agrees(Index height, Index width, Index channels, Index row_taps, Index column_taps) {
    const Axis<T> rows(height, height / 2 + 1, row_taps), columns(width, width / 2 + 1, column_taps);
    const Index stride = width * channels + 3;
    std::vector<T> image;
    for (Index i = 0; i < height * stride; ++i) image.push_back(static_cast<T>(random_number()));
    std::vector<T> expected;
    for (Index r = 0; r < rows.count; ++r)
        for (Index x = 0; x < columns.count; ++x)
            for (Index c = 0; c < channels; ++c) {
                const auto combined = [&](Index column) {
                    const auto at = [&](Index t) {
                        return image[static_cast<std::size_t>(
                            rows.index[static_cast<std::size_t>(r * row_taps + t)] * stride + column * channels + c)];
                    };
                    if (row_taps == 1) return at(0);
                    T sum(0);
                    for (Index t = 0; t < row_taps; ++t)
                        sum = add_product(sum, at(t), rows.weights[static_cast<std::size_t>(r * row_taps + t)]);
                    return sum;
                };
                const auto tap = static_cast<std::size_t>(x * column_taps);
                T sum(0);
                for (std::size_t t = 0; t < static_cast<std::size_t>(column_taps); ++t)
                    sum = add_product(sum, combined(columns.index[tap + t]), columns.weights[tap + t]);
                expected.push_back(column_taps == 1 ? combined(columns.index[tap]) : sum);
            }
    for (const int threads : {1, 3}) {
        set_num_threads(threads);
        std::vector<T> out(expected.size() + 1, T(7));
        resample_cpu<T>({image.data(), stride, width, channels, rows.view(), columns.view()}, out.data());
        CHECK(out.back() == T(7));  // nothing behind the end is written
        out.pop_back();
        CHECK(out == expected);
    }
}

template <class T>
void every_shape() {
    for (const Index channels : {1, 2, 3, 4, 8, 9, 14, 16, 17, 35})
        for (const Index row_taps : {1, 2, 5})
            for (const Index column_taps : {1, 2, 5}) {
                agrees<T>(1, 1, channels, row_taps, column_taps);
                agrees<T>(7, 13, channels, row_taps, column_taps);
            }
    agrees<T>(64, 301, 3, 4, 4);
}

}  // namespace

int main() {
    every_shape<float>();
    every_shape<double>();
    return report();
}
