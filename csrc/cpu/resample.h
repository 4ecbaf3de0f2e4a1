// Between the schedule of resampling (resample.cpp, compiled once) and its kernel (resample_kernels.cpp, compiled once
// per instruction set).
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops/resample.h"

namespace mipbake {

// Numbers behind the end of the scratch: texels are read a register at a time.
constexpr std::int64_t resample_margin = 16;

MIPBAKE_FOR_EACH_ISA(
    // Rows [begin, end) of the output. `scratch` holds a row of the input, and resample_margin numbers more.
    template <class T>
    void resample_rows(const ResampleArgs<T>& args, T* scratch, T* out, std::int64_t begin, std::int64_t end);)

}  // namespace mipbake
