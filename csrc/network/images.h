// A bake as passes over whole images, for machines with so many threads that each of them works on a texel: what a
// thread does, and in which order passes run. Machine says where memory lies and how passes are run:
//
//     T* room<T>(count)             memory that lives as long as the machine
//     put(there, here, count)       copies into it; get(here, there, count): out of it; clear(there, count): zeros
//     each(planes, rows, columns, pass)    pass(z, y, x) for each of them
//     layer<G, taps>(pass)          see LayerPass
//
// Bands of rows of level 0 are encoded, filtered and decoded, and added to the coarser images that are filtered from
// it. Latents of coarser images are held as a whole. Sums run in another order than those of csrc/cpu, so results
// differ by rounding.
#pragma once

#include <algorithm>
#include <type_traits>
#include <vector>

#include "network/passes.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace network {

// Outputs of a block: the number that wastes least, and of these the largest.
inline int block_for(Index outputs) {
    int best = 8;
    for (const int each : {16, 24, 32})
        if ((outputs + each - 1) / each * each <= (outputs + best - 1) / best * best) best = each;
    return best;
}

template <class Machine>
class ImageBake {
  public:
    // About `at_once` texels are worked on at once.
    ImageBake(Machine& machine, const NetworkArgs& network, const NetworkBakeArgs& args, Index at_once = Index(1) << 19)
        : machine_(machine),
          network_(network),
          args_(args),
          at_once_(at_once),
          counts_(network_counts(network.kind, network.read, network.made)),
          latents_(counts_.moments + network.project.outputs),
          limits_{network.limits.least_roughness,    network.limits.most_roughness, network.limits.least_log_roughness,
                  network.limits.most_log_roughness, network.limits.least_alpha2,   network.limits.most_alpha2} {
        for (int i = 0; i < network.encoder_layers; ++i) halo_ += network.encoder[i].taps == 9 ? 1 : 0;
        put_weights();
        make_room();
    }

    void run() {
        for (Index begin = 0; begin < args_.height; begin += band_) {
            const Index end = std::min(args_.height, begin + band_);
            encode(begin, end);
            filter_top(static_cast<int>(end - begin));
            const Index texels = (end - begin) * args_.width;
            decode(filtered_, static_cast<int>(end - begin), static_cast<int>(args_.width), top_bias_);
            machine_.get(args_.top + begin * args_.width * counts_.made, stored_, texels * counts_.made);
            for (std::size_t i = 0; i < sinks_.size(); ++i)
                if (args_.sinks[i].source < 0) add(sinks_[i], encoded_.from(0, args_.reach, args_.reach), begin, end);
        }
        for (std::size_t i = 0; i < sinks_.size(); ++i) {
            const Sink& sink = sinks_[i];
            if (args_.sinks[i].source >= 0) {
                const Sink& from = sinks_[static_cast<std::size_t>(args_.sinks[i].source)];
                for (Index begin = 0; begin < from.rows.n; begin += rows_of(from.columns.n))
                    add(sink, from.latents.from(0, begin, 0), begin,
                        std::min<Index>(from.rows.n, begin + rows_of(from.columns.n)));
            }
            if (args_.sinks[i].out == nullptr) continue;
            for (Index begin = 0; begin < sink.rows.n; begin += rows_of(sink.columns.n)) {
                const Index some = std::min<Index>(sink.rows.n - begin, rows_of(sink.columns.n));
                decode(sink.latents.from(0, begin, 0), static_cast<int>(some), sink.columns.n, sink.bias);
                machine_.get(args_.sinks[i].out + begin * sink.columns.n * counts_.made, stored_,
                             some * sink.columns.n * counts_.made);
            }
        }
    }

  private:
    struct Layer {
        const float* weight;
        int outputs, inputs, taps, block;
    };
    struct Sink {
        AxisWeights rows, columns;
        int detail;
        Planes latents;
        const float* bias;
    };

