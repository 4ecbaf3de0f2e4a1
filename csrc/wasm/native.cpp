// What mipbake/_wasm calls where no compiled core is: the functions of csrc/bind, as functions of C. Each takes words
// of 64 bits, which are the fields of structures of csrc/ops in their order: numbers, and addresses of arrays. Python
// has checked them.
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <type_traits>
#include <vector>

#include "ops/blocks.h"
#include "ops/networks.h"
#include "ops/raster.h"
#include "ops/resample.h"
#include "ops/shading.h"
#include "ops/texture.h"

#define MIPBAKE_EXPORT(name) extern "C" __attribute__((export_name(#name)))
#define MIPBAKE_CALL(name) MIPBAKE_EXPORT(name) void mipbake_##name(const std::int64_t* words)

namespace {

using namespace mipbake;

// Words in their order. Braces initialise fields from left to right.
class Words {
  public:
    explicit Words(const std::int64_t* words) : next_(words) {}

    template <class T, class = std::enable_if_t<std::is_scalar_v<T>>>
    operator T() {
        const std::int64_t word = *next_++;
        if constexpr (std::is_pointer_v<T>)
            return reinterpret_cast<T>(static_cast<std::uintptr_t>(word));
        else if constexpr (std::is_floating_point_v<T>)
            return static_cast<T>(*reinterpret_cast<const double*>(next_ - 1));
        else
            return static_cast<T>(word);
    }

    template <class... T>
    void fill(T&... fields) {
        ((fields = operator T()), ...);
    }

    template <class F>
    auto list(F&& read) {
        std::vector<decltype(read())> found(static_cast<std::size_t>(operator int()));
        for (auto& each : found) each = read();
        return found;
    }

  private:
    const std::int64_t* next_;
};

// Calls f with a number of the type that all arrays have.
template <class F>
void typed(Words& in, F&& f) {
    if (static_cast<bool>(in)) return f(0.0);
    f(0.0f);
}

StridedArray3 array(Words& in) { return {in, {in, in, in}}; }

StridedDirections directions(Words& in) {
    const StridedArray3 shared{in, {in, in, 0}};
    const std::int64_t texel = in;
    return {shared.data, {shared.strides[0], shared.strides[1], in}, texel};
}

ShadeArgs shading(Words& in) { return {in, in, in, in, in, array(in), directions(in), directions(in), in}; }

template <class T>
TextureArgs<T> lookups(Words& in) {
    TextureArgs<T> args{};
    in.fill(args.level_count, args.channels, args.storage, args.filter, args.boundary_u, args.boundary_v);
    for (int l = 0; l < args.level_count; ++l) {
        in.fill(args.heights[l], args.widths[l]);
        args.levels[l] = {in, in, in, in, in};
    }
    in.fill(args.batch, args.points, args.uv, args.uv_batch_stride, args.uv_point_stride);
    in.fill(args.uv_da, args.uv_da_batch_stride, args.uv_da_point_stride);
    in.fill(args.bias, args.bias_batch_stride, args.bias_point_stride);
    return args;
}

template <class T>
InterpolateArgs<T> attributes(Words& in) {
    return {in, in, in, in, in, in, in, in, in, in, in, in, in};
}

template <class T>
AntialiasArgs<T> silhouettes(Words& in) {
    return {in, in, in, in, in, in, in, in, in, in, in, in};
}

NetworkLayer layer(Words& in) { return {in, in, in, in, in}; }
AxisWeights axis(Words& in) { return {in, in, in, in, in}; }

std::shared_ptr<const Network> network(Words& in) {
    const auto read = [&] { return layer(in); };
    NetworkArgs args{in, in, in, {in, in, in, in, in, in}, layer(in), nullptr, 0, {}, nullptr, 0};
    const auto encoder = in.list(read);
    args.project = layer(in);
    const auto decoder = in.list(read);
    args.encoder = encoder.data();
    args.encoder_layers = static_cast<int>(encoder.size());
    args.decoder = decoder.data();
    args.decoder_layers = static_cast<int>(decoder.size());
    return packed_network(args);
}

// A bake, and what its arguments point to.
class Bake {
  public:
    explicit Bake(Words& in) {
        const auto packed = network(in);
        NetworkBakeArgs images{in, in, in, in, in, in, in, in, in, in, nullptr, 0};
        sinks_ = in.list([&] { return NetworkSink{in, axis(in), axis(in), in, in}; });
        images.sinks = sinks_.data();
        images.sink_count = static_cast<int>(sinks_.size());
        bake_ = std::make_unique<NetworkBake>(packed, images);
    }
    std::int64_t advance() {
        bake_->advance();
        return bake_->rows_done();
    }

