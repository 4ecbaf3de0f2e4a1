// What a thread does in the passes of images.h: one texel of the network of its kind at a time, or some of a layer.
#pragma once

#include "network/parameters.h"
#include "ops/networks.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace network {

using Index = std::int64_t;

// Number (z, y, x) is at[z * plane + y * row + x].
struct Planes {
    float* at;
    Index plane, row;

    MIPBAKE_INLINE float* of(Index z, Index y, Index x) const { return at + z * plane + y * row + x; }
    MIPBAKE_INLINE Planes from(Index z, Index y, Index x) const { return {of(z, y, x), plane, row}; }
    MIPBAKE_INLINE Walk<float> walk(Index y, Index x) const { return {of(0, y, x), plane}; }
    MIPBAKE_INLINE Means<float> means(Index y, Index x) const { return {of(0, y, x), plane}; }
};

// What differs between kinds of networks. M is a model of models.h.
template <class M>
struct MomentTexel {
    using R = typename M::Read;
    static constexpr int read = R::channels, made = M::channels, outputs = output_count<R>;

    template <class Channel>
    static MIPBAKE_INLINE void encode(Channel&& channel, const Limits& limits, Walk<float> inputs, bool inside,
                                      Walk<float> moments) {
        const auto texel = Texel<R, float>::of(channel);
        put_inputs(texel, limits, inputs);
        if (inside) put_moments(texel, limits, moments);
    }
    static MIPBAKE_INLINE void features(Means<float> mean, const Limits& limits, Walk<float> out) {
        put_features(statistics<R, float>(mean, limits), out);
    }
    static MIPBAKE_INLINE void store(Means<float> mean, Means<float> said, Means<float> detail, const Limits& limits,
                                     Walk<float> out) {
        const auto changes = Outputs<R, float>::of(said);
        said.at += outputs * said.stride;
        const auto added = Added<R, float>::of(detail, said);
        said.at += kCrisp * said.stride;
        put_channels<M>(statistics<R, float>(mean, limits), changes, added, said, limits, out);
    }
};

template <class M>
struct LatentTexel {
    static constexpr int read = M::channels, made = M::channels;

    template <class Channel>
    static MIPBAKE_INLINE void encode(Channel&& channel, const Limits&, Walk<float> inputs, bool, Walk<float>) {
        put_parameters<M, float>(channel, inputs);
    }
    static MIPBAKE_INLINE void features(Means<float>, const Limits&, Walk<float>) {}
    static MIPBAKE_INLINE void store(Means<float>, Means<float> said, Means<float>, const Limits& limits,
                                     Walk<float> out) {
        put_stored<M, float>(said, limits, out);
    }
};

// Calls f(K()) with what is done to texels of a model by its index.
template <class F>
void visit_texel(NetworkKind kind, int model, F&& f) {
    visit_model(model, [&](auto found) {
        using M = decltype(found);
        if (kind == NetworkKind::moments)
            f(MomentTexel<M>());
        else
            f(LatentTexel<M>());
    });
}

MIPBAKE_INLINE Index placed(Index at, Index size, bool wrap) {
    if (!wrap) return at < 0 ? 0 : at < size ? at : size - 1;
    const Index rest = at % size;
    return rest < 0 ? rest + size : rest;
}

// Texels of level 0, from (first_row, first_column) on and beyond its borders too, as inputs of the encoder. The
// latents that are not learned are those of the texels without the halo.
template <class K>
struct EncodePass {
    const float* stored;
    Index height, width, first_row, first_column;
    bool wrap_rows, wrap_columns;
    int rows, columns, halo;
    Limits limits;
    Planes inputs, moments;

    MIPBAKE_FUNCTION void operator()(Index, int y, int x) const {
        const Index row = placed(first_row + y, height, wrap_rows);
        const Index column = placed(first_column + x, width, wrap_columns);
        const float* const texel = stored + (row * width + column) * K::read;
        const bool inside = y >= halo && y < rows - halo && x >= halo && x < columns - halo;
        K::encode([&](int c) { return texel[c]; }, limits, inputs.walk(y, x), inside, moments.walk(y - halo, x - halo));
    }
};

constexpr int kTexelsOfThread = 2;

