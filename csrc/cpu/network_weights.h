// Packed weights of a network, as its kernels take them.
#pragma once

#include <cstdint>
#include <utility>
#include <vector>

#include "cpu/network.h"

namespace mipbake {

// Memory on a boundary of 64 bytes, the widest register.
class Floats {
  public:
    explicit Floats(std::int64_t count = 0) : memory_(static_cast<std::size_t>(count) + 16) {
        const auto at = reinterpret_cast<std::uintptr_t>(memory_.data());
        begin_ = memory_.data() + (64 - at % 64) % 64 / sizeof(float);
    }
    Floats(const Floats&) = delete;
    Floats& operator=(const Floats&) = delete;
    Floats(Floats&&) noexcept = default;
    Floats& operator=(Floats&&) noexcept = default;
    float* data() const { return begin_; }

  private:
    std::vector<float> memory_;
    float* begin_;
};

struct PackedMemory {
    Floats weight, bias;
    std::vector<std::int32_t> offsets;
    PackedLayer packed;
};

class Network {
  public:
    explicit Network(const NetworkArgs& args);

    // Biases of the decoder's layers, one after the other, in whole blocks.
    std::vector<float> padded(const float* bias) const;

    NetworkCounts counts;
    KernelNetwork kernel{};

  private:
    PackedMemory whiten_;
    std::vector<PackedMemory> layers_;
    std::vector<PackedLayer> packed_;
    std::vector<std::pair<std::int64_t, std::int64_t>>
        biases_;  // of each layer of the decoder: own and in whole blocks
};

}  // namespace mipbake