  private:
    std::vector<NetworkSink> sinks_;
    std::unique_ptr<NetworkBake> bake_;
};

}  // namespace

// Memory for an array, aligned for every type; null where there is none left.
MIPBAKE_EXPORT(take) void* mipbake_take(std::size_t size) { return std::malloc(size); }
MIPBAKE_EXPORT(give) void mipbake_give(void* memory) { std::free(memory); }

// ---- Shading ----

MIPBAKE_EXPORT(model_count) int mipbake_model_count() { return model_count(); }
MIPBAKE_EXPORT(model_name) const char* mipbake_model_name(int model) { return model_info(model).name; }
MIPBAKE_EXPORT(model_channels) int mipbake_model_channels(int model) { return model_info(model).channels; }

MIPBAKE_CALL(shade) {
    Words in(words);
    const ShadeArgs args = shading(in);
    shade_cpu(args, in);
}

MIPBAKE_CALL(shade_backward) {
    Words in(words);
    const ShadeArgs args = shading(in);
    const void* const grad = in;
    void* const out = in;
    shade_backward_cpu(args, grad, out, in);
}

MIPBAKE_CALL(shade_directions_backward) {
    Words in(words);
    const ShadeArgs args = shading(in);
    const void* const grad = in;
    void* const to_light = in;
    shade_directions_backward_cpu(args, grad, to_light, in);
}

MIPBAKE_CALL(shade_lit) {
    Words in(words);
    const ShadeLitArgs args{in, in, in, in, in, in, {in, in, in}, in, {in, in, in, in}, in, {in, in, in}, in, in, in};
    shade_lit_cpu(args, in);
}

// ---- Texture ----

MIPBAKE_CALL(texture) {
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const TextureArgs<T> args = lookups<T>(in);
        texture_cpu<T>(args, in);
    });
}

MIPBAKE_CALL(texture_backward) {
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const TextureArgs<T> args = lookups<T>(in);
        TextureGrads<T> grads{};
        in.fill(grads.out);
        for (int l = 0; l < args.level_count; ++l) in.fill(grads.levels[l], grads.level_batch[l]);
        in.fill(grads.uv, grads.uv_da, grads.bias);
        texture_backward_cpu<T>(args, grads);
    });
}

MIPBAKE_CALL(texture_taps) {
    Words in(words);
    TextureArgs<float> args{};
    args.filter = Filter::linear;
    args.level_count = 1;
    args.batch = 1;
    args.uv_point_stride = 2;
    in.fill(args.heights[0], args.widths[0], args.boundary_u, args.boundary_v, args.points, args.uv);
    std::int64_t* const texels = in;
    texture_taps_cpu(args, texels, in);
}

MIPBAKE_CALL(texture_quads) {
    Words in(words);
    const TexelQuads quads{in, in, in, in, in};
    texture_quads_cpu(quads, in);
}

MIPBAKE_CALL(texture_mip) {
    Words in(words);
    const MipShape shape{in, in, in, in};
    const Storage storage = in;
    const void* const level = in;
    texture_mip_cpu(shape, storage, level, in);
}

