// How every kernel is launched: by how many threads, on which stream, and what becomes of CUDA's errors.
#pragma once

#include <cuda_runtime.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>
#include <string>

#include "ops/runtime.h"

namespace mipbake {
namespace cuda {

using Index = std::int64_t;

// A block of a line of numbers, and one of an image.
constexpr int block_width = 32, block_height = 8, threads_per_block = block_width * block_height;
// Blocks of a grid along its first axis, and along either of the others.
constexpr Index most_blocks = 2147483647, most_blocks_across = 65535;

inline void check(cudaError_t status) {
    if (status == cudaSuccess) return;
    cudaGetLastError();  // a later call is not to find it
    throw std::runtime_error(std::string("CUDA: ") + cudaGetErrorString(status));
}

constexpr Index blocks_for(Index count, Index of_a_block) { return (count + of_a_block - 1) / of_a_block; }

// Kernels take the blocks of a batch that are more than a grid has along its last axis in a loop.
inline dim3 grid_of(Index x, Index y = 1, Index batch = 1) {
    if (x > most_blocks || y > most_blocks_across)
        throw std::runtime_error("CUDA: arrays are larger than one launch can work on; pass them in parts");
    return {static_cast<unsigned>(x), static_cast<unsigned>(y),
            static_cast<unsigned>(std::min(batch, most_blocks_across))};
}

// A stream whose device is the current one.
class Queue {
  public:
    explicit Queue(CudaStream to) : stream_(reinterpret_cast<cudaStream_t>(to.stream)) {
        // The module links a CUDA runtime of its own, which has its own idea of the current device.
        check(cudaSetDevice(to.device));
    }

    // Every byte of `count` numbers.
    template <class T>
    void fill(T* numbers, Index count, int byte = 0) const {
        check(cudaMemsetAsync(numbers, byte, static_cast<std::size_t>(count) * sizeof(T), stream_));
    }

    // `count` numbers between the memory of the host and that of the device; waits until they are there.
    template <class T>
    void copy(T* to, const T* from, Index count, cudaMemcpyKind kind) const {
        check(cudaMemcpyAsync(to, from, static_cast<std::size_t>(count) * sizeof(T), kind, stream_));
        check(cudaStreamSynchronize(stream_));
    }

    // No block is nothing to do.
    template <class... Parameters, class... Arguments>
    void run(dim3 blocks, dim3 threads, void (*kernel)(Parameters...), const Arguments&... arguments) const {
        if (blocks.x == 0 || blocks.y == 0 || blocks.z == 0) return;
        kernel<<<blocks, threads, 0, stream_>>>(arguments...);
        check(cudaGetLastError());
    }

    // A kernel that takes `count` numbers with for_each.
    template <class... Parameters, class... Arguments>
    void run_each(Index count, void (*kernel)(Parameters...), const Arguments&... arguments) const {
        run(grid_of(blocks_for(count, threads_per_block)), threads_per_block, kernel, arguments...);
    }

    // A kernel that takes the pixels of images with for_each_pixel.
    template <class... Parameters, class... Arguments>
    void run_pixels(Index batch, int height, int width, void (*kernel)(Parameters...),
                    const Arguments&... arguments) const {
        run(grid_of(blocks_for(width, block_width), blocks_for(height, block_height), batch),
            dim3(block_width, block_height), kernel, arguments...);
    }

  private:
    cudaStream_t stream_;
};

// Calls f(i) for the number i of [0, count) that is this thread's.
template <class F>
__device__ void for_each(Index count, F&& f) {
    const Index i = Index(blockIdx.x) * blockDim.x + threadIdx.x;
    if (i < count) f(i);
}

// Calls f(item, y, x, pixel of the batch) for the pixels that are this thread's.
template <class F>
__device__ void for_each_pixel(Index batch, int height, int width, F&& f) {
    const unsigned x = blockIdx.x * blockDim.x + threadIdx.x, y = blockIdx.y * blockDim.y + threadIdx.y;
    if (x >= static_cast<unsigned>(width) || y >= static_cast<unsigned>(height)) return;
    for (Index item = blockIdx.z; item < batch; item += gridDim.z)
        f(item, static_cast<int>(y), static_cast<int>(x), (item * height + y) * width + x);
}

}  // namespace cuda
}  // namespace mipbake
