// The rasteriser: that every pixel of a surface is covered once, exactly; the tiles against one pixel at a time.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <random>
#include <vector>

#include "check.h"
#include "core/parallel.h"
#include "ops/runtime.h"
#include "raster/barycentric.h"
#include "raster_scenes.h"

using namespace mipbake;

namespace {

// ---- Watertight ----

// The signs and the rule on edges, against integers: positions are small integers, so nothing is rounded here.
void signs_are_those_of_integers() {
    Random random(1);
    for (int repeat = 0; repeat < 3000; ++repeat) {
        const int width = integer(random, 1, 24), height = integer(random, 1, 24);
        const int range = std::array{2, 7, 40, 20000}[static_cast<std::size_t>(repeat % 4)];
        // Multiples of the coordinates of pixel centres, so that many centres are on edges and at vertices.
        Index v[3][3];
        Mesh<float> mesh;
        for (auto& p : v) {
            const int w = integer(random, -3, 12), unit = width * height;
            p[0] = Index(integer(random, -range, range)) * height;
            p[1] = Index(integer(random, -range, range)) * width;
            p[2] = Index(w) * unit;
            if (repeat % 8 < 4)
                for (int i = 0; i < 2; ++i) p[i] = p[i] * w;
            if (std::max(std::abs(p[0]), std::abs(p[1])) >= 1 << 24) p[0] = p[1] = 0;
            mesh.add(static_cast<double>(p[0]), static_cast<double>(p[1]), 0, static_cast<double>(p[2]));
        }
        mesh.add_triangle(0, 1, 2);
        const Image<float> image = draw(mesh, height, width);
        const auto cross = [&](int a, int b, int i) {
            const int j = (i + 1) % 3, k = (i + 2) % 3;
            return static_cast<long double>(v[a][j]) * v[b][k] - static_cast<long double>(v[a][k]) * v[b][j];
        };
        const long double det = v[0][0] * cross(1, 2, 0) + v[0][1] * cross(1, 2, 1) + v[0][2] * cross(1, 2, 2);
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                bool covered = det != 0;
                for (int i = 0; i < 3; ++i) {
                    const int a = (i + 1) % 3, b = (i + 2) % 3;
                    const long double nx = cross(a, b, 0), ny = cross(a, b, 1), nw = cross(a, b, 2);
                    long double e = nx * ((2 * x + 1 - width) * height) + ny * ((2 * y + 1 - height) * width) +
                                    nw * (width * height);
                    if (e == 0) e = nx;
                    if (e == 0) e = ny;
                    covered = covered && (det > 0 ? e > 0 : e < 0);
                }
                CHECK((image.at(0, y, x)[3] > 0) == covered);
            }
    }
}

