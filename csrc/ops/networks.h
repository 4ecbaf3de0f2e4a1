// What the core offers for networks: bakes of every level of a set.
#pragma once

#include <cstdint>
#include <memory>

#include "ops/runtime.h"

namespace mipbake {

// A layer of a network: (outputs, inputs, taps) weights and (outputs) biases, contiguous; taps are 1, or 9 of 3 x 3.
struct NetworkLayer {
    const float *weight, *bias;
    std::int64_t outputs, inputs;
    int taps;
};

// Limits of what is shaded: roughness, its logarithm and its fourth power.
struct NetworkLimits {
    float least_roughness, most_roughness, least_log_roughness, most_log_roughness, least_alpha2, most_alpha2;
};

// Networks whose latents are moments and learned maps (models/moment_network.py), and networks whose latents
// are all learned (models/latent_network.py).
enum class NetworkKind { moments, latents };

// The decoder of a moment network sees features and learned latents, then what its layers make; the last layer also
// what sharpening added, behind the others. That layer's outputs are the corrections, the sharpness of three parts and,
// where lobes are stretched, three more. The decoder of a latent network sees latents, and makes parameters.
struct NetworkArgs {
    NetworkKind kind;
    int read, made;  // 0 gltf, 1 gltf-anisotropic, 2 ggx, 3 beckmann; moment networks read what `made` says
    NetworkLimits limits;
    NetworkLayer whiten;  // of latent networks
    const NetworkLayer* encoder;
    int encoder_layers;
    NetworkLayer project;
    const NetworkLayer* decoder;
    int decoder_layers;
};
struct NetworkCounts {
    std::int64_t read, made, inputs, moments, detail, features, outputs;
};
// What such a network must have: channels that are read and made, and numbers of its parts.
NetworkCounts network_counts(NetworkKind kind, int read, int made);

// What each of `n` texels or rows of a level is summed from: (n, taps) of the finer ones, by the sharpened filter and
// by the plain one.
struct AxisWeights {
    const std::int32_t* index;
    const float *sharp, *plain;
    int n, taps;
};

// An image of latents that is filtered from a finer one: decoded as a level, or there for coarser ones, or both.
struct NetworkSink {
    int source;  // -1 for level 0, or the index of an earlier sink
    AxisWeights rows, columns;
    float* out;         // (rows.n, columns.n, made) of a level; null where nothing is decoded
    const float* bias;  // of all layers of the decoder for that level, one after the other
};

struct NetworkBakeArgs {
    const float* stored;  // (height, width, read)
    std::int64_t height, width;
    bool wrap_rows, wrap_columns;  // or clamped
    const float *sharp, *plain;    // 2 reach + 1 and 2 reach - 1 taps of level 0
    int reach;
    const float* bias;  // of the decoder for level 0
    float* top;         // (height, width, made)
    const NetworkSink* sinks;
    int sink_count;
};

// A part of a bake, for workers that share one. The rows that it reads stand in its image in the order of the whole.
struct NetworkPart {
    std::int64_t begin, end;  // rows of level 0 that are decoded, the first to `top`
    const float* latents;     // null, or (height, row_floats of the width) in place of `stored`, without level 0
    int kept;                 // the sink whose latents are kept for another part, or -1
    float* out;               // (rows.n, row_floats of columns.n) of that sink
};

class Network;  // packed weights

// Bakes every level of a set, some rows of level 0 at a time. What args point to must live as long. Results do not
// depend on the number of threads. Rows of `stored` are read from the top down, but for those that filters and the
// encoder reach beyond the rows that are baked, across the border where rows wrap. A row of a level is written once,
// when it is complete; all rows are after the last advance().
class NetworkBake {
  public:
    NetworkBake(std::shared_ptr<const Network> network, const NetworkBakeArgs& args);
    NetworkBake(std::shared_ptr<const Network> network, const NetworkBakeArgs& args, const NetworkPart& part);
    ~NetworkBake();
    std::int64_t rows_done() const;
    void advance();                                                          // the next rows
    static std::int64_t row_floats(const Network& network, std::int64_t n);  // of the latents of n texels
  private:
    struct State;
    std::unique_ptr<State> state_;
};
std::shared_ptr<const Network> packed_network(const NetworkArgs& args);

// The same bake on a card: of arrays of the host, which are complete when it returns. Results differ from those of
// NetworkBake by rounding. Beside level 0 the card holds the latents of every sink, and maps of half a million texels.
void network_bake_cuda(const NetworkArgs& network, const NetworkBakeArgs& args, CudaStream stream);

}  // namespace mipbake
