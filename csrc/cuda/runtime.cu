#include <cuda_runtime.h>

#include "ops/runtime.h"

namespace mipbake {

bool cuda_compiled() { return true; }

bool cuda_available() {
    int count = 0;
    if (cudaGetDeviceCount(&count) != cudaSuccess) {
        cudaGetLastError();  // no driver is an answer, not an error that a later call should find
        return false;
    }
    return count > 0;
}

}  // namespace mipbake
