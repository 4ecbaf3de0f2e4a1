// The rasteriser: its gradient against differences, the same bits whatever the threads, shared scratch, errors.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <random>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "check.h"
#include "core/parallel.h"
#include "ops/raster.h"
#include "ops/runtime.h"
#include "raster/barycentric.h"
#include "raster_scenes.h"

using namespace mipbake;

namespace {

// The weighted sum of u, v and their derivatives, for pixels that keep their triangles.
double weighted(const Mesh<double>& mesh, const Image<double>& image, const std::vector<double>& g,
                const std::vector<double>& h) {
    double sum = 0;
    for (int y = 0; y < image.height; ++y)
        for (int x = 0; x < image.width; ++x) {
            const auto at = static_cast<std::size_t>((y * image.width + x) * 4);
            const auto id = static_cast<Index>(image.rast[at + 3]) - 1;
            if (id < 0) continue;
            ClipVertex v[3];
            for (int i = 0; i < 3; ++i)
                v[i] = clip_vertex(mesh.pos.data(), mesh.tri[static_cast<std::size_t>(3 * id + i)]);
            double turn;
            const Edges edges = make_edges<true>(v, image.width, image.height, turn);
            const Barycentrics b = barycentrics(edges, 2 * x + 1 - image.width, 2 * y + 1 - image.height);
            double d[4];
            barycentric_derivatives(edges, b, d);
            sum += g[at] * b.of[0] + g[at + 1] * b.of[1];
            for (std::size_t i = 0; i < 4; ++i) sum += h[at + i] * d[i];
        }
    return sum;
}

void gradients_are_differences() {
    Random random(23);
    for (const Kind kind : {Kind::large, Kind::through_the_eye}) {
        Mesh<double> mesh = triangles_of<double>(kind, 12, random);
        for (std::int32_t& corner : mesh.tri) corner = static_cast<std::int32_t>(corner / 3 * 3 + corner % 3);
        for (std::size_t i = 0; i < mesh.tri.size(); i += 6) mesh.tri[i] = 1;  // vertices of several triangles
        const Image<double> image = draw(mesh, 40, 37);
        std::vector<double> g(image.rast.size()), h(image.rast.size());
        for (double& value : g) value = uniform(random, -1, 1);
        for (double& value : h) value = uniform(random, -10, 10);
        RasterizeBackwardArgs<double> args{};
        args.batch = 1;
        args.vertices = mesh.vertices();
        args.triangles = mesh.triangles();
        args.height = image.height;
        args.width = image.width;
        args.pos = mesh.pos.data();
        args.shared = true;
        args.tri = mesh.tri.data();
        args.rast = image.rast.data();
        args.grad_rast = g.data();
        for (const bool with_derivatives : {false, true}) {
            std::vector<double> gradient(mesh.pos.size(), -1.0);
            args.grad_pos = gradient.data();
            args.grad_db = with_derivatives ? h.data() : nullptr;
            rasterize_backward_cpu(args);
            const std::vector<double> none(h.size());
            double scale = 0;
            for (const double value : gradient) scale = std::max(scale, std::abs(value));
            for (std::size_t i = 0; i < mesh.pos.size(); ++i) {
                const double kept = mesh.pos[i], step = 1e-6;
                mesh.pos[i] = kept + step;
                const double above = weighted(mesh, image, g, with_derivatives ? h : none);
                mesh.pos[i] = kept - step;
                const double below = weighted(mesh, image, g, with_derivatives ? h : none);
                mesh.pos[i] = kept;
                CHECK(std::abs((above - below) / (2 * step) - gradient[i]) < 1e-5 * scale);
                if (i % 4 == 2) CHECK(gradient[i] == 0);
            }
        }
    }
}

// The same bits whatever the number of threads, of both directions, for batches that share their vertices or do not.
void threads_do_not_matter() {
    Random random(31);
    const Mesh<float> mesh = triangles_of<float>(Kind::small, 900, random);
    constexpr int height = 500, width = 400;
    std::vector<std::int32_t> ranges = {0, 900, 100, 0, 450, 450};
    std::vector<float> pos;
    for (int b = 0; b < 3; ++b) pos.insert(pos.end(), mesh.pos.begin(), mesh.pos.end());
    for (const bool shared : {false, true}) {
        std::vector<std::vector<float>> results;
        const Index scratch = raster_scratch();
        for (const int threads : {1, 2, 5}) {
            set_num_threads(threads);
            Image<float> image(height, width, 3);
            RasterizeArgs<float> args = arguments(mesh, image);
            args.shared = shared;
            args.pos = pos.data();
            args.ranges = shared ? ranges.data() : nullptr;
            rasterize_cpu(args, scratch);
            RasterizeBackwardArgs<float> back{};
            back.batch = 3;
            back.vertices = args.vertices;
            back.triangles = args.triangles;
            back.height = height;
            back.width = width;
            back.pos = pos.data();
            back.shared = shared;
            back.tri = args.tri;
            back.rast = image.rast.data();
            back.grad_rast = image.rast.data();
            back.grad_db = image.db.data();
            std::vector<float> gradient(shared ? mesh.pos.size() : pos.size(), -1.0f);
            back.grad_pos = gradient.data();
            rasterize_backward_cpu(back);
            gradient.insert(gradient.end(), image.rast.begin(), image.rast.end());
            gradient.insert(gradient.end(), image.db.begin(), image.db.end());
            results.push_back(gradient);
            if (shared)
                for (int y = 0; y < height; ++y)
                    for (int x = 0; x < width; ++x) {
                        CHECK(image.at(1, y, x)[3] == 0);
                        CHECK(image.at(2, y, x)[3] == 0 || image.at(2, y, x)[3] > 450);
                    }
        }
        raster_scratch_free(scratch);
        for (const auto& result : results) CHECK(std::memcmp(result.data(), results[0].data(), result.size() * 4) == 0);
    }
    set_num_threads(2);
}

// One scratch in several threads, freed while it may be in use.
void scratches_are_shared() {
    Random random(37);
    const Mesh<float> mesh = triangles_of<float>(Kind::large, 200, random);
    const Image<float> expected = draw(mesh, 90, 120);
    const Index scratch = raster_scratch();
    std::vector<std::thread> callers;
    std::array<bool, 4> good{};
    for (std::size_t i = 0; i < good.size(); ++i)
        callers.emplace_back([&, i] {
            good[i] = true;
            for (int repeat = 0; repeat < 10; ++repeat) {
                Image<float> image(90, 120);
                rasterize_cpu(arguments(mesh, image), scratch);
                if (repeat == 5) raster_scratch_free(scratch);
                good[i] = good[i] && same(image.rast, expected.rast);
            }
        });
    for (std::thread& caller : callers) caller.join();
    for (const bool all : good) CHECK(all);
}

void mistakes_are_named() {
    std::vector<float> pos(4 * 900, 0.5f);
    std::vector<std::int32_t> tri(3 * 64, 3), ranges = {0, 64, 60, 4, 64, 0};
    const auto check = [&](bool instanced, Index items) {
        return complaint([&] {
            check_mesh(pos.data(), instanced, items, 900 / items, tri.data(), Index(64), ranges.data(), Index(3));
        });
    };
    CHECK(check(false, 1).empty());
    tri[17 * 3 + 1] = 5;
    tri[17 * 3 + 2] = 901;
    tri[17 * 3] = 0;
    CHECK(check(false, 1) == "tri[17] is (0, 5, 901): expected vertex indices from 0 to 899");
    tri[17 * 3 + 2] = -1;
    CHECK(check(false, 1) == "tri[17] is (0, 5, -1): expected vertex indices from 0 to 899");
    tri[17 * 3 + 2] = 1;
    pos[(3 * 90 + 12) * 4] = NAN;
    pos[(3 * 90 + 12) * 4 + 1] = 0;
    CHECK(check(true, 10) == "pos[3, 12] is (nan, 0.0, 0.5, 0.5): expected finite numbers");
    CHECK(check(false, 1) == "pos[282] is (nan, 0.0, 0.5, 0.5): expected finite numbers");
    pos[(3 * 90 + 12) * 4] = -INFINITY;
    CHECK(check(true, 10) == "pos[3, 12] is (-inf, 0.0, 0.5, 0.5): expected finite numbers");
    pos[(3 * 90 + 12) * 4] = 0;
    ranges[4] = 10;
    ranges[5] = 90;
    CHECK(check(false, 1) == "ranges[2] is (10, 90): expected a start and a count within the 64 triangles of tri");

    Mesh<float> mesh;
    for (int i = 0; i < 3; ++i) mesh.add(i, 1, 0, 1);
    for (int i = 0; i < 11; ++i) mesh.add_triangle(0, 1, 2);
    std::vector<float> rast(6 * 8 * 4, 0.0f), gradient(12);
    rast[(5 * 8 + 7) * 4 + 3] = 12;
    RasterizeBackwardArgs<float> back{};
    back.batch = 1;
    back.vertices = 3;
    back.triangles = 11;
    back.height = 6;
    back.width = 8;
    back.pos = mesh.pos.data();
    back.shared = true;
    back.tri = mesh.tri.data();
    back.rast = rast.data();
    back.grad_rast = rast.data();
    back.grad_pos = gradient.data();
    CHECK(complaint([&] { rasterize_backward_cpu(back); }) ==
          "rast[0, 5, 7] has triangle_id 12: expected at most 11, the number of triangles");
}

}  // namespace

int main() {
    set_num_threads(2);
    gradients_are_differences();
    threads_do_not_matter();
    scratches_are_shared();
    mistakes_are_named();
    return report();
}
