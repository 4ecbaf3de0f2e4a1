#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>

#include <cstdint>
#include <optional>
#include <stdexcept>

#include "ops.h"

namespace nb = nanobind;

namespace {

using Input = nb::ndarray<nb::ro>;
using Output = nb::ndarray<>;
using MaybeOutput = std::optional<Output>;

constexpr int cuda_device = nb::device::cuda::value;

// The Python modules that call these functions check every argument; this catches a mistake of theirs, not a user's.
void require(bool condition, const char* what) {
    if (!condition) throw std::invalid_argument(what);
}

std::int64_t size_of(const Input& array, int axis) { return static_cast<std::int64_t>(array.shape(axis)); }

// 0 where the axis has one element that is repeated.
std::int64_t step(const Input& array, int axis) { return array.shape(axis) == 1 ? 0 : array.stride(axis); }

template <class T>
const T* read(const Input& array) {
    require(array.dtype() == nb::dtype<T>(), "every array must have the same dtype");
    return static_cast<const T*>(array.data());
}

template <class T>
T* write(const Output& array, std::int64_t size) {
    require(array.dtype() == nb::dtype<T>(), "every array must have the same dtype");
    require(static_cast<std::int64_t>(array.size()) == size, "an output has the wrong size");
    std::int64_t contiguous = 1;
    for (std::size_t i = array.ndim(); i-- > 0; contiguous *= static_cast<std::int64_t>(array.shape(i)))
        require(array.shape(i) == 1 || size == 0 || array.stride(i) == contiguous, "an output is not C-contiguous");
    return static_cast<T*>(array.data());
}

template <class T>
mipbake::SampleArgs<T> arguments(const nb::list& levels, const Input& uv, const Input& lod, bool wrap_u, bool wrap_v,
                                 std::int64_t batch) {
    mipbake::SampleArgs<T> args{};
    args.level_count = static_cast<int>(levels.size());
    require(args.level_count >= 1 && args.level_count <= mipbake::max_levels, "1 to 32 levels");
    for (int l = 0; l < args.level_count; ++l) {
        const Input level = nb::cast<Input>(levels[static_cast<std::size_t>(l)]);
        require(level.ndim() == 4 && level.size() > 0, "a level must be (batch, height, width, channels)");
        require(level.shape(3) == 1 || level.stride(3) == 1, "the channels of a texel must be consecutive");
        require(level.shape(0) == 1 || size_of(level, 0) == batch, "the levels' batch must be 1 or the lookups'");
        require(level.device_type() == uv.device_type(), "every array must be on the same device");
        const int channels = static_cast<int>(level.shape(3));
        require(l == 0 || channels == args.channels, "every level must have the same channels");
        args.channels = channels;
        args.levels[l] = {read<T>(level),
                          step(level, 0),
                          level.stride(1),
                          level.stride(2),
                          static_cast<int>(level.shape(1)),
                          static_cast<int>(level.shape(2))};
    }
    require(uv.ndim() == 3 && uv.shape(2) == 2 && uv.stride(2) == 1, "uv must be (batch, points, 2)");
    require(lod.ndim() == 2, "lod must be (batch, points)");
    require(lod.shape(1) == 1 || lod.shape(1) == uv.shape(1), "lod must have 1 point or those of uv");
    require(uv.shape(0) == 1 || size_of(uv, 0) == batch, "the batch of uv must be 1 or the result's");
    require(lod.shape(0) == 1 || size_of(lod, 0) == batch, "the batch of lod must be 1 or the result's");
    args.wrap_u = wrap_u;
    args.wrap_v = wrap_v;
    args.batch = batch;
    args.points = size_of(uv, 1);
    args.uv = read<T>(uv);
    args.uv_batch_stride = step(uv, 0);
    args.uv_point_stride = uv.stride(1);
    args.lod = read<T>(lod);
    args.lod_batch_stride = step(lod, 0);
    args.lod_point_stride = step(lod, 1);
    return args;
}

// Raises what CUDA reports; `status` is null where all is well.
void check_cuda(const char* status) {
    if (status != nullptr) throw std::runtime_error(status);
}

template <class T>
void sample_as(const nb::list& levels, const Input& uv, const Input& lod, bool wrap_u, bool wrap_v, const Output& out,
               std::uintptr_t stream) {
    const mipbake::SampleArgs<T> args =
        arguments<T>(levels, uv, lod, wrap_u, wrap_v, static_cast<std::int64_t>(out.shape(0)));
    T* const target = write<T>(out, args.batch * args.points * args.channels);
    const bool on_cuda = out.device_type() == cuda_device;
    require(out.device_type() == uv.device_type(), "every array must be on the same device");
    const int device = out.device_id();
    const nb::gil_scoped_release unlocked;
    if (!on_cuda) return mipbake::sample_cpu(args, target);
#ifdef MIPBAKE_CUDA
    if constexpr (sizeof(T) == sizeof(float))
        return check_cuda(mipbake::sample_cuda(args, target, device, reinterpret_cast<void*>(stream)));
#endif
    static_cast<void>(device);
    static_cast<void>(stream);
    require(false, "no CUDA kernel for this dtype in this build");
}

void sample(const nb::list& levels, const Input& uv, const Input& lod, bool wrap_u, bool wrap_v, const Output& out,
            std::uintptr_t stream) {
    require(out.ndim() == 3, "the output must be (batch, points, channels)");
    if (out.dtype() == nb::dtype<float>()) return sample_as<float>(levels, uv, lod, wrap_u, wrap_v, out, stream);
    sample_as<double>(levels, uv, lod, wrap_u, wrap_v, out, stream);
}

template <class T>
void backward_as(const Input& grad, const nb::list& levels, const Input& uv, const Input& lod, bool wrap_u, bool wrap_v,
                 const nb::list& level_grads, const MaybeOutput& uv_grad, const MaybeOutput& lod_grad,
                 std::uintptr_t stream) {
    const mipbake::SampleArgs<T> args =
        arguments<T>(levels, uv, lod, wrap_u, wrap_v, static_cast<std::int64_t>(grad.shape(0)));
    const std::int64_t lookups = args.batch * args.points;
    mipbake::SampleGrads<T> grads{};
    grads.out = read<T>(grad);
    grads.level_batch = 1;
    require(static_cast<std::int64_t>(grad.size()) == lookups * args.channels, "the gradient has the wrong size");
    require(level_grads.size() == 0 || static_cast<int>(level_grads.size()) == args.level_count,
            "a gradient per level");
    for (int l = 0; l < static_cast<int>(level_grads.size()); ++l) {
        const Output target = nb::cast<Output>(level_grads[static_cast<std::size_t>(l)]);
        const std::int64_t items = static_cast<std::int64_t>(target.shape(0));
        require(items == (args.levels[l].batch_stride == 0 ? 1 : args.batch), "a level's gradient has another batch");
        grads.level_batch = items;
        grads.levels[l] =
            write<T>(target, items * args.levels[l].height * args.levels[l].width * std::int64_t(args.channels));
    }
    if (uv_grad) grads.uv = write<T>(*uv_grad, lookups * 2);
    if (lod_grad) grads.lod = write<T>(*lod_grad, lookups);
    const bool on_cuda = grad.device_type() == cuda_device;
    require(grad.device_type() == uv.device_type(), "every array must be on the same device");
    const int device = grad.device_id();
    const nb::gil_scoped_release unlocked;
    if (!on_cuda) return mipbake::sample_backward_cpu(args, grads);
#ifdef MIPBAKE_CUDA
    if constexpr (sizeof(T) == sizeof(float))
        return check_cuda(mipbake::sample_backward_cuda(args, grads, device, reinterpret_cast<void*>(stream)));
#endif
    static_cast<void>(device);
    static_cast<void>(stream);
    require(false, "no CUDA kernel for this dtype in this build");
}

void sample_backward(const Input& grad, const nb::list& levels, const Input& uv, const Input& lod, bool wrap_u,
                     bool wrap_v, const nb::list& level_grads, const MaybeOutput& uv_grad, const MaybeOutput& lod_grad,
                     std::uintptr_t stream) {
    require(grad.ndim() == 3, "the gradient must be (batch, points, channels)");
    const auto backward = grad.dtype() == nb::dtype<float>() ? backward_as<float> : backward_as<double>;
    backward(grad, levels, uv, lod, wrap_u, wrap_v, level_grads, uv_grad, lod_grad, stream);
}

}  // namespace

void bind_sampling(nb::module_& m) {
    using namespace nb::literals;
    m.def("sample", &sample, "levels"_a, "uv"_a, "lod"_a, "wrap_u"_a, "wrap_v"_a, "out"_a, "stream"_a = 0,
          "Fills out (B, P, C) from levels (1 or B, H, W, C), uv (1 or B, P, 2) and lod (1 or B, 1 or P).");
    m.def("sample_backward", &sample_backward, "grad"_a, "levels"_a, "uv"_a, "lod"_a, "wrap_u"_a, "wrap_v"_a,
          "level_grads"_a, "uv_grad"_a.none(), "lod_grad"_a.none(), "stream"_a = 0,
          "Overwrites level_grads (one per level, or an empty list), uv_grad (B, P, 2) and lod_grad (B, P), the latter "
          "two "
          "if they are not None, from grad (B, P, C), C-contiguous.");
}
