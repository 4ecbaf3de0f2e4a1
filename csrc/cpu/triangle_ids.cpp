#include "cpu/triangle_ids.h"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include "raster/triangle_id.h"

namespace mipbake {

template <class T>
void check_triangle_ids(const T* rast, std::int64_t batch, int height, int width, std::int64_t triangles) {
    const std::int64_t pixels = batch * height * width;
    const T last = triangle_id<T>(triangles);
    for (std::int64_t i = 0; i < pixels; ++i) {
        const T id = rast[4 * i + 3];
        if (id >= T(0) && id <= last) continue;
        std::ostringstream text;
        text.precision(9);
        text << "rast[" << i / width / height << ", " << i / width % height << ", " << i % width << "] has triangle_id "
             << id << ": expected " << (id > T(0) ? "at most " : "0 where it is empty, or an index + 1 of at most ")
             << triangles << ", the number of triangles";
        throw std::invalid_argument(text.str());
    }
}

template void check_triangle_ids<float>(const float*, std::int64_t, int, int, std::int64_t);
template void check_triangle_ids<double>(const double*, std::int64_t, int, int, std::int64_t);

void check_triangle_vertices(const std::int32_t* tri, std::int64_t triangles, std::int64_t vertices) {
    for (std::int64_t t = 0; t < triangles; ++t) {
        bool good = true;
        for (int k = 0; k < 3; ++k) good = good && tri[3 * t + k] >= 0 && tri[3 * t + k] < vertices;
        if (good) continue;
        std::ostringstream text;
        text << "tri[" << t << "] is (" << tri[3 * t] << ", " << tri[3 * t + 1] << ", " << tri[3 * t + 2] << "): ";
        if (vertices > 0)
            text << "expected vertex indices from 0 to " << vertices - 1;
        else
            text << "expected no triangles, because there are no vertices";
        throw std::invalid_argument(text.str());
    }
}

}  // namespace mipbake
