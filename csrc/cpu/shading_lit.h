// Between the dispatch in shading_lit.cpp, compiled once, and the kernels in shading_lit_kernels.cpp, compiled per
// instruction set.
#pragma once

#include "core/isa.h"
#include "ops/shading.h"

namespace mipbake {

// `lights` holds args.B * args.K times Light<S>, shade_light_bytes each, laid out alike in every instruction set.
// shade_points shades points [n0, n1) of a surface.
MIPBAKE_FOR_EACH_ISA(std::int64_t shade_light_bytes(bool is_double);
                     void shade_make_lights(const ShadeLitArgs&, void* lights);
                     void shade_points(const ShadeLitArgs&, std::int64_t surface, std::int64_t n0, std::int64_t n1,
                                       const void* lights, void* out);)

}  // namespace mipbake