MIPBAKE_CALL(texture_mip_backward) {
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const MipShape shape{in, in, in, in};
        const T* const grad_out = in;
        texture_mip_backward_cpu<T>(shape, grad_out, in);
    });
}

// ---- Meshes ----

MIPBAKE_CALL(check_mesh) {
    struct Mesh {
        const void* pos;
        bool instanced;
        std::int64_t items, vertices;
        const std::int32_t* tri;
        std::int64_t triangles;
        const std::int32_t* ranges;
        std::int64_t batch;
    };
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const Mesh m{in, in, in, in, in, in, in, in};
        check_mesh<T>(static_cast<const T*>(m.pos), m.instanced, m.items, m.vertices, m.tri, m.triangles, m.ranges,
                      m.batch);
    });
}

MIPBAKE_CALL(rasterize) {
    Words in(words);
    typed(in, [&](auto zero) { rasterize_cpu<decltype(zero)>({in, in, in, in, in, in, in, in, in, in, in, in}, 0); });
}

MIPBAKE_CALL(rasterize_backward) {
    Words in(words);
    typed(in,
          [&](auto zero) { rasterize_backward_cpu<decltype(zero)>({in, in, in, in, in, in, in, in, in, in, in, in}); });
}

MIPBAKE_CALL(interpolate) {
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const InterpolateArgs<T> args = attributes<T>(in);
        T* const out = in;
        interpolate_cpu<T>(args, out, in);
    });
}

MIPBAKE_CALL(interpolate_backward) {
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const InterpolateArgs<T> args = attributes<T>(in);
        interpolate_backward_cpu<T>(args, {in, in, in, in, in});
    });
}

MIPBAKE_CALL(antialias_topology) {
    Words in(words);
    const std::int32_t* const tri = in;
    const std::int64_t triangles = in, vertices = in;
    antialias_topology_cpu(tri, triangles, vertices, in);
}

MIPBAKE_CALL(antialias) {
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const AntialiasArgs<T> args = silhouettes<T>(in);
        antialias_cpu<T>(args, in);
    });
}

MIPBAKE_CALL(antialias_backward) {
    Words in(words);
    typed(in, [&](auto zero) {
        using T = decltype(zero);
        const AntialiasArgs<T> args = silhouettes<T>(in);
        antialias_backward_cpu<T>(args, {in, in, in, in});
    });
}

// ---- Images ----

MIPBAKE_CALL(resample) {
    Words in(words);
    const ResampleArgs<float> args{in, in, in, in, {in, in, in, in}, {in, in, in, in}};
    resample_cpu<float>(args, in);
}

MIPBAKE_CALL(encode_blocks) {
    Words in(words);
    const BlockArgs args{in, in, in, in, in};
    encode_blocks_cpu(args, in);
}

MIPBAKE_CALL(decode_blocks) {
    Words in(words);
    const BlockArgs size{in, in, in, nullptr, nullptr};
    const std::uint8_t* const blocks = in;
    decode_blocks_cpu(size.format, size.height, size.width, blocks, in);
}

// ---- Networks ----

MIPBAKE_CALL(network_counts) {
    Words in(words);
    const NetworkKind kind = in;
    const int read = in, made = in;
    const NetworkCounts counts = network_counts(kind, read, made);
    NetworkCounts* const out = in;
    *out = counts;
}

MIPBAKE_CALL(network_check) {
    Words in(words);
    static_cast<void>(network(in));
}

// The words are those of a network and of a bake. The arrays of the bake must live as long as it.
MIPBAKE_EXPORT(bake_begin) void* mipbake_bake_begin(const std::int64_t* words) {
    Words in(words);
    return std::make_unique<Bake>(in).release();
}
// Bakes the next rows; gives how many rows of level 0 are done.
MIPBAKE_EXPORT(bake_advance) std::int64_t mipbake_bake_advance(Bake* bake) { return bake->advance(); }
