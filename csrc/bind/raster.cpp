#include "ops/raster.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <cstdint>
#include <optional>
#include <stdexcept>

#include "bind/arrays.h"

using namespace mipbake::bind;

namespace {

using MaybeInput = std::optional<Input>;
using MaybeOutput = std::optional<Output>;

Index size_of(const Input& array, std::size_t axis) { return static_cast<Index>(array.shape(axis)); }

// What rasterize and its backward share; out is rast.
template <class T, class Args, class Rast>
void mesh_arguments(Args& args, const Input& pos, const Input& tri, const Rast& rast) {
    if (rast.ndim() != 4 || (pos.ndim() != 2 && pos.ndim() != 3) || tri.ndim() != 2)
        throw std::invalid_argument("pos, tri or rast has an unexpected number of axes");
    args.batch = static_cast<Index>(rast.shape(0));
    args.height = static_cast<int>(rast.shape(1));
    args.width = static_cast<int>(rast.shape(2));
    args.vertices = size_of(pos, pos.ndim() - 2);
    args.triangles = size_of(tri, 0);
    args.shared = pos.ndim() == 2;
    if (args.shared)
        require(pos, nb::dtype<T>(), pos, "pos", {args.vertices, 4});
    else
        require(pos, nb::dtype<T>(), pos, "pos", {args.batch, args.vertices, 4});
    require(tri, nb::dtype<std::int32_t>(), pos, "tri", {args.triangles, 3});
    require(rast, nb::dtype<T>(), pos, "rast", {args.batch, args.height, args.width, 4});
    args.pos = static_cast<const T*>(pos.data());
    args.tri = static_cast<const std::int32_t*>(tri.data());
}

template <class T>
void rasterize_as(const Input& pos, const Input& tri, const MaybeInput& ranges, const MaybeInput& previous,
                  const Output& rast, const MaybeOutput& rast_db, Index scratch, const MaybeOutput& workspace,
                  std::uintptr_t stream) {
    mipbake::RasterizeArgs<T> args{};
    mesh_arguments<T>(args, pos, tri, rast);
    args.rast = static_cast<T*>(rast.data());
    if (ranges) {
        require(*ranges, nb::dtype<std::int32_t>(), *ranges, "ranges", {args.batch, 2});
        args.ranges = static_cast<const std::int32_t*>(ranges->data());
    }
    if (previous) {
        require(*previous, nb::dtype<T>(), pos, "previous", {args.batch, args.height, args.width, 4});
        args.previous = static_cast<const T*>(previous->data());
    }
    if (rast_db) {
        require(*rast_db, nb::dtype<T>(), pos, "rast_db", {args.batch, args.height, args.width, 4});
        args.rast_db = static_cast<T*>(rast_db->data());
    }
    launch<T>(
        pos, stream, [&] { mipbake::rasterize_cpu(args, scratch); },
        [&](auto queue) {
            const Index bytes = mipbake::rasterize_workspace(args.batch, args.triangles, args.height, args.width);
            if (!workspace) throw std::invalid_argument("rasterize needs a workspace on the GPU");
            require(*workspace, nb::dtype<std::uint8_t>(), pos, "workspace", {bytes});
            mipbake::rasterize_cuda(args, workspace->data(), queue);
        });
}

void rasterize(const Input& pos, const Input& tri, const MaybeInput& ranges, const MaybeInput& previous,
               const Output& rast, const MaybeOutput& rast_db, Index scratch, const MaybeOutput& workspace,
               std::uintptr_t stream) {
    const auto run = rast.dtype() == nb::dtype<float>() ? rasterize_as<float> : rasterize_as<double>;
    run(pos, tri, ranges, previous, rast, rast_db, scratch, workspace, stream);
}

template <class T>
void backward_as(const Input& pos, const Input& tri, const Input& rast, const Input& grad_rast,
                 const MaybeInput& grad_db, const Output& grad_pos, std::uintptr_t stream) {
    mipbake::RasterizeBackwardArgs<T> args{};
    mesh_arguments<T>(args, pos, tri, rast);
    args.rast = static_cast<const T*>(rast.data());
    require(grad_rast, nb::dtype<T>(), pos, "grad_rast", {args.batch, args.height, args.width, 4});
    args.grad_rast = static_cast<const T*>(grad_rast.data());
    if (grad_db) {
        require(*grad_db, nb::dtype<T>(), pos, "grad_db", {args.batch, args.height, args.width, 4});
        args.grad_db = static_cast<const T*>(grad_db->data());
    }
    if (args.shared)
        require(grad_pos, nb::dtype<T>(), pos, "grad_pos", {args.vertices, 4});
    else
        require(grad_pos, nb::dtype<T>(), pos, "grad_pos", {args.batch, args.vertices, 4});
    args.grad_pos = static_cast<T*>(grad_pos.data());
    launch<T>(
        pos, stream, [&] { mipbake::rasterize_backward_cpu(args); },
        [&](auto queue) { mipbake::rasterize_backward_cuda(args, queue); });
}

void rasterize_backward(const Input& pos, const Input& tri, const Input& rast, const Input& grad_rast,
                        const MaybeInput& grad_db, const Output& grad_pos, std::uintptr_t stream) {
    const auto run = rast.dtype() == nb::dtype<float>() ? backward_as<float> : backward_as<double>;
    run(pos, tri, rast, grad_rast, grad_db, grad_pos, stream);
}

template <class T>
void check_mesh_as(const MaybeInput& pos, const MaybeInput& tri, Index vertices, const MaybeInput& ranges) {
    const bool instanced = pos && pos->ndim() == 3;
    const Index items = instanced ? size_of(*pos, 0) : 1;
    const Index triangles = tri && tri->ndim() == 2 ? size_of(*tri, 0) : 0;
    const Index batch = ranges && ranges->ndim() == 2 ? size_of(*ranges, 0) : 0;
    if (pos) {
        if (instanced)
            require(*pos, nb::dtype<T>(), *pos, "pos", {items, vertices, 4});
        else
            require(*pos, nb::dtype<T>(), *pos, "pos", {vertices, 4});
    }
    if (tri) require(*tri, nb::dtype<std::int32_t>(), *tri, "tri", {triangles, 3});
    if (ranges) require(*ranges, nb::dtype<std::int32_t>(), *ranges, "ranges", {batch, 2});
    const auto* const p = pos ? static_cast<const T*>(pos->data()) : nullptr;
    const auto* const t = tri ? static_cast<const std::int32_t*>(tri->data()) : nullptr;
    const auto* const r = ranges ? static_cast<const std::int32_t*>(ranges->data()) : nullptr;
    const nb::gil_scoped_release unlocked;
    mipbake::check_mesh<T>(p, instanced, items, vertices, t, triangles, r, batch);
}

void check_mesh(const MaybeInput& pos, const MaybeInput& tri, Index vertices, const MaybeInput& ranges) {
    const bool is_double = pos && pos->dtype() == nb::dtype<double>();
    (is_double ? check_mesh_as<double> : check_mesh_as<float>)(pos, tri, vertices, ranges);
}

Index workspace_bytes(Index batch, Index triangles, int height, int width) {
#ifdef MIPBAKE_CUDA
    return mipbake::rasterize_workspace(batch, triangles, height, width);
#else
    static_cast<void>(batch + triangles + height + width);
    throw std::invalid_argument("no CUDA kernels in this build");
#endif
}

}  // namespace

