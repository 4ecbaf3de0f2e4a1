// Networks on the GPU: the passes of network/images.h. Layers have kernels of their own, whose blocks share weights.
#include <vector>

#include "cuda/launch.h"
#include "network/images.h"

namespace mipbake {
namespace {

using namespace cuda;
using network::kTexelsOfThread, network::LayerPass;

template <class Pass>
__global__ void pass_kernel(Index planes, int rows, int columns, const __grid_constant__ Pass pass) {
    for_each_pixel(planes, rows, columns, [&](Index z, int y, int x, Index) { pass(z, y, x); });
}

constexpr int kAcross = kTexelsOfThread * block_width;  // texels that a row of a block works on

// Grid: blocks of texels, times blocks of outputs, which read the same texels and so lie side by side.
template <int G, int taps>
__global__ void __launch_bounds__(threads_per_block) layer_kernel(const __grid_constant__ LayerPass pass) {
    constexpr int most = taps == 1 ? 64 : 8;                  // inputs whose weights are shared at once
    __shared__ __align__(16) float weights[most * taps * G];  // so that four are loaded at once
    const int blocks = (pass.outputs + G - 1) / G, block = static_cast<int>(blockIdx.x % blocks);
    const int left = static_cast<int>(blockIdx.x / blocks) * kAcross + static_cast<int>(threadIdx.x);
    const int y = static_cast<int>(blockIdx.y * block_height + threadIdx.y);
    // Threads beyond the image work on its last texels, because all of them load weights.
    const int row = min(y, pass.rows - 1), last = pass.columns - 1;
    const int x[] = {min(left, last), min(left + block_width, last)};
    static_assert(kTexelsOfThread == 2);
    float sums[kTexelsOfThread][G];
    pass.begin(block, sums);
    for (int first = 0; first < pass.inputs; first += most) {
        const int count = min(most, pass.inputs - first);
        const float* const from = pass.weight + (Index(block) * pass.inputs + first) * taps * G;
        __syncthreads();
        for (int i = static_cast<int>(threadIdx.y) * block_width + static_cast<int>(threadIdx.x); i < count * taps * G;
             i += threads_per_block)
            weights[i] = from[i];
        __syncthreads();
        pass.add<G, taps>(weights, first, count, row, x, sums);
    }
    if (y >= pass.rows) return;
    if (left <= last) pass.end(block, y, left, sums[0]);
    if (left + block_width <= last) pass.end(block, y, left + block_width, sums[1]);
}

// The machine of network/images.h.
class Card {
  public:
    explicit Card(CudaStream stream) : queue_(stream) {}
    Card(const Card&) = delete;
    Card& operator=(const Card&) = delete;
    ~Card() {
        for (void* const each : memory_) cudaFree(each);  // waits for what uses it
    }

    template <class T>
    T* room(Index count) {
        void* memory = nullptr;
        check(cudaMalloc(&memory, static_cast<std::size_t>(std::max<Index>(1, count)) * sizeof(T)));
        memory_.push_back(memory);
        return static_cast<T*>(memory);
    }
    template <class T>
    void put(T* there, const T* here, Index count) const {
        queue_.copy(there, here, count, cudaMemcpyHostToDevice);
    }
    template <class T>
    void get(T* here, const T* there, Index count) const {
        queue_.copy(here, there, count, cudaMemcpyDeviceToHost);
    }
    void clear(float* there, Index count) const { queue_.fill(there, count); }

    template <class Pass>
    void each(Index planes, int rows, int columns, const Pass& pass) const {
        queue_.run_pixels(planes, rows, columns, pass_kernel<Pass>, planes, rows, columns, pass);
    }
    template <int G, int taps>
    void layer(const LayerPass& pass) const {
        const dim3 blocks = grid_of(blocks_for(pass.columns, kAcross) * blocks_for(pass.outputs, G),
                                    blocks_for(pass.rows, block_height));
        queue_.run(blocks, dim3(block_width, block_height), layer_kernel<G, taps>, pass);
    }

  private:
    Queue queue_;
    std::vector<void*> memory_;
};

}  // namespace

void network_bake_cuda(const NetworkArgs& network, const NetworkBakeArgs& args, CudaStream stream) {
    Card card(stream);
    network::ImageBake<Card>(card, network, args).run();
}

}  // namespace mipbake
