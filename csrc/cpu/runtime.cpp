#include "ops/runtime.h"

#include "core/isa.h"

namespace mipbake {

const char* active_isa_name() { return isa_name(active_isa()); }

#ifndef MIPBAKE_CUDA
bool cuda_compiled() { return false; }
bool cuda_available() { return false; }
#endif

}  // namespace mipbake