// A closed surface around the eye, in (x, y, w): whatever lies in front, behind or on w = 0, every pixel sees it once.
// Vertices are placed on rays through pixel centres, and edges through others.
template <class T>
void surfaces_around_the_eye(int height, int width, int subdivisions, unsigned seed) {
    Random random(seed);
    using Vector = std::array<double, 3>;
    std::vector<Vector> points = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
    std::vector<std::array<std::int32_t, 3>> faces;
    for (std::int32_t x : {0, 1})
        for (std::int32_t y : {2, 3})
            for (std::int32_t w : {4, 5}) {
                if ((x + y + w) % 2 == 0)
                    faces.push_back({x, y, w});
                else
                    faces.push_back({y, x, w});
            }
    for (int s = 0; s < subdivisions; ++s) {
        std::vector<std::array<std::int32_t, 3>> finer;
        std::vector<std::pair<std::array<std::int32_t, 2>, std::int32_t>> middles;
        const auto middle = [&](std::int32_t a, std::int32_t b) {
            const std::array<std::int32_t, 2> key{std::min(a, b), std::max(a, b)};
            for (const auto& m : middles)
                if (m.first == key) return m.second;
            Vector p;
            for (std::size_t i = 0; i < 3; ++i)
                p[i] = points[static_cast<std::size_t>(a)][i] + points[static_cast<std::size_t>(b)][i];
            points.push_back(p);
            middles.push_back({key, static_cast<std::int32_t>(points.size() - 1)});
            return middles.back().second;
        };
        for (const auto& f : faces) {
            const std::int32_t ab = middle(f[0], f[1]), bc = middle(f[1], f[2]), ca = middle(f[2], f[0]);
            finer.insert(finer.end(), {{f[0], ab, ca}, {ab, f[1], bc}, {ca, bc, f[2]}, {ab, bc, ca}});
        }
        faces = finer;
    }
    const double jitter = 0.3 / (1 << subdivisions);
    for (Vector& p : points) {
        const double length = std::sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]);
        for (double& c : p) c = c / length + uniform(random, -jitter, jitter);
        const double px = std::floor(p[0] / p[2] * width / 2) * 2 + (width % 2 == 0 ? 1 : 0);
        const double py = std::floor(p[1] / p[2] * height / 2) * 2 + (height % 2 == 0 ? 1 : 0);
        if (std::abs(px) < width && std::abs(py) < height && integer(random, 0, 3) > 0) {
            const double w = integer(random, 1, 64) * (p[2] > 0 ? 1.0 / 32 : -1.0 / 32);
            p = {px / width * w, py / height * w, w};  // without rounding where the sizes are powers of two
        } else {
            const double scale = std::exp(uniform(random, -3, 3));
            for (double& c : p) c = static_cast<double>(static_cast<T>(c * scale));
        }
    }
    Mesh<T> mesh;
    for (const Vector& p : points) mesh.add(p[0], p[1], uniform(random, -0.2, 0.2) * std::abs(p[2]), p[2]);
    for (auto f : faces) {
        std::rotate(f.begin(), f.begin() + integer(random, 0, 2), f.end());
        if (integer(random, 0, 1) == 1) std::swap(f[1], f[2]);  // culls nothing
        mesh.add_triangle(f[0], f[1], f[2]);
    }
    for (std::size_t i = 2; i < mesh.pos.size(); i += 4) mesh.pos[i] = 0;
    for (const int count : coverage(mesh, height, width)) CHECK(count == 1);
    const Image<T> image = draw(mesh, height, width);
    for (std::size_t i = 3; i < image.rast.size(); i += 4) CHECK(image.rast[i] > 0);
}

// Fans of thin triangles around a vertex at a pixel centre, that reach to infinity (w = 0), with spokes through
// centres.
template <class T>
void fans_around_pixel_centres(int size, unsigned seed) {
    Random random(seed);
    const int cx = integer(random, 0, size - 1), cy = integer(random, 0, size - 1);
    Mesh<T> mesh;
    const double w = std::ldexp(integer(random, 1, 7), integer(random, -20, 20));
    mesh.add((2 * cx + 1 - size) * w / size, (2 * cy + 1 - size) * w / size, 0, w);
    std::vector<std::array<int, 2>> spokes = {{1, 0}, {0, 1}, {-1, 0}, {0, -1}, {1, 1}, {-1, 1}, {-1, -1}, {1, -1}};
    for (int i = 0; i < 40; ++i) spokes.push_back({integer(random, -size, size), integer(random, -size, size)});
    spokes.erase(std::remove(spokes.begin(), spokes.end(), std::array<int, 2>{0, 0}), spokes.end());
    const auto angle = [](const std::array<int, 2>& s) { return std::atan2(s[1], s[0]); };
    std::sort(spokes.begin(), spokes.end(), [&](const auto& a, const auto& b) { return angle(a) < angle(b); });
    spokes.erase(std::unique(spokes.begin(), spokes.end(),
                             [](const auto& a, const auto& b) {
                                 return a[0] * b[1] == a[1] * b[0] && a[0] * b[0] + a[1] * b[1] > 0;
                             }),
                 spokes.end());
    for (const auto& s : spokes) {
        const double scale = std::ldexp(1.0, integer(random, -8, 8));
        mesh.add(s[0] * scale, s[1] * scale, 0, 0);
    }
    const auto n = static_cast<std::int32_t>(spokes.size());
    for (std::int32_t i = 0; i < n; ++i) mesh.add_triangle(0, 1 + i, 1 + (i + 1) % n);
    for (const int count : coverage(mesh, size, size)) CHECK(count == 1);
}