void bind_raster(nb::module_& m) {
    using namespace nb::literals;
    m.def("check_mesh", &check_mesh, "pos"_a.none(), "tri"_a.none(), "vertices"_a, "ranges"_a.none(),
          "ValueError, a sentence for the user, where a position is not finite, an index is not of a vertex or a range "
          "is not within the triangles of tri. Arrays of the CPU.");
    m.def("raster_scratch", &mipbake::raster_scratch, "A handle of memory that rasterize keeps between calls.");
    m.def("raster_scratch_free", &mipbake::raster_scratch_free, "handle"_a);
    m.def("rasterize_workspace", &workspace_bytes, "batch"_a, "triangles"_a, "height"_a, "width"_a,
          "Bytes of the workspace that rasterize needs on a GPU.");
    m.def("rasterize", &rasterize, "pos"_a, "tri"_a, "ranges"_a.none(), "previous"_a.none(), "rast"_a,
          "rast_db"_a.none(), "scratch"_a = 0, "workspace"_a.none() = nb::none(), "stream"_a = 0,
          "Overwrites rast (B, H, W, 4) and rast_db (the same, or None) from pos (V, 4) or (B, V, 4), tri (T, 3), "
          "ranges (B, 2) of the CPU or None, and the previous rast or None.");
    m.def("rasterize_backward", &rasterize_backward, "pos"_a, "tri"_a, "rast"_a, "grad_rast"_a, "grad_db"_a.none(),
          "grad_pos"_a, "stream"_a = 0,
          "Overwrites grad_pos, shaped like pos, from the gradients of rast and, if it is not None, of rast_db.");
}
