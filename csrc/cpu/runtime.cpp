#include <stdexcept>

#include "core/isa.h"
#include "ops.h"

namespace mipbake {

const char* active_isa_name() { return isa_name(active_isa()); }

#ifndef MIPBAKE_CUDA
bool cuda_compiled() { return false; }
bool cuda_available() { return false; }

void shade_cuda(const ShadeArgs&, void*, int, std::uintptr_t) { throw std::runtime_error("built without CUDA"); }
void shade_backward_cuda(const ShadeArgs&, const void*, void*, int, std::uintptr_t) {
    throw std::runtime_error("built without CUDA");
}
#endif

}  // namespace mipbake
