// The only door of the native core: plain pointers, sizes, strides, a stream.
#pragma once

#include <cstdint>

namespace mipbake {

// ---- Runtime ----

const char* active_isa_name();  // "baseline", "avx2" or "avx512": the instruction set of the CPU kernels
int num_threads();              // threads that a CPU kernel may use, the caller included
void set_num_threads(int count);
bool cuda_compiled();   // whether this build has CUDA kernels
bool cuda_available();  // whether it also finds a CUDA device to run them on

}  // namespace mipbake
