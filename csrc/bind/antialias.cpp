#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <cstdint>
#include <optional>
#include <stdexcept>

#include "bind/arrays.h"
#include "ops/raster.h"

using namespace mipbake::bind;

namespace {

template <class T>
mipbake::AntialiasArgs<T> arguments(const Input& color, const Input& rast, const Input& pos, const Input& tri,
                                    const Input& next) {
    if (color.ndim() != 4 || pos.ndim() < 2 || tri.ndim() != 2)
        throw std::invalid_argument("unexpected number of axes");
    const auto size = [](const Input& a, std::size_t axis) { return static_cast<Index>(a.shape(axis)); };
    const Index batch = size(color, 0), height = size(color, 1), width = size(color, 2), channels = size(color, 3);
    const Index vertices = size(pos, pos.ndim() - 2), triangles = size(tri, 0);
    const auto dtype = nb::dtype<T>(), index = nb::dtype<std::int32_t>();
    require(color, dtype, color, "color", {batch, height, width, channels});
    require(rast, dtype, color, "rast", {batch, height, width, 4});
    require(tri, index, color, "tri", {triangles, 3});
    require(next, index, color, "next", {triangles, 3});
    if (pos.ndim() == 2)
        require(pos, dtype, color, "pos", {vertices, 4});
    else
        require(pos, dtype, color, "pos", {batch, vertices, 4});
    mipbake::AntialiasArgs<T> args{};
    args.color = static_cast<const T*>(color.data());
    args.channels = static_cast<int>(channels);
    args.rast = static_cast<const T*>(rast.data());
    args.pos = static_cast<const T*>(pos.data());
    args.pos_batch_stride = pos.ndim() == 2 || batch == 1 ? 0 : vertices * 4;
    args.vertices = vertices;
    args.tri = static_cast<const std::int32_t*>(tri.data());
    args.next = static_cast<const std::int32_t*>(next.data());
    args.triangles = triangles;
    args.batch = batch;
    args.height = static_cast<int>(height);
    args.width = static_cast<int>(width);
    return args;
}

template <class T>
std::uint8_t* workspace_of(const std::optional<Output>& workspace, const mipbake::AntialiasArgs<T>& args,
                           const Input& like) {
    if (!workspace) {
        if (like.device_type() == nb::device::cuda::value) throw std::invalid_argument("CUDA needs a workspace");
        return nullptr;
    }
    const Index items = args.pos_batch_stride == 0 ? 1 : args.batch;
    require(*workspace, nb::dtype<std::uint8_t>(), like, "workspace", {items, args.triangles});
    return static_cast<std::uint8_t*>(workspace->data());
}

template <class T>
void antialias_as(const Input& color, const Input& rast, const Input& pos, const Input& tri, const Input& next,
                  const Output& out, const std::optional<Output>& workspace, std::uintptr_t stream) {
    const mipbake::AntialiasArgs<T> args = arguments<T>(color, rast, pos, tri, next);
    require(out, nb::dtype<T>(), color, "out", {args.batch, args.height, args.width, args.channels});
    T* const target = static_cast<T*>(out.data());
    std::uint8_t* const scratch = workspace_of(workspace, args, color);
    launch<T>(
        color, stream, [&] { mipbake::antialias_cpu(args, target); },
        [&](auto queue) { mipbake::antialias_cuda(args, target, scratch, queue); });
}

template <class T>
void backward_as(const Input& color, const Input& rast, const Input& pos, const Input& tri, const Input& next,
                 const Input& grad, double boost, const std::optional<Output>& grad_color,
                 const std::optional<Output>& grad_pos, const std::optional<Output>& workspace, std::uintptr_t stream) {
    const mipbake::AntialiasArgs<T> args = arguments<T>(color, rast, pos, tri, next);
    const auto dtype = nb::dtype<T>();
    const std::initializer_list<Index> shape = {args.batch, args.height, args.width, args.channels};
    require(grad, dtype, color, "grad", shape);
    if (grad_color) require(*grad_color, dtype, color, "grad_color", shape);
    if (grad_pos && pos.ndim() == 2) require(*grad_pos, dtype, color, "grad_pos", {args.vertices, 4});
    if (grad_pos && pos.ndim() == 3) require(*grad_pos, dtype, color, "grad_pos", {args.batch, args.vertices, 4});
    const mipbake::AntialiasGrads<T> grads{static_cast<const T*>(grad.data()), boost, data<T>(grad_color),
                                           data<T>(grad_pos)};
    std::uint8_t* const scratch = workspace_of(workspace, args, color);
    launch<T>(
        color, stream, [&] { mipbake::antialias_backward_cpu(args, grads); },
        [&](auto queue) { mipbake::antialias_backward_cuda(args, grads, scratch, queue); });
}

void antialias(const Input& color, const Input& rast, const Input& pos, const Input& tri, const Input& next,
               const Output& out, const std::optional<Output>& workspace, std::uintptr_t stream) {
    const auto run = color.dtype() == nb::dtype<double>() ? antialias_as<double> : antialias_as<float>;
    run(color, rast, pos, tri, next, out, workspace, stream);
}

void antialias_backward(const Input& color, const Input& rast, const Input& pos, const Input& tri, const Input& next,
                        const Input& grad, double boost, const std::optional<Output>& grad_color,
                        const std::optional<Output>& grad_pos, const std::optional<Output>& workspace,
                        std::uintptr_t stream) {
    const auto run = color.dtype() == nb::dtype<double>() ? backward_as<double> : backward_as<float>;
    run(color, rast, pos, tri, next, grad, boost, grad_color, grad_pos, workspace, stream);
}

void antialias_topology(const Input& tri, Index vertices, const Output& next) {
    if (tri.ndim() != 2 || tri.device_type() != nb::device::cpu::value)
        throw std::invalid_argument("tri must be (T, 3) in the memory of the CPU");
    const Index triangles = static_cast<Index>(tri.shape(0));
    require(tri, nb::dtype<std::int32_t>(), tri, "tri", {triangles, 3});
    require(next, nb::dtype<std::int32_t>(), tri, "next", {triangles, 3});
    const auto* const source = static_cast<const std::int32_t*>(tri.data());
    auto* const target = static_cast<std::int32_t*>(next.data());
    const nb::gil_scoped_release unlocked;
    mipbake::antialias_topology_cpu(source, triangles, vertices, target);
}

}  // namespace

void bind_antialias(nb::module_& m) {
    using namespace nb::literals;
    m.def("antialias_topology", &antialias_topology, "tri"_a, "vertices"_a, "next"_a,
          "Fills next (T, 3): for each edge of tri (T, 3) the next one that joins the same vertices, in a cycle.");
    m.def(
        "antialias", &antialias, "color"_a, "rast"_a, "pos"_a, "tri"_a, "next"_a, "out"_a,
        "workspace"_a.none() = nb::none(), "stream"_a = 0,
        "Fills out (B, H, W, C) from color (B, H, W, C), rast (B, H, W, 4), pos (V, 4) or (B, V, 4), tri and next (T, "
        "3). On CUDA workspace is (1 or B, T) bytes.");
    m.def("antialias_backward", &antialias_backward, "color"_a, "rast"_a, "pos"_a, "tri"_a, "next"_a, "grad"_a,
          "boost"_a, "grad_color"_a.none(), "grad_pos"_a.none(), "workspace"_a.none() = nb::none(), "stream"_a = 0,
          "Overwrites grad_color (B, H, W, C) and grad_pos (as pos), each unless it is None.");
}
