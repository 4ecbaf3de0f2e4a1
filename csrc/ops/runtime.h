// What the core offers whatever the work is: instruction sets, threads, streams of a card.
#pragma once

#include <cstdint>

#include "core/environment.h"

namespace mipbake {

// These two and every kernel throw EnvironmentFault where MIPBAKE_ISA or MIPBAKE_THREADS holds what it cannot.
const char* active_isa_name();  // "baseline", "avx2" or "avx512": the instruction set of the CPU kernels
int num_threads();              // threads that a CPU kernel may use, the caller included
void set_num_threads(int count);
bool cuda_compiled();   // whether this build has CUDA kernels
bool cuda_available();  // whether it also finds a CUDA device to run them on

// A stream (a cudaStream_t) of a CUDA device. Functions that take one are defined where cuda_compiled(), for arrays of
// float in the memory of that device. They enqueue their work and do not wait for it. They throw std::runtime_error
// with CUDA's message.
struct CudaStream {
    int device;
    std::uintptr_t stream;
};

}  // namespace mipbake