// Strips across the image in a random direction: long thin triangles, most without any pixel, shared edges everywhere.
template <class T>
void strips_of_slivers(int height, int width, unsigned seed) {
    Random random(seed);
    Mesh<T> mesh;
    const double angle = uniform(random, 0, 6.3), c = std::cos(angle), s = std::sin(angle);
    const int steps = 150;
    for (int i = 0; i <= steps; ++i) {
        const double along = -4 + 8.0 * i / steps + uniform(random, -0.02, 0.02);
        for (const double across : {-40.0, 40.0}) {
            const double w = std::exp(uniform(random, -2, 2));
            mesh.add((c * along - s * across) * w, (s * along + c * across) * w, 0, w);
        }
        const auto v = static_cast<std::int32_t>(2 * i);
        if (i == 0) continue;
        mesh.add_triangle(v - 2, v - 1, v);
        mesh.add_triangle(v, v - 1, v + 1);
    }
    for (const int count : coverage(mesh, height, width)) CHECK(count == 1);
}

// A plane over the whole image whose vertices are at pixel centres and whose edges go through them.
template <class T>
void planes_on_pixel_centres() {
    constexpr int size = 64;
    Random random(5);
    for (const int step : {2, 6, 14}) {
        Mesh<T> mesh;
        std::int32_t n = 0;
        for (int at = -size - 13; at <= size + 13 + step; at += step) ++n;
        for (std::int32_t i = 0; i < n; ++i)
            for (std::int32_t j = 0; j < n; ++j) {
                const double w = integer(random, 1, 9);
                mesh.add((-size - 13 + j * step) * w / size, (-size - 13 + i * step) * w / size, 0.25 * w, w);
            }
        for (std::int32_t i = 0; i + 1 < n; ++i)
            for (std::int32_t j = 0; j + 1 < n; ++j) {
                const std::int32_t v = i * n + j, flip = integer(random, 0, 1);
                mesh.add_triangle(v, v + 1, v + n + flip);
                mesh.add_triangle(v + n + 1, v + n, v + 1 - flip);
            }
        const Image<T> first = draw(mesh, size, size);
        for (std::size_t i = 3; i < first.rast.size(); i += 4) CHECK(first.rast[i] > 0);
        if (step > 2)
            for (const int count : coverage(mesh, size, size)) CHECK(count == 1);
        // Nothing lies behind the one layer.
        const Image<T> second = draw(mesh, size, size, &first);
        for (const T value : second.rast) CHECK(value == 0);
    }
}

// ---- Tiles ----

// Every triangle at every pixel, with the functions of csrc/raster that are the definition.
template <class T>
Image<T> draw_slowly(const Mesh<T>& mesh, int height, int width, const Image<T>* previous) {
    Image<T> image(height, width);
    std::fill(image.rast.begin(), image.rast.end(), T(0));
    std::fill(image.db.begin(), image.db.end(), T(0));
    for (Index t = 0; t < mesh.triangles(); ++t) {
        Triangle triangle;
        for (int i = 0; i < 3; ++i)
            triangle.v[i] = clip_vertex(mesh.pos.data(), mesh.tri[static_cast<std::size_t>(3 * t + i)]);
        if (!prepare<sizeof(T) == sizeof(double)>(triangle, width, height)) continue;
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                const double px = 2 * x + 1 - width, py = 2 * y + 1 - height;
                double depth;
                if (!covers(triangle, px, py, width, height) || !depth_at(triangle, px, py, depth)) continue;
                const T z = static_cast<T>(depth);
                if (previous != nullptr && !(previous->at(0, y, x)[3] > 0 && z > previous->at(0, y, x)[2])) continue;
                const auto at = static_cast<std::size_t>((y * width + x) * 4);
                if (image.rast[at + 3] != 0 && !(z < image.rast[at + 2])) continue;
                const Barycentrics b = barycentrics(triangle.edges, px, py);
                double d[4];
                barycentric_derivatives(triangle.edges, b, d);
                const double values[4] = {held_to_one(b.of[0]), held_to_one(b.of[1]), depth,
                                          static_cast<double>(t + 1)};
                for (std::size_t i = 0; i < 4; ++i) {
                    image.rast[at + i] = static_cast<T>(values[i]);
                    image.db[at + i] = static_cast<T>(d[i]);
                }
            }
    }
    return image;
}

