// The sampler without Python: values worked out by hand, strides, and that backward is the adjoint of forward.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <utility>
#include <vector>

#include "ops.h"

namespace {

int failures = 0;

void check(bool condition, const char* what) {
    if (condition) return;
    std::fprintf(stderr, "failed: %s\n", what);
    ++failures;
}

// A small linear congruential generator (Numerical Recipes): uniform in [0, 1).
class Random {
  public:
    double next() {
        state_ = state_ * 1664525u + 1013904223u;
        return (state_ >> 8) / 16777216.0;
    }

  private:
    std::uint32_t state_ = 1;
};

std::vector<double> random_vector(Random& random, std::size_t size, double low, double high) {
    std::vector<double> values(size);
    for (double& value : values) value = low + (high - low) * random.next();
    return values;
}

// A contiguous stack over `texels`, level by level, with `points` lookups in each of `batch` items.
mipbake::SampleArgs<double> stack_of(const std::vector<std::vector<double>>& texels,
                                     const std::vector<std::pair<int, int>>& sizes, int channels, std::int64_t batch,
                                     std::int64_t points, const double* uv, const double* lod) {
    mipbake::SampleArgs<double> args{};
    args.level_count = static_cast<int>(sizes.size());
    args.channels = channels;
    args.wrap_u = true;
    args.batch = batch;
    args.points = points;
    args.uv = uv;
    args.uv_batch_stride = 2 * points;
    args.uv_point_stride = 2;
    args.lod = lod;
    args.lod_batch_stride = points;
    args.lod_point_stride = 1;
    for (std::size_t l = 0; l < sizes.size(); ++l) {
        const auto [height, width] = sizes[l];
        const std::int64_t row = std::int64_t(width) * channels;
        args.levels[l] = {texels[l].data(), batch > 1 ? height * row : 0, row, channels, height, width};
    }
    return args;
}

void test_by_hand() {
    const std::vector<std::vector<double>> texels(1, {1, 2, 3, 5});  // rows (1, 2) and (3, 5)
    const std::vector<double> uv = {0.25, 0.25, 0.5, 0.25, 0.5, 0.5, 0.0, 0.25, -1.0, 7.75};
    const std::vector<double> lod(5, 0.0);
    auto args = stack_of(texels, {{2, 2}}, 1, 1, 5, uv.data(), lod.data());
    std::vector<double> out(5);
    mipbake::sample_cpu(args, out.data());
    const double wrapped[] = {1, 1.5, 2.75, 1.5, 4};  // v = 7.75 is clamped to the second row
    for (int i = 0; i < 5; ++i) check(out[i] == wrapped[i], "bilinear lookups in 2 x 2 texels");
    // The same texture, its rows read from the last to the first.
    args.levels[0].texels = texels[0].data() + 2;
    args.levels[0].row_stride = -2;
    mipbake::sample_cpu(args, out.data());
    check(out[0] == 3 && out[1] == 4 && out[4] == 1.5, "a negative row stride flips the texture");
}

// <forward(texels), g> is linear in the texels, so it equals <texels, backward(g)>; for 1 and for 3 threads, with the
// same bits.
void test_adjoint(std::int64_t batch, std::int64_t points, const std::vector<std::pair<int, int>>& sizes) {
    constexpr int channels = 4;
    Random random;
    std::vector<std::vector<double>> texels, grads[2];
    for (const auto& [height, width] : sizes) {
        const std::size_t size = static_cast<std::size_t>(batch) * height * width * channels;
        texels.push_back(random_vector(random, size, -1, 1));
        for (auto& grad : grads) grad.emplace_back(size, std::nan(""));  // backward overwrites it
    }
    const std::size_t lookups = static_cast<std::size_t>(batch * points);
    const std::vector<double> uv = random_vector(random, 2 * lookups, -2, 3);
    const std::vector<double> lod = random_vector(random, lookups, -0.5, double(sizes.size()) - 0.5);
    const std::vector<double> g = random_vector(random, lookups * channels, -1, 1);
    const auto args = stack_of(texels, sizes, channels, batch, points, uv.data(), lod.data());
    std::vector<double> out(lookups * channels);
    mipbake::sample_cpu(args, out.data());
    double forward = 0;
    for (std::size_t i = 0; i < out.size(); ++i) forward += out[i] * g[i];
    for (int run = 0; run < 2; ++run) {
        mipbake::set_num_threads(run == 0 ? 1 : 3);
        mipbake::SampleGrads<double> wanted{};
        wanted.out = g.data();
        wanted.level_batch = batch;
        for (std::size_t l = 0; l < sizes.size(); ++l) wanted.levels[l] = grads[run][l].data();
        mipbake::sample_backward_cpu(args, wanted);
        double backward = 0;
        for (std::size_t l = 0; l < sizes.size(); ++l)
            for (std::size_t i = 0; i < texels[l].size(); ++i) backward += texels[l][i] * grads[run][l][i];
        check(std::abs(forward - backward) < 1e-9 * lookups, "backward is the adjoint of forward");
    }
    check(grads[0] == grads[1], "gradients do not depend on the number of threads");
}

}  // namespace

int main() {
    test_by_hand();
    test_adjoint(2, 300, {{7, 5}, {3, 2}, {1, 1}});
    test_adjoint(1, 9000, {{7, 5}, {3, 2}, {1, 1}});
    test_adjoint(2, 9000, {{150, 170}, {75, 85}});
    return failures == 0 ? 0 : 1;
}
