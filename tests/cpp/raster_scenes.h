// Meshes, images and what is drawn of them, for the tests of the rasteriser.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "check.h"
#include "ops/raster.h"

namespace mipbake {

using Index = std::int64_t;
using Random = std::mt19937;

inline double uniform(Random& random, double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random);
}
inline int integer(Random& random, int low, int high) { return std::uniform_int_distribution<int>(low, high)(random); }

template <class T>
struct Mesh {
    std::vector<T> pos;
    std::vector<std::int32_t> tri;

    Index vertices() const { return static_cast<Index>(pos.size() / 4); }
    Index triangles() const { return static_cast<Index>(tri.size() / 3); }
    std::int32_t add(double x, double y, double z, double w) {
        for (const double c : {x, y, z, w}) pos.push_back(static_cast<T>(c));
        return static_cast<std::int32_t>(vertices() - 1);
    }
    void add_triangle(std::int32_t a, std::int32_t b, std::int32_t c) { tri.insert(tri.end(), {a, b, c}); }
};

template <class T>
struct Image {
    int height, width;
    Index batch = 1;
    std::vector<T> rast, db;

    Image(int h, int w, Index b = 1) : height(h), width(w), batch(b) {
        rast.assign(static_cast<std::size_t>(b * h * w * 4), T(-7));
        db = rast;
    }
    const T* at(Index b, int y, int x) const {
        return &rast[static_cast<std::size_t>(((b * height + y) * width + x) * 4)];
    }
};

template <class T>
RasterizeArgs<T> arguments(const Mesh<T>& mesh, Image<T>& image) {
    RasterizeArgs<T> args{};
    args.batch = image.batch;
    args.vertices = mesh.vertices();
    args.triangles = mesh.triangles();
    args.height = image.height;
    args.width = image.width;
    args.pos = mesh.pos.data();
    args.shared = true;
    args.tri = mesh.tri.data();
    args.rast = image.rast.data();
    args.rast_db = image.db.data();
    return args;
}

template <class T>
Image<T> draw(const Mesh<T>& mesh, int height, int width, const Image<T>* previous = nullptr) {
    Image<T> image(height, width);
    RasterizeArgs<T> args = arguments(mesh, image);
    if (previous != nullptr) args.previous = previous->rast.data();
    rasterize_cpu(args, 0);
    return image;
}

// How many triangles cover each pixel: each is drawn into an image of its own.
template <class T>
std::vector<int> coverage(const Mesh<T>& mesh, int height, int width) {
    Image<T> image(height, width, mesh.triangles());
    std::vector<std::int32_t> ranges;
    for (std::int32_t t = 0; t < mesh.triangles(); ++t) ranges.insert(ranges.end(), {t, 1});
    RasterizeArgs<T> args = arguments(mesh, image);
    args.ranges = ranges.data();
    rasterize_cpu(args, 0);
    std::vector<int> counts(static_cast<std::size_t>(height * width));
    for (Index t = 0; t < mesh.triangles(); ++t)
        for (int y = 0; y < height; ++y)
            for (int x = 0; x < width; ++x) {
                const T id = image.at(t, y, x)[3];
                CHECK(id == 0 || id == static_cast<T>(t + 1));
                counts[static_cast<std::size_t>(y * width + x)] += id > 0;
            }
    return counts;
}

enum class Kind { small, large, slivers, through_the_eye, huge, stacked, lattice };

template <class T>
Mesh<T> triangles_of(Kind kind, int count, Random& random) {
    Mesh<T> mesh;
    for (int t = 0; t < count; ++t) {
        const double cx = uniform(random, -1.1, 1.1), cy = uniform(random, -1.1, 1.1);
        const double depth = uniform(random, -1, 1);
        for (int i = 0; i < 3; ++i) {
            double x = uniform(random, -1, 1), y = uniform(random, -1, 1), z = depth + uniform(random, -0.2, 0.2),
                   w = 1;
            switch (kind) {
                case Kind::small:
                    x = cx + x * 0.06;
                    y = cy + y * 0.06;
                    break;
                case Kind::large:
                    w = std::exp(uniform(random, -1, 1));
                    break;
                case Kind::slivers:
                    x = cx + x;
                    y = cy + (x - cx) * 0.7 + y * 1e-3;
                    break;
                case Kind::through_the_eye:
                    w = uniform(random, -0.6, 1);
                    z = uniform(random, -1.2, 1.2);
                    break;
                case Kind::huge:
                    x *= 1e12;
                    y *= 1e12;
                    w = std::exp(uniform(random, -4, 20));
                    z *= w;
                    break;
                case Kind::stacked:
                    x *= 3;
                    y *= 3;
                    z = depth;
                    break;
                case Kind::lattice:
                    x = std::round(x * 32) / 32 + 1.0 / 128;
                    y = std::round(y * 32) / 32 + 1.0 / 128;
                    z = std::round(z * 4) / 4;
                    break;
            }
            mesh.add(kind == Kind::large ? x * w : x, kind == Kind::large ? y * w : y, kind == Kind::large ? z * w : z,
                     w);
        }
        mesh.add_triangle(3 * t, 3 * t + 1, 3 * t + 2);
    }
    return mesh;
}

template <class T>
bool same(const std::vector<T>& a, const std::vector<T>& b) {
    return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin());
}

}  // namespace mipbake
