// The error of a rasterised image that does not fit its mesh, found once a kernel has met one.
#pragma once

#include <cstdint>

namespace mipbake {

// Throws std::invalid_argument that names the first pixel of rast (batch, height, width, 4) whose triangle_id is no
// number from 0 to `triangles`; returns where there is none.
template <class T>
void check_triangle_ids(const T* rast, std::int64_t batch, int height, int width, std::int64_t triangles);

// Throws std::invalid_argument that names the first triangle of tri (T, 3) with a vertex beyond `vertices`.
void check_triangle_vertices(const std::int32_t* tri, std::int64_t triangles, std::int64_t vertices);

}  // namespace mipbake
