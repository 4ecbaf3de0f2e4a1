// Texture lookups without Python: values worked out by hand, strides, storage types, the seams of cubes, and that every
// backward pass is the adjoint of its forward pass.
#include <cmath>
#include <cstdint>
#include <functional>
#include <utility>
#include <vector>

#include "check.h"
#include "ops/runtime.h"
#include "ops/texture.h"
#include "sampling/cube.h"
#include "sampling/footprint.h"
#include "sampling/storage.h"

namespace {

using mipbake::Boundary;
using mipbake::Filter;
using Vector = std::vector<double>;
using Args = mipbake::TextureArgs<double>;
using Grads = mipbake::TextureGrads<double>;
using Sizes = std::vector<std::pair<int, int>>;

// A small linear congruential generator (Numerical Recipes): uniform in [0, 1).
class Random {
  public:
    double next() {
        state_ = state_ * 1664525u + 1013904223u;
        return (state_ >> 8) / 16777216.0;
    }
    Vector vector(std::size_t size, double low, double high) {
        Vector values(size);
        for (double& value : values) value = low + (high - low) * next();
        return values;
    }

  private:
    std::uint32_t state_ = 1;
};

double dot(const Vector& a, const Vector& b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
    return sum;
}

// A scene owns a stack and lookups in it. Every item has texels of its own.
struct Scene {
    Sizes sizes;
    int channels = 3;
    std::int64_t batch = 1, points = 0;
    Filter filter = Filter::linear_mipmap_linear;
    Boundary boundary_u = Boundary::wrap, boundary_v = Boundary::wrap;
    std::vector<Vector> texels;
    Vector uv, uv_da, bias;

    bool is_cube() const { return boundary_u == Boundary::cube; }
    int coordinates() const { return is_cube() ? 3 : 2; }
    std::size_t lookups() const { return static_cast<std::size_t>(batch * points); }
    std::size_t level_size(std::size_t l) const {
        return static_cast<std::size_t>(batch * (is_cube() ? 6 : 1) * sizes[l].first * sizes[l].second * channels);
    }

    void fill(Random& random) {
        for (std::size_t l = 0; l < sizes.size(); ++l) texels.push_back(random.vector(level_size(l), -1, 1));
        const std::size_t n = lookups();
        uv = is_cube() ? random.vector(3 * n, -1, 1) : random.vector(2 * n, -2, 3);
        uv_da = random.vector(n * 2 * static_cast<std::size_t>(coordinates()), -0.3, 0.3);
        bias = random.vector(n, -1, 1);
    }

    Args args() const {
        Args a{};
        a.level_count = static_cast<int>(sizes.size());
        a.channels = channels;
        a.storage = mipbake::Storage::float64;
        a.filter = filter;
        a.boundary_u = boundary_u;
        a.boundary_v = boundary_v;
        a.batch = batch;
        a.points = points;
        a.uv = uv.data();
        a.uv_point_stride = coordinates();
        a.uv_batch_stride = points * a.uv_point_stride;
        a.uv_da = uv_da.empty() ? nullptr : uv_da.data();
        a.uv_da_point_stride = 2 * coordinates();
        a.uv_da_batch_stride = points * a.uv_da_point_stride;
        a.bias = bias.empty() ? nullptr : bias.data();
        a.bias_point_stride = 1;
        a.bias_batch_stride = points;
        for (std::size_t l = 0; l < sizes.size(); ++l) {
            const auto [height, width] = sizes[l];
            const std::int64_t row = std::int64_t(width) * channels, face = is_cube() ? height * row : 0;
            const std::int64_t item = (is_cube() ? 6 : 1) * height * row;
            a.heights[l] = height;
            a.widths[l] = width;
            a.levels[l] = {texels[l].data(), batch > 1 ? item : 0, face, row, channels};
        }
        return a;
    }

