// Antialiasing: the topology, which edges are silhouettes, known coverages, the adjoint against finite differences, the
// same bits from any number of threads, and errors.
#include <cmath>
#include <cstring>
#include <limits>
#include <stdexcept>
#include <string>
#include <vector>

#include "check.h"
#include "ops/raster.h"
#include "ops/runtime.h"

using mipbake::AntialiasArgs;
using mipbake::AntialiasGrads;

namespace {

struct Scene {
    int batch, height, width, channels;
    std::vector<double> pos;  // (batch, vertices, 4)
    std::vector<std::int32_t> tri;
    std::vector<double> color, rast;
    std::vector<std::int32_t> next;

    std::int64_t vertices() const { return static_cast<std::int64_t>(pos.size()) / 4 / batch; }
    std::int64_t triangles() const { return static_cast<std::int64_t>(tri.size()) / 3; }
};

// Numbers in [-1, 1) from a linear congruential generator.
struct Numbers {
    std::uint64_t state = 1;
    double operator()() {
        state = state * 6364136223846793005u + 1442695040888963407u;
        return static_cast<double>(state >> 11) / 4503599627370496.0 - 1.0;
    }
};

// A rasterisation of triangles in front of the eye, by signs and barycentrics alone.
void draw(Scene& s) {
    s.rast.assign(static_cast<std::size_t>(s.batch * s.height * s.width) * 4, 0.0);
    for (int i = 0; i < s.batch * s.height * s.width; ++i) {
        const double x = (2.0 * (i % s.width) + 1) / s.width - 1,
                     y = (2.0 * (i / s.width % s.height) + 1) / s.height - 1;
        double* const pixel = s.rast.data() + 4 * i;
        const double* const pos = s.pos.data() + i / s.width / s.height * s.vertices() * 4;
        for (std::int64_t t = 0; t < s.triangles(); ++t) {
            double e[3];
            for (int k = 0; k < 3; ++k) {
                const double* const a = pos + 4 * s.tri[static_cast<std::size_t>(3 * t + (k + 1) % 3)];
                const double* const b = pos + 4 * s.tri[static_cast<std::size_t>(3 * t + (k + 2) % 3)];
                e[k] = (a[1] * b[3] - a[3] * b[1]) * x + (a[3] * b[0] - a[0] * b[3]) * y + a[0] * b[1] - a[1] * b[0];
            }
            if (!((e[0] > 0 && e[1] > 0 && e[2] > 0) || (e[0] < 0 && e[1] < 0 && e[2] < 0))) continue;
            double z = 0, w = 0;
            for (int k = 0; k < 3; ++k) {
                const double* const v = pos + 4 * s.tri[static_cast<std::size_t>(3 * t + k)];
                z += v[2] * e[k];
                w += v[3] * e[k];
            }
            if (pixel[3] != 0 && !(z / w < pixel[2])) continue;
            const double sum = e[0] + e[1] + e[2];
            const double values[4] = {e[0] / sum, e[1] / sum, z / w, static_cast<double>(t + 1)};
            std::memcpy(pixel, values, sizeof values);
        }
    }
}

void join(Scene& s) {
    s.next.assign(s.tri.size(), -1);
    mipbake::antialias_topology_cpu(s.tri.data(), s.triangles(), s.vertices(), s.next.data());
}

AntialiasArgs<double> arguments(const Scene& s) {
    AntialiasArgs<double> args{};
    args.color = s.color.data();
    args.channels = s.channels;
    args.rast = s.rast.data();
    args.pos = s.pos.data();
    args.pos_batch_stride = s.batch == 1 ? 0 : s.vertices() * 4;
    args.vertices = s.vertices();
    args.tri = s.tri.data();
    args.next = s.next.data();
    args.triangles = s.triangles();
    args.batch = s.batch;
    args.height = s.height;
    args.width = s.width;
    return args;
}

std::vector<double> antialias(const Scene& s) {
    std::vector<double> out(s.color.size(), -7.0);
    mipbake::antialias_cpu(arguments(s), out.data());
    return out;
}

void test_topology() {
    // Edge 0-1 has three triangles, 1-2 two of opposite directions, the others are borders.
    const std::vector<std::int32_t> tri = {0, 1, 2, 1, 0, 3, 2, 1, 4, 0, 1, 5};
    std::vector<std::int32_t> next(tri.size(), -1);
    mipbake::antialias_topology_cpu(tri.data(), 4, 6, next.data());
    const std::vector<std::int32_t> expected = {3, 6, 2, 9, 4, 5, 1, 7, 8, 0, 10, 11};
    CHECK(next == expected);

    // A fan around one vertex, long enough for the other sort: edges 0-k join neighbours.
    constexpr int spokes = 100;
    std::vector<std::int32_t> fan;
    for (int k = spokes; k-- > 0;)
        for (const int v : {0, k + 1, (k + 1) % spokes + 1}) fan.push_back(v);
    next.assign(fan.size(), -1);
    mipbake::antialias_topology_cpu(fan.data(), spokes, spokes + 1, next.data());
    for (int t = 0; t < spokes; ++t) {
        CHECK(next[static_cast<std::size_t>(3 * t)] == 3 * ((t + 1) % spokes) + 2);
        CHECK(next[static_cast<std::size_t>(3 * t + 1)] == 3 * t + 1);
        CHECK(next[static_cast<std::size_t>(3 * t + 2)] == 3 * ((t + spokes - 1) % spokes));
    }
}

// One row of two pixels. The left belongs to a square that ends `d` pixels right of its centre.
Scene square(double d, double w) {
    Scene s{1, 1, 2, 1, {}, {0, 1, 2, 1, 3, 2}, {1.0, 0.0}, {}, {}};
    const double right = -0.5 + d;  // a pixel is as wide as 1 in NDC, the left centre at -1/2
    for (const double y : {-1.0, 1.0})
        for (const double x : {-1.0, right}) s.pos.insert(s.pos.end(), {x * w, y * w, 0.0, w});
    s.rast.assign(8, 0.0);
    s.rast[3] = 2;
    join(s);
    return s;
}

void test_coverage() {
    for (const double w : {1.0, 3.0}) {
        for (const double d : {0.0, 0.125, 0.5, 0.625, 1.0}) {
            const std::vector<double> out = antialias(square(d, w));
            CHECK(std::abs(out[0] - (d < 0.5 ? 0.5 + d : 1.0)) < 1e-12);
            CHECK(std::abs(out[1] - (d > 0.5 ? d - 0.5 : 0.0)) < 1e-12);
        }
        const Scene beyond = square(1.25, w);
        CHECK(antialias(beyond) == beyond.color);
    }
    const Scene behind_the_eye = square(0.75, -1.0);
    CHECK(antialias(behind_the_eye) == behind_the_eye.color);
    // The same edge inside a surface blends nothing: a square beyond it, on the other side.
    Scene inner = square(0.75, 1.0);
    inner.pos.insert(inner.pos.end(), {1.0, -1.0, 0.0, 1.0, 1.0, 1.0, 0.0, 1.0});
    inner.tri.insert(inner.tri.end(), {1, 4, 3, 4, 5, 3});
    join(inner);
    CHECK(antialias(inner) == inner.color);
    // Folded back below the first square it is a silhouette again, and so it is when seen edge-on.
    for (const double x : {-1.0, 0.25}) {
        inner.pos[16] = inner.pos[20] = x;
        CHECK(std::abs(antialias(inner)[1] - 0.25) < 1e-12);
    }
}

// Two items, each a tetrahedron in perspective before a triangle that crosses it.
Scene random_scene() {
    Scene s{2, 37, 45, 3, {}, {0, 1, 2, 0, 3, 1, 1, 3, 2, 2, 3, 0, 4, 5, 6}, {}, {}, {}};
    Numbers number;
    for (int v = 0; v < 14; ++v) {
        const double w = 1.5 + 0.5 * number();
        for (const double c : {number() * w, number() * w, 0.5 * number() * w, w}) s.pos.push_back(c);
    }
    for (int i = 0; i < s.batch * s.height * s.width * s.channels; ++i) s.color.push_back(number());
    draw(s);
    join(s);
    return s;
}

void test_gradients() {
    Scene s = random_scene();
    std::vector<double> weights;
    Numbers number;
    for (std::size_t i = 0; i < s.color.size(); ++i) weights.push_back(number());
    const auto loss = [&](const Scene& scene) {
        const std::vector<double> out = antialias(scene);
        double sum = 0;
        for (std::size_t i = 0; i < out.size(); ++i) sum += weights[i] * out[i];
        return sum;
    };
    std::vector<double> grad_color(s.color.size(), -7.0), grad_pos(s.pos.size(), -7.0);
    mipbake::antialias_backward_cpu(arguments(s),
                                    AntialiasGrads<double>{weights.data(), 2.0, grad_color.data(), grad_pos.data()});
    int moving = 0;
    for (std::size_t i = 0; i < s.pos.size(); ++i) {
        constexpr double step = 1e-7;
        Scene more = s, less = s;
        more.pos[i] += step;
        less.pos[i] -= step;
        const double slope = (loss(more) - loss(less)) / (2 * step);
        // Twice the slope, as the boost says. A pair whose crossing enters or leaves within the step would show.
        CHECK(std::abs(grad_pos[i] - 2.0 * slope) < 1e-5 * (1 + std::abs(slope)));
        moving += slope != 0 ? 1 : 0;
        CHECK(i % 4 != 2 || grad_pos[i] == 0);
    }
    CHECK(moving > 20);
    for (std::size_t i = 0; i < s.color.size(); i += 7) {
        Scene more = s;
        more.color[i] += 1;
        CHECK(std::abs(grad_color[i] - (loss(more) - loss(s))) < 1e-9);
    }
}

void test_threads() {
    const Scene s = random_scene();
    std::vector<double> first_out, first_color, first_pos;
    const int before = mipbake::num_threads();
    for (const int threads : {1, 2, 5}) {
        mipbake::set_num_threads(threads);
        const std::vector<double> out = antialias(s);
        std::vector<double> color(s.color.size()), pos(s.pos.size()), alone(s.color.size());
        mipbake::antialias_backward_cpu(arguments(s),
                                        AntialiasGrads<double>{out.data(), 1.0, color.data(), pos.data()});
        mipbake::antialias_backward_cpu(arguments(s), AntialiasGrads<double>{out.data(), 1.0, alone.data(), nullptr});
        for (std::size_t i = 0; i < color.size(); ++i) CHECK(std::abs(color[i] - alone[i]) < 1e-12);
        if (threads == 1) {
            first_out = out;
            first_color = color;
            first_pos = pos;
        }
        CHECK(out == first_out && color == first_color && pos == first_pos);
    }
    mipbake::set_num_threads(before);
}

void test_errors() {
    Scene s = random_scene();
    s.rast[4 * (45 * (37 + 5) + 7) + 3] = 6;
    CHECK(complaint([&] { antialias(s); }) ==
          "rast[1, 5, 7] has triangle_id 6: expected at most 5, the number of triangles");
    for (const double bad : {-1.0, std::numeric_limits<double>::quiet_NaN()}) {
        s.rast[4 * (45 * (37 + 5) + 7) + 3] = bad;
        CHECK(complaint([&] { antialias(s); }).find("rast[1, 5, 7] has triangle_id") == 0);
    }
    s = random_scene();
    s.tri[4] = 7;
    const std::string expected = "tri[1] is (0, 7, 1): expected vertex indices from 0 to 6";
    CHECK(complaint([&] { antialias(s); }) == expected);
    CHECK(complaint([&] { join(s); }) == expected);
}

}  // namespace

int main() {
    test_topology();
    test_coverage();
    test_gradients();
    test_threads();
    test_errors();
    return report();
}