    Index rows_of(Index columns) const { return std::max<Index>(1, at_once_ / columns); }

    template <class T>
    T* there(const T* here, Index count) {
        T* const out = machine_.template room<T>(count);
        machine_.put(out, here, count);
        return out;
    }
    Planes planes(Index count, Index rows, Index columns) {
        return {machine_.template room<float>(count * rows * columns), rows * columns, columns};
    }
    AxisWeights there(const AxisWeights& axis) {
        const Index count = static_cast<Index>(axis.n) * axis.taps;
        return {there(axis.index, count), there(axis.sharp, count), there(axis.plain, count), axis.n, axis.taps};
    }

    Layer packed(const NetworkLayer& given) {
        const int block = block_for(given.outputs);
        const Index inputs = given.inputs * given.taps, blocks = (given.outputs + block - 1) / block;
        std::vector<float> weight(static_cast<std::size_t>(blocks * inputs * block));
        for (Index g = 0; g < given.outputs; ++g)
            for (Index k = 0; k < inputs; ++k)
                weight[static_cast<std::size_t>((g / block * inputs + k) * block + g % block)] =
                    given.weight[g * inputs + k];
        return {there(weight.data(), static_cast<Index>(weight.size())), static_cast<int>(given.outputs),
                static_cast<int>(given.inputs), given.taps, block};
    }

    void put_weights() {
        if (network_.kind == NetworkKind::latents) {
            whiten_ = packed(network_.whiten);
            whiten_bias_ = there(network_.whiten.bias, network_.whiten.outputs);
        }
        for (int i = 0; i < network_.encoder_layers; ++i) {
            encoder_.push_back(packed(network_.encoder[i]));
            encoder_bias_.push_back(there(network_.encoder[i].bias, network_.encoder[i].outputs));
        }
        project_ = packed(network_.project);
        project_bias_ = there(network_.project.bias, network_.project.outputs);
        for (int i = 0; i < network_.decoder_layers; ++i) {
            decoder_.push_back(packed(network_.decoder[i]));
            biases_ += network_.decoder[i].outputs;
        }
    }

    void make_room() {
        const Index width = args_.width, learned = network_.project.outputs;
        level0_ = there(args_.stored, args_.height * width * counts_.read);
        top_bias_ = there(args_.bias, biases_);
        band_ = std::min(args_.height, rows_of(width));
        const Index rows = band_ + 2 * args_.reach, columns = width + 2 * args_.reach;
        Index maps = counts_.inputs * (network_.kind == NetworkKind::latents ? 2 : 1);
        for (const Layer& layer : encoder_) maps += layer.outputs;
        maps_ = planes(maps, rows + 2 * halo_, columns + 2 * halo_);
        encoded_ = planes(latents_, rows, columns);
        const Index filtered = latents_ + counts_.detail;
        filtered_down_ = planes(filtered, band_, columns);
        filtered_ = planes(filtered, band_, width);
        top_axis_ = top_axis(std::max(band_, width));
        Index texels = band_ * width, across = 0;
        for (int i = 0; i < args_.sink_count; ++i) {
            const NetworkSink& given = args_.sinks[i];
            const int detail = given.out != nullptr ? static_cast<int>(counts_.detail) : 0;
            const Index size = (latents_ + detail) * given.rows.n * given.columns.n;
            sinks_.push_back({there(given.rows), there(given.columns), detail,
                              planes(latents_ + detail, given.rows.n, given.columns.n),
                              given.out != nullptr ? there(given.bias, biases_) : nullptr});
            machine_.clear(sinks_.back().latents.at, size);
            texels = std::max(texels, std::min<Index>(given.rows.n, rows_of(given.columns.n)) * given.columns.n);
            const bool top = given.source < 0;
            const AxisWeights* const finer = top ? nullptr : &sinks_[static_cast<std::size_t>(given.source)].columns;
            const Index finer_rows =
                top ? band_ : std::min<Index>(rows_of(finer->n), sinks_[static_cast<std::size_t>(given.source)].rows.n);
            across = std::max(across, (latents_ + detail) * finer_rows * given.columns.n);
        }
        across_ = machine_.template room<float>(across);
        Index seen = counts_.features + learned + counts_.detail;
        for (const Layer& layer : decoder_) seen += layer.outputs;
        seen_ = machine_.template room<float>(seen * texels);
        stored_ = machine_.template room<float>(texels * counts_.made);
    }