    Vector look_up() const {
        Vector out(lookups() * static_cast<std::size_t>(channels));
        mipbake::texture_cpu(args(), out.data());
        return out;
    }
};

void test_by_hand() {
    Scene scene;
    scene.sizes = {{2, 2}};
    scene.channels = 1;
    scene.filter = Filter::linear;
    scene.boundary_v = Boundary::clamp;
    scene.texels = {{1, 2, 3, 5}};  // rows (1, 2) and (3, 5)
    scene.uv = {0.25, 0.25, 0.5, 0.25, 0.5, 0.5, 0.0, 0.25, -1.0, 7.75};
    scene.points = 5;
    // The last two wrap around; v = 7.75 is clamped to the second row.
    CHECK(scene.look_up() == Vector({1, 1.5, 2.75, 1.5, 4}));
    scene.boundary_u = scene.boundary_v = Boundary::zero;
    CHECK(scene.look_up() == Vector({1, 1.5, 2.75, 0.5, 0}));
    scene.boundary_u = scene.boundary_v = Boundary::mirror;
    CHECK(scene.look_up() == Vector({1, 1.5, 2.75, 1, 2}));  // (-1, 7.75) is (1, 0.25)
    scene.filter = Filter::nearest;
    CHECK(scene.look_up() == Vector({1, 2, 5, 1, 2}));

    // The same texture, its rows read from the last to the first.
    scene.filter = Filter::linear;
    scene.boundary_u = Boundary::wrap;
    scene.boundary_v = Boundary::clamp;
    Args flipped = scene.args();
    flipped.levels[0].texels = scene.texels[0].data() + 2;
    flipped.levels[0].row_stride = -2;
    Vector out(5);
    mipbake::texture_cpu(flipped, out.data());
    CHECK(out == Vector({3, 4, 2.75, 4, 1.5}));
}

// <forward(texels), g> is linear in the texels, so it equals <texels, backward(g)>; for 1 and for 3 threads, with the
// same bits.
void test_texels(Scene scene) {
    Random random;
    scene.fill(random);
    const Vector g = random.vector(scene.lookups() * static_cast<std::size_t>(scene.channels), -1, 1);
    const double forward = dot(scene.look_up(), g);
    std::vector<Vector> grads[2];
    for (int run = 0; run < 2; ++run) {
        mipbake::set_num_threads(run == 0 ? 1 : 3);
        Grads wanted{};
        wanted.out = g.data();
        for (std::size_t l = 0; l < scene.sizes.size(); ++l) {
            grads[run].emplace_back(scene.level_size(l), std::nan(""));  // backward overwrites it
            wanted.levels[l] = grads[run][l].data();
            wanted.level_batch[l] = scene.batch;
        }
        mipbake::texture_backward_cpu(scene.args(), wanted);
        double backward = 0;
        for (std::size_t l = 0; l < scene.sizes.size(); ++l) backward += dot(scene.texels[l], grads[run][l]);
        CHECK(std::abs(forward - backward) < 1e-9 * static_cast<double>(scene.lookups()));
    }
    CHECK(grads[0] == grads[1]);
}

// Slopes by central differences; a few lookups lie within a difference of a kink, at texel centres, where levels are
// clamped or where the number of taps changes.
void test_slopes(Scene scene) {
    Random random;
    scene.fill(random);
    if (!scene.is_cube())
        for (double& value : scene.uv) value = 0.3 * value;
    const std::size_t channels = static_cast<std::size_t>(scene.channels), n = scene.lookups();
    const Vector g = random.vector(n * channels, -1, 1);
    Vector uv(scene.uv.size()), uv_da(scene.uv_da.size()), bias(n);
    Grads wanted{};
    wanted.out = g.data();
    wanted.uv = uv.data();
    wanted.uv_da = uv_da.data();
    wanted.bias = bias.data();
    mipbake::texture_backward_cpu(scene.args(), wanted);
    const auto fraction_off = [&](Vector& input, const Vector& gradient) {
        constexpr double step = 1e-7;
        const std::size_t components = input.size() / n;
        std::size_t off = 0;
        for (std::size_t k = 0; k < components; ++k) {
            Vector values[2];
            for (int side = 0; side < 2; ++side) {
                const Vector saved = input;
                for (std::size_t i = 0; i < n; ++i) input[i * components + k] += side == 0 ? -step : step;
                values[side] = scene.look_up();
                input = saved;
            }
            for (std::size_t i = 0; i < n; ++i) {
                double slope = 0;
                for (std::size_t c = 0; c < channels; ++c)
                    slope += g[i * channels + c] * (values[1][i * channels + c] - values[0][i * channels + c]);
                const double expected = slope / (2 * step), error = std::abs(gradient[i * components + k] - expected);
                off += error > 1e-4 * (1 + std::abs(expected)) ? 1 : 0;
            }
        }
        return static_cast<double>(off) / static_cast<double>(input.size());
    };
    CHECK(fraction_off(scene.uv, uv) < 0.01);
    CHECK(fraction_off(scene.uv_da, uv_da) < 0.01);
    CHECK(fraction_off(scene.bias, bias) < 0.01);
    CHECK(dot(uv, uv) > 0 && dot(uv_da, uv_da) > 0 && dot(bias, bias) > 0);
}

Scene scene_of(Filter filter, Boundary boundary, std::int64_t batch, std::int64_t points, const Sizes& sizes) {
    Scene scene;
    scene.filter = filter;
    scene.boundary_u = scene.boundary_v = boundary;
    scene.batch = batch;
    scene.points = points;
    scene.sizes = sizes;
    return scene;
}

const Sizes odd_sizes = {{7, 5}, {3, 2}, {1, 1}};
const Sizes cube_sizes = {{8, 8}, {4, 4}, {2, 2}, {1, 1}};

void test_adjoints() {
    for (const Filter filter : {Filter::nearest, Filter::linear, Filter::linear_mipmap_nearest,
                                Filter::linear_mipmap_linear, Filter::anisotropic})
        for (const Boundary boundary : {Boundary::wrap, Boundary::clamp, Boundary::mirror, Boundary::zero}) {
            test_texels(scene_of(filter, boundary, 2, 300, odd_sizes));
            test_texels(scene_of(filter, boundary, 1, 5000, odd_sizes));
        }
    test_texels(scene_of(Filter::linear_mipmap_linear, Boundary::wrap, 2, 9000, {{150, 170}, {75, 85}}));
    test_texels(scene_of(Filter::linear_mipmap_linear, Boundary::cube, 2, 3000, cube_sizes));
    test_texels(scene_of(Filter::linear, Boundary::cube, 1, 3000, {{1, 1}}));
    for (const Boundary boundary : {Boundary::wrap, Boundary::clamp, Boundary::mirror, Boundary::zero}) {
        test_slopes(scene_of(Filter::linear_mipmap_linear, boundary, 1, 500, odd_sizes));
        test_slopes(scene_of(Filter::anisotropic, boundary, 1, 500, odd_sizes));
    }
    test_slopes(scene_of(Filter::linear_mipmap_linear, Boundary::cube, 2, 500, cube_sizes));
}

// A texture of one value is that value everywhere, to the bit.
void test_constant() {
    for (const Filter filter : {Filter::nearest, Filter::linear, Filter::linear_mipmap_nearest,
                                Filter::linear_mipmap_linear, Filter::anisotropic}) {
        Scene scene = scene_of(filter, Boundary::mirror, 1, 1000, odd_sizes);
        Random random;
        scene.fill(random);
        for (Vector& level : scene.texels)
            for (double& value : level) value = 0.1;
        bool is_equal = true;
        for (const double value : scene.look_up()) is_equal = is_equal && value == 0.1;
        CHECK(is_equal);
    }
}

// On both sides of an edge and around a corner a cube gives nearly the same; directions that point nowhere give zeros.
void test_cube_seams() {
    Scene scene = scene_of(Filter::linear, Boundary::cube, 1, 0, {{4, 4}});
    Random random;
    for (int i = 0; i < 600; ++i) {
        const bool is_corner = i % 3 == 0;
        double d[3];
        for (double& x : d) x = random.next() < 0.5 ? -1 : 1;
        if (!is_corner) d[i % 3 == 1 ? 0 : 1] = 2 * random.next() - 1;
        if (i % 2 == 0) std::swap(d[1], d[2]);
        for (int side = 0; side < 2; ++side)
            for (int k = 0; k < 3; ++k) scene.uv.push_back(d[k] + 1e-9 * (random.next() - 0.5));
    }
    scene.uv.insert(scene.uv.end(), {0, 0, 0, std::nan(""), 1, 1, HUGE_VAL, 1, 1});
    scene.points = static_cast<std::int64_t>(scene.uv.size() / 3);
    scene.texels = {random.vector(scene.level_size(0), -1, 1)};
    const Vector out = scene.look_up();
    double largest = 0;
    for (std::size_t i = 0; i < 600; ++i)
        for (std::size_t c = 0; c < 3; ++c)
            largest = std::max(largest, std::abs(out[(2 * i) * 3 + c] - out[(2 * i + 1) * 3 + c]));
    CHECK(largest < 1e-7);
    for (std::size_t i = 3600; i < out.size(); ++i) CHECK(out[i] == 0);
}

// The centre of every texel of every face, as a direction, gives that texel.
void test_cube_centres() {
    Scene scene = scene_of(Filter::linear, Boundary::cube, 1, 6 * 9, {{3, 3}});
    scene.channels = 1;
    const double axes[6][3][3] = {{{1, 0, 0}, {0, 0, -1}, {0, -1, 0}}, {{-1, 0, 0}, {0, 0, 1}, {0, -1, 0}},
                                  {{0, 1, 0}, {1, 0, 0}, {0, 0, 1}},   {{0, -1, 0}, {1, 0, 0}, {0, 0, -1}},
                                  {{0, 0, 1}, {1, 0, 0}, {0, -1, 0}},  {{0, 0, -1}, {-1, 0, 0}, {0, -1, 0}}};
    for (const auto& face : axes)  // the face's axis, and the directions of rising columns and rows
        for (int row = 0; row < 3; ++row)
            for (int column = 0; column < 3; ++column)
                for (int k = 0; k < 3; ++k)
                    scene.uv.push_back(face[0][k] + (2 * column - 2) / 3.0 * face[1][k] +
                                       (2 * row - 2) / 3.0 * face[2][k]);
    Random random;
    scene.texels = {random.vector(54, -1, 1)};
    const Vector out = scene.look_up();
    for (std::size_t i = 0; i < out.size(); ++i) CHECK(std::abs(out[i] - scene.texels[0][i]) < 1e-12);
}

// The adjoints of the level of detail and of the axis against central differences, as functions of the Jacobian.
void test_footprint() {
    using J = mipbake::Jacobian<double>;
    Random random;
    for (int i = 0; i < 300; ++i) {
        const Vector entries = random.vector(4, -3, 3), g = random.vector(3, -1, 1);
        const J j = {entries[0], entries[1], entries[2], entries[3]};
        const auto value = [&](const J& at) {
            const mipbake::Ellipse<double> e = mipbake::ellipse_of(at);
            const mipbake::AxisTaps<double> taps = mipbake::axis_taps(at, e);
            return g[0] * mipbake::lod_of(e) + g[1] * taps.s + g[2] * taps.t;
        };
        const J slope = mipbake::axis_adjoint(j, mipbake::ellipse_of(j), g[1], g[2], g[0]);
        const double slopes[4] = {slope.sx, slope.sy, slope.tx, slope.ty};
        for (int k = 0; k < 4; ++k) {
            J low = j, high = j;
            double* const lows[4] = {&low.sx, &low.sy, &low.tx, &low.ty};
            double* const highs[4] = {&high.sx, &high.sy, &high.tx, &high.ty};
            *lows[k] -= 1e-6;
            *highs[k] += 1e-6;
            CHECK(std::abs((value(high) - value(low)) / 2e-6 - slopes[k]) < 1e-4 * (1 + std::abs(slopes[k])));
        }
    }
    const J circle = {2, 0, 0, 2}, line = {8, 0, 0, 0}, oblique = {6, 0, 0, 2};
    CHECK(mipbake::lod_of(mipbake::ellipse_of(circle)) == 1);
    CHECK(mipbake::axis_taps(circle, mipbake::ellipse_of(circle)).count == 1);
    CHECK(mipbake::axis_taps(line, mipbake::ellipse_of(line)).count == 16);
    const mipbake::AxisTaps<double> three = mipbake::axis_taps(oblique, mipbake::ellipse_of(oblique));
    CHECK(three.count == 3 && std::abs(three.s) == 6 && three.t == 0 && three.lod == 1);
    for (const double x : {1e-300, 5e-324, 0.3, 1.0, 1.5, 7e9, 1e300})
        CHECK(std::abs(mipbake::log2_of(x) - std::log2(x)) <= 4e-16 * std::abs(std::log2(x)));
    for (const float x : {1e-40f, 1e-30f, 0.7f, 1.0f, 1.41f, 3e38f})
        CHECK(std::abs(mipbake::log2_of(x) - std::log2(x)) <= 2e-7f * std::abs(std::log2(x)));
    CHECK(mipbake::log2_of(0.0f) == -HUGE_VALF && mipbake::log2_of(HUGE_VALF) == HUGE_VALF);
}

void test_mip(const mipbake::MipShape& shape) {
    const auto half = [](int size) { return size > 1 ? size / 2 : 1; };
    const std::size_t fine = static_cast<std::size_t>(shape.images * shape.height * shape.width * shape.channels);
    const std::size_t coarse =
        static_cast<std::size_t>(shape.images * half(shape.height) * half(shape.width) * shape.channels);
    Random random;
    const Vector level = random.vector(fine, -1, 1), grad_out = random.vector(coarse, -1, 1);
    Vector out(coarse), grad = random.vector(fine, -1, 1);
    const double before = dot(level, grad);
    mipbake::texture_mip_cpu(shape, mipbake::Storage::float64, level.data(), out.data());
    mipbake::texture_mip_backward_cpu(shape, grad_out.data(), grad.data());
    CHECK(std::abs(dot(out, grad_out) - (dot(level, grad) - before)) < 1e-10);
    const Vector constant(fine, 0.1);
    mipbake::texture_mip_cpu(shape, mipbake::Storage::float64, constant.data(), out.data());
    CHECK(out == Vector(coarse, 0.1));
}

void test_mips() {
    for (const mipbake::MipShape shape : {mipbake::MipShape{2, 8, 6, 4},
                                          {1, 7, 9, 3},
                                          {3, 1, 5, 1},
                                          {1, 6, 1, 2},
                                          {1, 1, 1, 5},
                                          {2, 33, 700, 4},
                                          {1, 5, 3, 1500}})
        test_mip(shape);
    // Five texels to two: the weights 2, 2, 1 and 1, 2, 2 of five.
    const Vector level = {1, 10, 100, 1000, 10000};
    Vector out(2);
    mipbake::texture_mip_cpu({1, 1, 5, 1}, mipbake::Storage::float64, level.data(), out.data());
    CHECK(std::abs(out[0] - 122.0 / 5) < 1e-12 && std::abs(out[1] - 22100.0 / 5) < 1e-11);
}

// Every number of a half type survives the way to float and back; halfway cases round to even.
void test_storage() {
    for (std::uint32_t bits = 0; bits < 0x10000; ++bits) {
        const mipbake::Float16 half = {static_cast<std::uint16_t>(bits)};
        const mipbake::Bfloat16 brain = {static_cast<std::uint16_t>(bits)};
        const float a = mipbake::value_of(half), b = mipbake::value_of(brain);
        mipbake::Float16 half_again;
        mipbake::Bfloat16 brain_again;
        mipbake::store_value(a, &half_again);
        mipbake::store_value(b, &brain_again);
        CHECK(a != a ? (bits & 0x7fff) > 0x7c00 : half_again.bits == bits);
        CHECK(b != b ? (bits & 0x7fff) > 0x7f80 : brain_again.bits == bits);
    }
    const auto half = [](float x) {
        mipbake::Float16 out;
        mipbake::store_value(x, &out);
        return mipbake::value_of(out);
    };
    CHECK(half(1 + 0x1p-11f) == 1 && half(1 + 0x3p-11f) == 1 + 0x1p-9f && half(65519.0f) == 65504);
    CHECK(std::isinf(half(65520.0f)) && half(0x1p-25f) == 0 && half(0x1.8p-24f) == 0x1p-23f);
    CHECK(mipbake::value_of(mipbake::Float16{0x3555}) == 0.333251953125f);
}

}  // namespace

int main() {
    test_by_hand();
    test_adjoints();
    test_constant();
    test_cube_seams();
    test_cube_centres();
    test_footprint();
    test_mips();
    test_storage();
    return report();
}
