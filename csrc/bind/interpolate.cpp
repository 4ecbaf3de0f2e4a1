#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <optional>
#include <stdexcept>
#include <vector>

#include "bind/arrays.h"
#include "ops/raster.h"

using namespace mipbake::bind;

namespace {

template <class T>
mipbake::InterpolateArgs<T> arguments(const Input& attr, const Input& rast, const Input& tri,
                                      const std::optional<Input>& rast_db, const std::vector<int>& listed) {
    if (rast.ndim() != 4 || attr.ndim() < 2 || tri.ndim() != 2)
        throw std::invalid_argument("unexpected number of axes");
    const auto size = [](const Input& a, std::size_t axis) { return static_cast<Index>(a.shape(axis)); };
    const Index batch = size(rast, 0), height = size(rast, 1), width = size(rast, 2);
    const std::size_t last = attr.ndim() - 1;
    const Index vertices = size(attr, last - 1), channels = size(attr, last);
    const auto dtype = nb::dtype<T>();
    require(rast, dtype, rast, "rast", {batch, height, width, 4});
    require(tri, nb::dtype<std::int32_t>(), rast, "tri", {size(tri, 0), 3});
    if (last == 1)
        require(attr, dtype, rast, "attr", {vertices, channels});
    else
        require(attr, dtype, rast, "attr", {size(attr, 0) == 1 ? 1 : batch, vertices, channels});
    if (rast_db) require(*rast_db, dtype, rast, "rast_db", {batch, height, width, 4});
    if (!rast_db && !listed.empty()) throw std::invalid_argument("diff_attrs without rast_db");
    for (const int channel : listed)
        if (channel < 0 || channel >= channels) throw std::invalid_argument("a channel of diff_attrs is not in attr");
    mipbake::InterpolateArgs<T> args{};
    args.attr = static_cast<const T*>(attr.data());
    args.attr_batch_stride = last == 1 || size(attr, 0) == 1 ? 0 : vertices * channels;
    args.vertices = vertices;
    args.channels = static_cast<int>(channels);
    args.rast = static_cast<const T*>(rast.data());
    args.rast_db = data<const T>(rast_db);
    args.tri = static_cast<const std::int32_t*>(tri.data());
    args.triangles = size(tri, 0);
    args.listed = listed.data();
    args.listed_count = static_cast<int>(listed.size());
    args.batch = batch;
    args.height = static_cast<int>(height);
    args.width = static_cast<int>(width);
    return args;
}

template <class T>
void interpolate_as(const Input& attr, const Input& rast, const Input& tri, const std::optional<Input>& rast_db,
                    const std::vector<int>& listed, const Output& out, const std::optional<Output>& out_da,
                    std::uintptr_t stream) {
    const mipbake::InterpolateArgs<T> args = arguments<T>(attr, rast, tri, rast_db, listed);
    require(out, nb::dtype<T>(), rast, "out", {args.batch, args.height, args.width, args.channels});
    if (out_da)
        require(*out_da, nb::dtype<T>(), rast, "out_da", {args.batch, args.height, args.width, 2 * args.listed_count});
    else if (!listed.empty())
        throw std::invalid_argument("diff_attrs without out_da");
    T* const values = static_cast<T*>(out.data());
    T* const derivatives = data<T>(out_da);
    launch<T>(
        rast, stream, [&] { mipbake::interpolate_cpu(args, values, derivatives); },
        [&](auto queue) { mipbake::interpolate_cuda(args, values, derivatives, queue); });
}

template <class T>
void backward_as(const Input& attr, const Input& rast, const Input& tri, const std::optional<Input>& rast_db,
                 const std::vector<int>& listed, const Input& grad_out, const std::optional<Input>& grad_da,
                 const std::optional<Output>& grad_attr, const std::optional<Output>& grad_rast,
                 const std::optional<Output>& grad_db, std::uintptr_t stream) {
    const mipbake::InterpolateArgs<T> args = arguments<T>(attr, rast, tri, rast_db, listed);
    const auto dtype = nb::dtype<T>();
    require(grad_out, dtype, rast, "grad_out", {args.batch, args.height, args.width, args.channels});
    if (grad_da)
        require(*grad_da, dtype, rast, "grad_da", {args.batch, args.height, args.width, 2 * args.listed_count});
    if (grad_rast) require(*grad_rast, dtype, rast, "grad_rast", {args.batch, args.height, args.width, 4});
    if (grad_db) require(*grad_db, dtype, rast, "grad_db", {args.batch, args.height, args.width, 4});
    if (grad_attr && attr.ndim() == 2) require(*grad_attr, dtype, rast, "grad_attr", {args.vertices, args.channels});
    if (grad_attr && attr.ndim() == 3)
        require(*grad_attr, dtype, rast, "grad_attr",
                {static_cast<Index>(attr.shape(0)), args.vertices, args.channels});
    const mipbake::InterpolateGrads<T> grads{static_cast<const T*>(grad_out.data()), data<const T>(grad_da),
                                             data<T>(grad_attr), data<T>(grad_rast), data<T>(grad_db)};
    launch<T>(
        rast, stream, [&] { mipbake::interpolate_backward_cpu(args, grads); },
        [&](auto queue) { mipbake::interpolate_backward_cuda(args, grads, queue); });
}

void interpolate(const Input& attr, const Input& rast, const Input& tri, const std::optional<Input>& rast_db,
                 const std::vector<int>& listed, const Output& out, const std::optional<Output>& out_da,
                 std::uintptr_t stream) {
    const auto run = rast.dtype() == nb::dtype<double>() ? interpolate_as<double> : interpolate_as<float>;
    run(attr, rast, tri, rast_db, listed, out, out_da, stream);
}

void interpolate_backward(const Input& attr, const Input& rast, const Input& tri, const std::optional<Input>& rast_db,
                          const std::vector<int>& listed, const Input& grad_out, const std::optional<Input>& grad_da,
                          const std::optional<Output>& grad_attr, const std::optional<Output>& grad_rast,
                          const std::optional<Output>& grad_db, std::uintptr_t stream) {
    const auto run = rast.dtype() == nb::dtype<double>() ? backward_as<double> : backward_as<float>;
    run(attr, rast, tri, rast_db, listed, grad_out, grad_da, grad_attr, grad_rast, grad_db, stream);
}

}  // namespace

void bind_interpolate(nb::module_& m) {
    using namespace nb::literals;
    m.def(
        "interpolate", &interpolate, "attr"_a, "rast"_a, "tri"_a, "rast_db"_a.none(), "diff_attrs"_a, "out"_a,
        "out_da"_a.none(), "stream"_a = 0,
        "Fills out (B, H, W, A), and out_da (B, H, W, 2K) unless it is None, from attr (V, A) or (1 or B, V, A), rast "
        "(B, H, W, 4), tri (T, 3) and rast_db (B, H, W, 4).");
    m.def("interpolate_backward", &interpolate_backward, "attr"_a, "rast"_a, "tri"_a, "rast_db"_a.none(),
          "diff_attrs"_a, "grad_out"_a, "grad_da"_a.none(), "grad_attr"_a.none(), "grad_rast"_a.none(),
          "grad_db"_a.none(), "stream"_a = 0,
          "Overwrites grad_attr (as attr), grad_rast and grad_db (B, H, W, 4), each unless it is None.");
}
