// Arrays that Python hands over: checks, pointers, and the choice between the CPU and CUDA.
#pragma once

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cstdint>
#include <initializer_list>
#include <optional>
#include <stdexcept>
#include <string>

#include "ops/runtime.h"

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

// Calls on_cpu(), or on_cuda(stream) for arrays of CUDA, without Python's lock. CUDA's kernels are for float alone, so
// that on_cuda must be generic where T may be double.
template <class T, class Cpu, class Cuda>
void launch(const Input& like, std::uintptr_t stream, Cpu&& on_cpu, Cuda&& on_cuda) {
    const bool on_gpu = like.device_type() == nb::device::cuda::value;
    [[maybe_unused]] const CudaStream queue{like.device_id(), stream};
    static_cast<void>(on_cuda);
    const nb::gil_scoped_release unlocked;
    if (!on_gpu) return on_cpu();
#ifdef MIPBAKE_CUDA
    if constexpr (sizeof(T) == sizeof(float)) return on_cuda(queue);
#endif
    throw std::invalid_argument("no CUDA kernel for this dtype in this build");
}

// The same for a type that is known when the program runs.
template <class Cpu, class Cuda>
void launch(bool is_double, const Input& like, std::uintptr_t stream, Cpu&& on_cpu, Cuda&& on_cuda) {
    if (is_double) return launch<double>(like, stream, on_cpu, on_cuda);
    launch<float>(like, stream, on_cpu, on_cuda);
}

}  // namespace bind
}  // namespace mipbake
