#include "ops/texture.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <algorithm>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>

#include "bind/arrays.h"

namespace {

using mipbake::bind::Index, mipbake::bind::Input, mipbake::bind::Output, mipbake::bind::launch;
using MaybeInput = std::optional<Input>;
using MaybeOutput = std::optional<Output>;

// The Python modules that call these functions check every argument; this catches a mistake of theirs, not a user's.
void require(bool condition, const char* what) {
    if (!condition) throw std::invalid_argument(what);
}

Index size_of(const Input& array, int axis) { return static_cast<Index>(array.shape(axis)); }

// 0 where the axis has one element that is repeated.
Index step(const Input& array, int axis) { return array.shape(axis) == 1 ? 0 : array.stride(axis); }

mipbake::Storage storage_of(const nb::dlpack::dtype& type) {
    if (type == nb::dtype<float>()) return mipbake::Storage::float32;
    if (type == nb::dtype<double>()) return mipbake::Storage::float64;
    require(type.bits == 16 && type.lanes == 1, "texels must be float32, float64, float16 or bfloat16");
    if (type.code == static_cast<std::uint8_t>(nb::dlpack::dtype_code::Float)) return mipbake::Storage::float16;
    require(type.code == static_cast<std::uint8_t>(nb::dlpack::dtype_code::Bfloat),
            "texels must be float32, float64, float16 or bfloat16");
    return mipbake::Storage::bfloat16;
}

template <class T>
const T* read(const Input& array) {
    require(array.dtype() == nb::dtype<T>(), "every array but the levels must have the dtype of the result");
    return static_cast<const T*>(array.data());
}

template <class A>
void require_contiguous(const A& array) {
    Index contiguous = 1;
    for (std::size_t i = array.ndim(); i-- > 0; contiguous *= static_cast<Index>(array.shape(i)))
        require(array.shape(i) == 1 || array.size() == 0 || array.stride(i) == contiguous,
                "an array is not C-contiguous");
}

template <class T>
T* write(const Output& array, Index size) {
    require(array.dtype() == nb::dtype<T>(), "every array but the levels must have the dtype of the result");
    require(static_cast<Index>(array.size()) == size, "an output has the wrong size");
    require_contiguous(array);
    return static_cast<T*>(array.data());
}

mipbake::Filter filter_of(const std::string& name) {
    if (name == "nearest") return mipbake::Filter::nearest;
    if (name == "linear") return mipbake::Filter::linear;
    if (name == "linear-mipmap-nearest") return mipbake::Filter::linear_mipmap_nearest;
    if (name == "linear-mipmap-linear") return mipbake::Filter::linear_mipmap_linear;
    require(name == "anisotropic", "an unknown filter");
    return mipbake::Filter::anisotropic;
}

mipbake::Boundary boundary_of(const std::string& name) {
    if (name == "wrap") return mipbake::Boundary::wrap;
    if (name == "clamp") return mipbake::Boundary::clamp;
    if (name == "mirror") return mipbake::Boundary::mirror;
    if (name == "zero") return mipbake::Boundary::zero;
    require(name == "cube", "an unknown boundary");
    return mipbake::Boundary::cube;
}

// What a lookup is made of, as Python gives it.
struct Lookup {
    const nb::list& levels;
    const Input& uv;
    const MaybeInput& uv_da;
    const MaybeInput& bias;
    const std::string& filter;
    const std::string& boundary_u;
    const std::string& boundary_v;
};

template <class T>
mipbake::TextureArgs<T> arguments(const Lookup& lookup, Index batch) {
    mipbake::TextureArgs<T> args{};
    args.filter = filter_of(lookup.filter);
    args.boundary_u = boundary_of(lookup.boundary_u);
    args.boundary_v = boundary_of(lookup.boundary_v);
    args.batch = batch;
    const bool is_cube = args.boundary_u == mipbake::Boundary::cube;
    require(is_cube == (args.boundary_v == mipbake::Boundary::cube), "the boundary 'cube' must stand for both axes");
    require(!is_cube || args.filter != mipbake::Filter::anisotropic, "cubes have no anisotropic filter");
    require(lookup.uv_da.has_value() || args.filter != mipbake::Filter::anisotropic,
            "the anisotropic filter needs uv_da");
    args.level_count = static_cast<int>(lookup.levels.size());
    require(args.level_count >= 1 && args.level_count <= mipbake::max_levels, "1 to 32 levels");
    for (int l = 0; l < args.level_count; ++l) {
        const Input level = nb::cast<Input>(lookup.levels[static_cast<std::size_t>(l)]);
        const int row = is_cube ? 2 : 1;
        require(static_cast<int>(level.ndim()) == row + 3 && level.size() > 0,
                "a level must be (batch, height, width, channels), or (batch, 6, size, size, channels) of a cube");
        require(!is_cube || (level.shape(1) == 6 && level.shape(2) == level.shape(3)),
                "a level of a cube must be (batch, 6, size, size, channels)");
        require(level.shape(row + 2) == 1 || level.stride(row + 2) == 1, "the channels of a texel must be consecutive");
        require(level.shape(0) == 1 || size_of(level, 0) == batch, "the levels' batch must be 1 or the lookups'");
        require(level.device_type() == lookup.uv.device_type(), "every array must be on the same device");
        const int channels = static_cast<int>(level.shape(row + 2));
        const mipbake::Storage storage = storage_of(level.dtype());
        require(l == 0 || channels == args.channels, "every level must have the same channels");
        require(l == 0 || storage == args.storage, "every level must have the same dtype");
        require((storage == mipbake::Storage::float64) == (sizeof(T) == sizeof(double)),
                "texels in float64 give a result in float64, and others one in float32");
        args.channels = channels;
        args.storage = storage;
        args.heights[l] = static_cast<int>(level.shape(row));
        args.widths[l] = static_cast<int>(level.shape(row + 1));
        args.levels[l] = {level.data(), step(level, 0), is_cube ? level.stride(1) : 0, level.stride(row),
                          level.stride(row + 1)};
    }
    const Input& uv = lookup.uv;
    const std::size_t coordinates = is_cube ? 3 : 2;
    require(uv.ndim() == 3 && uv.shape(2) == coordinates && uv.stride(2) == 1, "uv must be (batch, points, 2 or 3)");
    require(uv.shape(0) == 1 || size_of(uv, 0) == batch, "the batch of uv must be 1 or the result's");
    args.points = size_of(uv, 1);
    args.uv = read<T>(uv);
    args.uv_batch_stride = step(uv, 0);
    args.uv_point_stride = uv.stride(1);
    if (lookup.uv_da) {
        const Input& da = *lookup.uv_da;
        require(da.ndim() == 3 && da.shape(2) == 2 * coordinates && da.stride(2) == 1,
                "uv_da must be (batch, points, 4 or 6)");
        require(da.shape(0) == 1 || size_of(da, 0) == batch, "the batch of uv_da must be 1 or the result's");
        require(size_of(da, 1) == args.points, "uv_da must have the points of uv");
        args.uv_da = read<T>(da);
        args.uv_da_batch_stride = step(da, 0);
        args.uv_da_point_stride = da.stride(1);
    }
    if (lookup.bias) {
        const Input& bias = *lookup.bias;
        require(bias.ndim() == 2, "bias must be (batch, points)");
        require(bias.shape(0) == 1 || size_of(bias, 0) == batch, "the batch of bias must be 1 or the result's");
        require(bias.shape(1) == 1 || size_of(bias, 1) == args.points, "bias must have 1 point or those of uv");
        args.bias = read<T>(bias);
        args.bias_batch_stride = step(bias, 0);
        args.bias_point_stride = step(bias, 1);
    }
    return args;
}

template <class T>
void texture_as(const Lookup& lookup, const Output& out, std::uintptr_t stream) {
    const mipbake::TextureArgs<T> args = arguments<T>(lookup, static_cast<Index>(out.shape(0)));
    T* const target = write<T>(out, args.batch * args.points * args.channels);
    require(out.device_type() == lookup.uv.device_type(), "every array must be on the same device");
    launch<T>(
        lookup.uv, stream, [&] { mipbake::texture_cpu(args, target); },
        [&](auto queue) { mipbake::texture_cuda(args, target, queue); });
}

void texture(const nb::list& levels, const Input& uv, const MaybeInput& uv_da, const MaybeInput& bias,
             const std::string& filter, const std::string& boundary_u, const std::string& boundary_v, const Output& out,
             std::uintptr_t stream) {
    require(out.ndim() == 3, "the output must be (batch, points, channels)");
    const Lookup lookup{levels, uv, uv_da, bias, filter, boundary_u, boundary_v};
    if (out.dtype() == nb::dtype<float>()) return texture_as<float>(lookup, out, stream);
    texture_as<double>(lookup, out, stream);
}

struct Wanted {
    const nb::list& levels;
    const MaybeOutput& uv;
    const MaybeOutput& uv_da;
    const MaybeOutput& bias;
};

template <class T>
void backward_as(const Input& grad, const Lookup& lookup, const Wanted& wanted, std::uintptr_t stream) {
    const mipbake::TextureArgs<T> args = arguments<T>(lookup, static_cast<Index>(grad.shape(0)));
    const Index lookups = args.batch * args.points;
    const bool is_cube = args.boundary_u == mipbake::Boundary::cube;
    mipbake::TextureGrads<T> grads{};
    grads.out = read<T>(grad);
    require(static_cast<Index>(grad.size()) == lookups * args.channels, "the gradient has the wrong size");
    require_contiguous(grad);
    require(wanted.levels.size() == 0 || static_cast<int>(wanted.levels.size()) == args.level_count,
            "a gradient per level");
    for (int l = 0; l < static_cast<int>(wanted.levels.size()); ++l) {
        const Output target = nb::cast<Output>(wanted.levels[static_cast<std::size_t>(l)]);
        const Index items = static_cast<Index>(target.shape(0));
        require(items == (args.levels[l].batch_stride == 0 ? 1 : args.batch), "a level's gradient has another batch");
        grads.level_batch[l] = items;
        grads.levels[l] =
            write<T>(target, items * (is_cube ? 6 : 1) * args.heights[l] * args.widths[l] * Index(args.channels));
    }
    if (wanted.uv) grads.uv = write<T>(*wanted.uv, lookups * (is_cube ? 3 : 2));
    if (wanted.uv_da) grads.uv_da = write<T>(*wanted.uv_da, lookups * (is_cube ? 6 : 4));
    if (wanted.bias) grads.bias = write<T>(*wanted.bias, lookups);
    require(grad.device_type() == lookup.uv.device_type(), "every array must be on the same device");
    launch<T>(
        grad, stream, [&] { mipbake::texture_backward_cpu(args, grads); },
        [&](auto queue) { mipbake::texture_backward_cuda(args, grads, queue); });
}

void texture_backward(const Input& grad, const nb::list& levels, const Input& uv, const MaybeInput& uv_da,
                      const MaybeInput& bias, const std::string& filter, const std::string& boundary_u,
                      const std::string& boundary_v, const nb::list& level_grads, const MaybeOutput& uv_grad,
                      const MaybeOutput& uv_da_grad, const MaybeOutput& bias_grad, std::uintptr_t stream) {
    require(grad.ndim() == 3, "the gradient must be (batch, points, channels)");
    const Lookup lookup{levels, uv, uv_da, bias, filter, boundary_u, boundary_v};
    const Wanted wanted{level_grads, uv_grad, uv_da_grad, bias_grad};
    if (grad.dtype() == nb::dtype<float>()) return backward_as<float>(grad, lookup, wanted, stream);
    backward_as<double>(grad, lookup, wanted, stream);
}

void texture_taps(int height, int width, const Input& uv, const std::string& boundary_u, const std::string& boundary_v,
                  const Output& texels, const Output& fractions) {
    require(uv.ndim() == 2 && uv.shape(1) == 2 && height > 0 && width > 0,
            "uv must be (points, 2), and sizes 1 or more");
    require_contiguous(uv);
    require(uv.device_type() == nb::device::cpu::value, "expected an array in the memory of the host");
    mipbake::TextureArgs<float> args{};
    args.filter = mipbake::Filter::linear;
    args.boundary_u = boundary_of(boundary_u);
    args.boundary_v = boundary_of(boundary_v);
    require(args.boundary_u != mipbake::Boundary::cube && args.boundary_v != mipbake::Boundary::cube, "no cubes");
    args.level_count = 1;
    args.heights[0] = height;
    args.widths[0] = width;
    args.batch = 1;
    args.points = size_of(uv, 0);
    args.uv = read<float>(uv);
    args.uv_point_stride = 2;
    require(texels.dtype() == nb::dtype<std::int64_t>() && static_cast<Index>(texels.size()) == 4 * args.points,
            "texels must be (points, 4) int64");
    require_contiguous(texels);
    auto* const to = static_cast<std::int64_t*>(texels.data());
    float* const ways = write<float>(fractions, 2 * args.points);
    const nb::gil_scoped_release unlocked;
    mipbake::texture_taps_cpu(args, to, ways);
}

void texture_quads(const Input& values, const Input& texels, const Input& fractions, const Output& out) {
    require(values.ndim() == 2 && texels.ndim() == 2 && texels.shape(1) == 4, "values (texels, C), texels (points, 4)");
    require(texels.dtype() == nb::dtype<std::int64_t>(), "texels must be int64");
    require(values.device_type() == nb::device::cpu::value, "expected an array in the memory of the host");
    for (const Input& array : {values, texels, fractions}) require_contiguous(array);
    mipbake::TexelQuads quads{};
    quads.values = read<float>(values);
    quads.texels = static_cast<const std::int64_t*>(texels.data());
    quads.fractions = read<float>(fractions);
    quads.points = size_of(texels, 0);
    quads.channels = static_cast<int>(values.shape(1));
    require(static_cast<Index>(fractions.size()) == 2 * quads.points, "fractions must be (points, 2)");
    require(std::all_of(quads.texels, quads.texels + 4 * quads.points,
                        [&](std::int64_t i) { return i >= 0 && i < size_of(values, 0); }),
            "an index is out of range");
    float* const to = write<float>(out, quads.points * quads.channels);
    const nb::gil_scoped_release unlocked;
    mipbake::texture_quads_cpu(quads, to);
}

// The shape of the finer level, after checking the coarser one's against it.
template <class A, class B>
mipbake::MipShape mip_shape(const A& finer, const B& coarser) {
    require(finer.ndim() == 4 && coarser.ndim() == 4, "levels must be (images, height, width, channels)");
    require(finer.dtype() == coarser.dtype(), "both levels must have the same dtype");
    require(finer.device_type() == coarser.device_type(), "every array must be on the same device");
    require_contiguous(finer);
    require_contiguous(coarser);
    for (const int axis : {1, 2}) {
        const std::size_t size = finer.shape(axis);
        require(size > 0 && coarser.shape(axis) == (size > 1 ? size / 2 : 1), "the coarser level has the wrong size");
    }
    require(finer.shape(0) == coarser.shape(0) && finer.shape(3) == coarser.shape(3),
            "both levels must have the same images and channels");
    return {static_cast<Index>(finer.shape(0)), static_cast<int>(finer.shape(1)), static_cast<int>(finer.shape(2)),
            static_cast<int>(finer.shape(3))};
}

void texture_mip(const Input& level, const Output& out, std::uintptr_t stream) {
    const mipbake::MipShape shape = mip_shape(level, out);
    const mipbake::Storage storage = storage_of(level.dtype());
    const void* const from = level.data();
    void* const to = out.data();
    launch(
        storage == mipbake::Storage::float64, level, stream,
        [&] { mipbake::texture_mip_cpu(shape, storage, from, to); },
        [&](auto queue) { mipbake::texture_mip_cuda(shape, storage, from, to, queue); });
}

template <class T>
void mip_backward_as(const Input& grad_out, const Output& grad, std::uintptr_t stream) {
    const mipbake::MipShape shape = mip_shape(grad, grad_out);
    const T* const from = read<T>(grad_out);
    T* const to = static_cast<T*>(grad.data());
    launch<T>(
        grad_out, stream, [&] { mipbake::texture_mip_backward_cpu(shape, from, to); },
        [&](auto queue) { mipbake::texture_mip_backward_cuda(shape, from, to, queue); });
}

void texture_mip_backward(const Input& grad_out, const Output& grad, std::uintptr_t stream) {
    if (grad.dtype() == nb::dtype<float>()) return mip_backward_as<float>(grad_out, grad, stream);
    mip_backward_as<double>(grad_out, grad, stream);
}

}  // namespace