    // The filter of level 0 at every place of an axis, whose first tap stands at the place itself.
    AxisWeights top_axis(Index count) {
        const int taps = 2 * args_.reach + 1;
        std::vector<std::int32_t> index;
        std::vector<float> sharp, plain;
        for (Index i = 0; i < count; ++i)
            for (int k = 0; k < taps; ++k) {
                index.push_back(static_cast<std::int32_t>(i) + k);
                sharp.push_back(args_.sharp[k]);
                plain.push_back(k == 0 || k == taps - 1 ? 0.0f : args_.plain[k - 1]);
            }
        return there(AxisWeights{index.data(), sharp.data(), plain.data(), static_cast<int>(count), taps});
    }

    void layer(const Layer& layer, const float* bias, bool rectified, const Planes& in, const Planes& out, Index rows,
               Index columns) {
        const LayerPass pass = {layer.weight,
                                bias,
                                layer.outputs,
                                layer.inputs,
                                rectified,
                                in,
                                out,
                                static_cast<int>(rows),
                                static_cast<int>(columns)};
        const auto run = [&](auto block) {
            constexpr int G = decltype(block)::value;
            if (layer.taps == 9)
                machine_.template layer<G, 9>(pass);
            else
                machine_.template layer<G, 1>(pass);
        };
        if (layer.block == 8) run(std::integral_constant<int, 8>());
        if (layer.block == 16) run(std::integral_constant<int, 16>());
        if (layer.block == 24) run(std::integral_constant<int, 24>());
        if (layer.block == 32) run(std::integral_constant<int, 32>());
    }

    // Rows [begin, end) of level 0 and what filters reach around them.
    void encode(Index begin, Index end) {
        const Index high = end - begin + 2 * (args_.reach + halo_), wide = args_.width + 2 * (args_.reach + halo_);
        const int model = network_.kind == NetworkKind::moments ? network_.made : network_.read;
        visit_texel(network_.kind, model, [&](auto k) {
            const EncodePass<decltype(k)> pass = {level0_,
                                                  args_.height,
                                                  args_.width,
                                                  begin - args_.reach - halo_,
                                                  -args_.reach - static_cast<Index>(halo_),
                                                  args_.wrap_rows,
                                                  args_.wrap_columns,
                                                  static_cast<int>(high),
                                                  static_cast<int>(wide),
                                                  halo_,
                                                  limits_,
                                                  maps_,
                                                  encoded_};
            machine_.each(1, pass.rows, pass.columns, pass);
        });
        Index first = 0, count = counts_.inputs;
        if (network_.kind == NetworkKind::latents) {
            layer(whiten_, whiten_bias_, false, maps_, maps_.from(count, 0, 0), high, wide);
            first = count;
        }
        int shrunk = 0;
        for (std::size_t i = 0; i < encoder_.size(); ++i) {
            shrunk += encoder_[i].taps == 9 ? 1 : 0;
            layer(encoder_[i], encoder_bias_[i], true, maps_.from(first, shrunk, shrunk),
                  maps_.from(first + count, shrunk, shrunk), high - 2 * shrunk, wide - 2 * shrunk);
            count += encoder_[i].outputs;
        }
        layer(project_, project_bias_, false, maps_.from(first, halo_, halo_), encoded_.from(counts_.moments, 0, 0),
              high - 2 * halo_, wide - 2 * halo_);
    }

