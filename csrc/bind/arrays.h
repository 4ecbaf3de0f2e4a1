// Arrays that Python hands over: checks, pointers, and the choice between the CPU and CUDA.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <stdexcept>
#include <string>

namespace nb = nanobind;

namespace mipbake {
namespace bind {

using Input = nb::ndarray<nb::ro>;
using Output = nb::ndarray<>;
using Index = std::int64_t;

// The Python modules check what users pass; these checks keep a mistake of theirs from reading out of bounds.
template <class Array>
void require(const Array& a, nb::dlpack::dtype dtype, const Input& like, const char* name,
             std::initializer_list<Index> shape) {
    bool good = a.ndim() == shape.size() && a.dtype() == dtype && a.device_type() == like.device_type() &&
                a.device_id() == like.device_id();
    Index stride = 1;
    for (std::size_t i = shape.size(); good && i-- > 0;) {
        const Index size = shape.begin()[i];
        good = static_cast<Index>(a.shape(i)) == size && (size == 1 || a.size() == 0 || a.stride(i) == stride);
        stride *= size;
    }
    if (!good) throw std::invalid_argument(std::string("unexpected shape, strides, dtype or device of ") + name);
}

template <class T, class Array>
auto data(const std::optional<Array>& a) {
    return a ? static_cast<T*>(a->data()) : nullptr;
}

// Calls on_cpu() or on_cuda(device) without Python's lock.
template <class T, class Cpu, class Cuda>
void launch(const Input& like, Cpu&& on_cpu, Cuda&& on_cuda) {
    const bool on_gpu = like.device_type() == nb::device::cuda::value;
    const int device = like.device_id();
    const nb::gil_scoped_release unlocked;
    if (!on_gpu) return on_cpu();
#ifdef MIPBAKE_CUDA
    if constexpr (sizeof(T) == sizeof(float)) {
        if (const char* const error = on_cuda(device)) throw std::runtime_error(std::string("CUDA: ") + error);
        return;
    }
#endif
    static_cast<void>(device);
    static_cast<void>(on_cuda);
    throw std::invalid_argument("no CUDA kernel for this dtype in this build");
}

}  // namespace bind
}  // namespace mipbake