void bind_texture(nb::module_& m) {
    using namespace nb::literals;
    m.def(
        "texture", &texture, "levels"_a, "uv"_a, "uv_da"_a.none(), "bias"_a.none(), "filter"_a, "boundary_u"_a,
        "boundary_v"_a, "out"_a, "stream"_a = 0,
        "Fills out (B, P, C) from levels (1 or B, H, W, C), or (1 or B, 6, S, S, C) of a cube, uv (1 or B, P, 2 or 3), "
        "uv_da (1 or B, P, 4 or 6) and bias (1 or B, 1 or P).");
    m.def(
        "texture_backward", &texture_backward, "grad"_a, "levels"_a, "uv"_a, "uv_da"_a.none(), "bias"_a.none(),
        "filter"_a, "boundary_u"_a, "boundary_v"_a, "level_grads"_a, "uv_grad"_a.none(), "uv_da_grad"_a.none(),
        "bias_grad"_a.none(), "stream"_a = 0,
        "Overwrites level_grads (one per level, or an empty list), and where they are not None uv_grad (B, P, 2 or 3), "
        "uv_da_grad (B, P, 4 or 6) and bias_grad (B, P), from grad (B, P, C). All C-contiguous, in the dtype of grad.");
    m.def("texture_taps", &texture_taps, "height"_a, "width"_a, "uv"_a, "boundary_u"_a, "boundary_v"_a, "texels"_a,
          "fractions"_a,
          "Fills texels (P, 4) int64 and fractions (P, 2): where bilinear lookups at uv (P, 2) lie in an image of a "
          "size.");
    m.def("texture_quads", &texture_quads, "values"_a, "texels"_a, "fractions"_a, "out"_a,
          "Fills out (P, C) with what such lookups make of values (N, C), of which texels (P, 4) holds the indices.");
    m.def("texture_mip", &texture_mip, "level"_a, "out"_a, "stream"_a = 0,
          "Fills out (N, max(1, H // 2), max(1, W // 2), C) from level (N, H, W, C) by area averaging.");
    m.def("texture_mip_backward", &texture_mip_backward, "grad_out"_a, "grad"_a, "stream"_a = 0,
          "Adds the adjoint of texture_mip to grad (N, H, W, C).");
}