    void gather(const AxisWeights& axis, bool down, const Planes& in, const Planes& out, Index moved, Index detail,
                Index first, Index last, bool more, Index rows, Index columns) {
        const GatherPass pass = {in,
                                 out,
                                 axis.index,
                                 axis.sharp,
                                 axis.plain,
                                 axis.taps,
                                 static_cast<int>(latents_),
                                 static_cast<int>(moved),
                                 down,
                                 static_cast<int>(first),
                                 static_cast<int>(last),
                                 more};
        machine_.each(latents_ + detail, static_cast<int>(rows), static_cast<int>(columns), pass);
    }

    void filter_top(int rows) {
        const Index wide = args_.width + 2 * args_.reach, detail = counts_.detail;
        gather(top_axis_, true, encoded_, filtered_down_, latents_, detail, 0, rows + 2 * args_.reach, false, rows,
               wide);
        gather(top_axis_, false, filtered_down_, filtered_, 0, detail, 0, wide, false, rows, args_.width);
    }

    // Adds rows [begin, end) of a finer image to a sink.
    void add(const Sink& sink, const Planes& finer, Index begin, Index end) {
        const Index wide = sink.columns.n;
        const Planes across = {across_, (end - begin) * wide, wide};
        gather(sink.columns, false, finer, across, latents_, sink.detail, 0, std::int32_t(0x7fffffff), false,
               end - begin, wide);
        gather(sink.rows, true, across, sink.latents, 0, sink.detail, begin, end, true, sink.rows.n, wide);
    }

    // Stored channels of filtered latents.
    void decode(const Planes& latents, int rows, int columns, const float* bias) {
        const Index plane = static_cast<Index>(rows) * columns, learned = network_.project.outputs;
        const Planes seen = {seen_, plane, columns};
        const Index known = counts_.features + learned;
        Index last = known;
        for (std::size_t i = 0; i + 1 < decoder_.size(); ++i) last += decoder_[i].outputs;
        const Planes detail = seen.from(last, 0, 0), said = seen.from(last + counts_.detail, 0, 0);
        const auto visit = [&](auto&& f) { visit_texel(network_.kind, network_.made, f); };
        visit([&](auto k) {
            const FeaturesPass<decltype(k)> pass = {latents,
                                                    seen,
                                                    static_cast<int>(counts_.moments),
                                                    static_cast<int>(learned),
                                                    static_cast<int>(counts_.features),
                                                    static_cast<int>(counts_.detail),
                                                    static_cast<int>(last),
                                                    limits_};
            machine_.each(1, rows, columns, pass);
        });
        Index count = known;
        for (std::size_t i = 0; i < decoder_.size(); ++i) {
            const bool is_last = i + 1 == decoder_.size();
            layer(decoder_[i], bias, !is_last, seen, is_last ? said : seen.from(count, 0, 0), rows, columns);
            bias += decoder_[i].outputs;
            count += decoder_[i].outputs;
        }
        visit([&](auto k) {
            const StorePass<decltype(k)> pass = {latents, said, detail, limits_, stored_, columns};
            machine_.each(1, rows, columns, pass);
        });
    }

    Machine& machine_;
    const NetworkArgs& network_;
    const NetworkBakeArgs& args_;
    Index at_once_;
    NetworkCounts counts_;
    Index latents_;  // moments and learned ones
    Limits limits_;
    int halo_ = 0;
    Layer whiten_{}, project_{};
    std::vector<Layer> encoder_, decoder_;
    const float *whiten_bias_ = nullptr, *project_bias_ = nullptr, *top_bias_ = nullptr;
    std::vector<const float*> encoder_bias_;
    Index biases_ = 0, band_ = 0;
    AxisWeights top_axis_{};
    std::vector<Sink> sinks_;
    const float* level0_ = nullptr;
    Planes maps_{}, encoded_{}, filtered_down_{}, filtered_{};
    float *across_ = nullptr, *seen_ = nullptr, *stored_ = nullptr;
};

}  // namespace network
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