template <class T>
void tiles_are_pixels() {
    Random random(11);
    const std::array<std::array<int, 2>, 4> sizes = {{{150, 131}, {64, 64}, {1, 1}, {9, 70}}};
    for (const Kind kind :
         {Kind::small, Kind::large, Kind::slivers, Kind::through_the_eye, Kind::huge, Kind::stacked, Kind::lattice})
        for (const auto& size : sizes) {
            const Mesh<T> mesh = triangles_of<T>(kind, kind == Kind::small ? 1500 : 160, random);
            Image<T> layer = draw(mesh, size[0], size[1]);
            const Image<T> expected = draw_slowly<T>(mesh, size[0], size[1], nullptr);
            CHECK(same(layer.rast, expected.rast));
            CHECK(same(layer.db, expected.db));
            if (size[0] > 64) continue;
            for (int depth = 0; depth < 2; ++depth) {
                const Image<T> next = draw(mesh, size[0], size[1], &layer);
                CHECK(same(next.rast, draw_slowly<T>(mesh, size[0], size[1], &layer).rast));
                layer = next;
            }
        }
}

template <class T>
void equal_depths_show_the_lower_triangle() {
    for (const int copies : {2, 300}) {
        Mesh<T> mesh;
        for (int i = 0; i < copies; ++i) {
            const std::int32_t v = mesh.add(-3, -3, 0.5, 1);
            mesh.add(3, -3, 0.5, 1);
            mesh.add(0, 4, 0.5, 1);
            if (i == 0)
                mesh.add_triangle(v, v + 1, v + 1);  // covers nothing
            else
                mesh.add_triangle(v, v + 1, v + 2);
        }
        const Image<T> image = draw(mesh, 70, 65);
        for (std::size_t i = 0; i < image.rast.size(); i += 4)
            CHECK(image.rast[i + 3] == 2 && image.rast[i + 2] == T(0.5));
    }
}

template <class T>
void nothing_draws_nothing() {
    Mesh<T> mesh;
    for (const T value : draw(mesh, 66, 5).rast) CHECK(value == 0);
    for (int i = 0; i < 3; ++i) mesh.add(i, i * i, 0, -1);  // behind the eye
    mesh.add_triangle(0, 1, 2);
    const Image<T> image = draw(mesh, 66, 5);
    for (const T value : image.rast) CHECK(value == 0);
    for (const T value : image.db) CHECK(value == 0);
}

// z = w at every vertex: drawn at depth 1 everywhere, whatever the rounding.
template <class T>
void skies_are_not_clipped() {
    Random random(3);
    for (int repeat = 0; repeat < 20; ++repeat) {
        Mesh<T> mesh;
        for (const int x : {-1, 1})
            for (const int y : {-1, 1}) {
                const T w = static_cast<T>(std::exp(uniform(random, -3, 3)));
                mesh.add(static_cast<double>(x * w), static_cast<double>(y * w), static_cast<double>(w),
                         static_cast<double>(w));
            }
        mesh.add_triangle(0, 1, 2);
        mesh.add_triangle(1, 2, 3);
        const Image<T> image = draw(mesh, 33, 47);
        for (std::size_t i = 0; i < image.rast.size(); i += 4) {
            CHECK(image.rast[i + 3] > 0);
            CHECK(std::abs(image.rast[i + 2] - 1) < 1e-6 && image.rast[i + 2] <= 1);
        }
    }
}

template <class T>
void all_of() {
    for (const auto& size : {std::array{64, 64}, {48, 75}, {128, 32}})
        for (int subdivisions = 0; subdivisions < 3; ++subdivisions)
            for (unsigned seed = 0; seed < 4; ++seed)
                surfaces_around_the_eye<T>(size[0], size[1], subdivisions,
                                           100 * seed + static_cast<unsigned>(subdivisions));
    for (const int size : {32, 64, 33})
        for (unsigned seed = 0; seed < 6; ++seed) fans_around_pixel_centres<T>(size, seed);
    for (unsigned seed = 0; seed < 4; ++seed) strips_of_slivers<T>(61, 80, seed);
    planes_on_pixel_centres<T>();
    tiles_are_pixels<T>();
    equal_depths_show_the_lower_triangle<T>();
    skies_are_not_clipped<T>();
    nothing_draws_nothing<T>();
}

}  // namespace

int main() {
    set_num_threads(2);
    signs_are_those_of_integers();
    all_of<float>();
    all_of<double>();
    return report();
}