// out = weight * in + bias for images of texels. Weights are packed as [block of G outputs][input][tap][output of the
// block]; taps are 1, or 9 of 3 x 3.
struct LayerPass {
    const float *weight, *bias;
    int outputs, inputs;
    bool rectified;
    Planes in, out;  // at the first texel
    int rows, columns;

    // Adds what inputs [first, first + count) say of texels at `x` of a row. `packed`: weights from the first input on.
    template <int G, int taps>
    MIPBAKE_INLINE void add(const float* packed, int first, int count, int y, const int (&x)[kTexelsOfThread],
                            float (&sums)[kTexelsOfThread][G]) const {
        for (int k = 0; k < count; ++k) {
            const float* const from = in.of(first + k, y, 0);
            for (int tap = 0; tap < taps; ++tap, packed += G) {
                const Index moved = taps == 1 ? 0 : (tap / 3 - 1) * in.row + tap % 3 - 1;
                for (int p = 0; p < kTexelsOfThread; ++p) {
                    const float seen = from[moved + x[p]];
                    for (int g = 0; g < G; ++g) sums[p][g] += packed[g] * seen;
                }
            }
        }
    }
    template <int G>
    MIPBAKE_INLINE void begin(int block, float (&sums)[kTexelsOfThread][G]) const {
        for (int g = 0; g < G; ++g)
            for (int p = 0; p < kTexelsOfThread; ++p) sums[p][g] = block * G + g < outputs ? bias[block * G + g] : 0.0f;
    }
    template <int G>
    MIPBAKE_INLINE void end(int block, int y, int x, const float (&sums)[G]) const {
        for (int g = 0; g < G; ++g)
            if (block * G + g < outputs)
                *out.of(block * G + g, y, x) = rectified ? larger(sums[g], sums[g] * kSlope) : sums[g];
    }
};

// Sums of taps along one axis. Planes below `sharp_planes` are filtered by `sharp`, further ones by `plain`, from the
// plane `moved` before.
struct GatherPass {
    Planes in, out;
    const std::int32_t* index;  // (n, taps)
    const float *sharp, *plain;
    int taps, sharp_planes, moved;
    bool down;        // along rows of the image, else along its columns
    int first, last;  // places that `in` has, the first of them at its beginning; taps of others are left out
    bool more;        // whether sums are added to what is there

    MIPBAKE_FUNCTION void operator()(Index z, int y, int x) const {
        const Index own = static_cast<Index>(down ? y : x) * taps;
        const bool is_sharp = z < sharp_planes;
        const float* const weights = (is_sharp ? sharp : plain) + own;
        const float* const from = in.of(is_sharp ? z : z - moved, down ? 0 : y, down ? x : 0);
        const Index step = down ? in.row : 1;
        float sum = 0;
        for (int k = 0; k < taps; ++k) {
            const int place = index[own + k];
            if (place >= first && place < last) sum += weights[k] * from[(place - first) * step];
        }
        float* const to = out.of(z, y, x);
        *to = more ? *to + sum : sum;
    }
};

// What the decoder sees of filtered latents: features and learned latents, and far behind them what sharpening added.
template <class K>
struct FeaturesPass {
    Planes latents, out;
    int moments, learned, features, detail, detail_plane;
    Limits limits;

    MIPBAKE_FUNCTION void operator()(Index, int y, int x) const {
        K::features(latents.means(y, x), limits, out.walk(y, x));
        for (int z = 0; z < learned; ++z) *out.of(features + z, y, x) = *latents.of(moments + z, y, x);
        for (int z = 0; z < detail; ++z)
            *out.of(detail_plane + z, y, x) =
                (*latents.of(z, y, x) - *latents.of(moments + learned + z, y, x)) * kDetailScale;
    }
};

// Stored channels from what the decoder says.
template <class K>
struct StorePass {
    Planes latents, said, detail;
    Limits limits;
    float* out;  // (rows, columns, channels)
    int columns;

    MIPBAKE_FUNCTION void operator()(Index, int y, int x) const {
        const Index texel = static_cast<Index>(y) * columns + x;
        K::store(latents.means(y, x), said.means(y, x), detail.means(y, x), limits,
                 Walk<float>{out + texel * K::made, 1});
    }
};

}  // namespace network
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
