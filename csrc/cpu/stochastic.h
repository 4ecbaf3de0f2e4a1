// Between the schedule of stochastic gradients (stochastic.cpp, compiled once) and its kernels (stochastic_kernels.cpp,
// compiled once per instruction set).
#pragma once

#include <cstdint>

#include "core/isa.h"
#include "ops/stochastic.h"

namespace mipbake {

MIPBAKE_FOR_EACH_ISA(
    // Elements [begin, end) of the list.
    template <class T> void perturb_range(const PerturbArgs<T>& args, std::int64_t begin, std::int64_t end);
    template <class T> void gradient_range(const GradientArgs<T>& args, std::int64_t begin, std::int64_t end);
    template <class T> void adam_range(const AdamArgs<T>& args, std::int64_t begin, std::int64_t end);
    // Pixels [begin, end).
    template <class T> void differences_range(const T* plus, const T* minus, const T* reference, const T* weights,
                                              std::int64_t begin, std::int64_t end, std::int64_t channels, T* out);
    void touched_range(const TouchedArgs& args, std::int64_t begin, std::int64_t end, std::int32_t* texels);)

}  // namespace mipbake
