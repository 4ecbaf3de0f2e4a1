#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <tuple>
#include <vector>

#include "ops/networks.h"

namespace nb = nanobind;

namespace {

using Numbers = nb::ndarray<const float, nb::c_contig, nb::device::cpu>;
using Places = nb::ndarray<const std::int32_t, nb::ndim<2>, nb::c_contig, nb::device::cpu>;
using Image = nb::ndarray<float, nb::ndim<3>, nb::c_contig, nb::device::cpu>;
using Layer = std::tuple<Numbers, Numbers>;
using Axis = std::tuple<Places, Numbers, Numbers>;
using Sink = std::tuple<int, Axis, Axis, std::optional<Image>, std::optional<Numbers>>;

void require(bool good) {
    if (!good) throw std::invalid_argument("unexpected shape of an array of a network");
}

std::int64_t size(const Numbers& a, std::size_t axis) { return static_cast<std::int64_t>(a.shape(axis)); }

// Weights are (outputs, inputs), or (outputs, inputs, 3, 3).
mipbake::NetworkLayer layer(const Layer& given) {
    const auto& [weight, bias] = given;
    require((weight.ndim() == 2 || (weight.ndim() == 4 && weight.shape(2) == 3 && weight.shape(3) == 3)) &&
            bias.ndim() == 1 && bias.shape(0) == weight.shape(0));
    return {weight.data(), bias.data(), size(weight, 0), size(weight, 1), weight.ndim() == 4 ? 9 : 1};
}

mipbake::NetworkKind kind_of(const std::string& kind) {
    require(kind == "moments" || kind == "latents");
    return kind == "moments" ? mipbake::NetworkKind::moments : mipbake::NetworkKind::latents;
}

// Weights as they are given and packed, and what they are for.
struct Network {
    mipbake::NetworkCounts counts;
    mipbake::NetworkArgs args;
    std::shared_ptr<const mipbake::Network> packed;

    Network(const std::string& kind, int read, int made, const std::vector<float>& limits,
            const std::optional<Layer>& whiten, const std::vector<Layer>& encoder, const Layer& project,
            const std::vector<Layer>& decoder)
        : whiten_(whiten), project_(project), encoder_(encoder), decoder_(decoder) {
        require(read >= 0 && read < 4 && made >= 0 && made < 4 && limits.size() == 6 && !decoder.empty());
        require(whiten.has_value() == (kind == "latents"));
        for (const Layer& each : encoder) first_.push_back(layer(each));
        for (const Layer& each : decoder) last_.push_back(layer(each));
        counts = mipbake::network_counts(kind_of(kind), read, made);
        args = {kind_of(kind),
                read,
                made,
                {limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]},
                whiten ? layer(*whiten) : mipbake::NetworkLayer{},
                first_.data(),
                static_cast<int>(first_.size()),
                layer(project),
                last_.data(),
                static_cast<int>(last_.size())};
        packed = mipbake::packed_network(args);
    }
    Network(const Network&) = delete;
    Network& operator=(const Network&) = delete;

  private:
    // What args point to.
    std::optional<Layer> whiten_;
    Layer project_;
    std::vector<Layer> encoder_, decoder_;
    std::vector<mipbake::NetworkLayer> first_, last_;
};

// A bake, and the arrays that it reads and writes.
class Bake {
  public:
    Bake(const Network& network, const Numbers& stored, bool wrap_rows, bool wrap_columns, const Numbers& sharp,
         const Numbers& plain, const Numbers& bias, const Image& top, std::vector<Sink> sinks)
        : network_(network),
          stored_(stored),
          sharp_(sharp),
          plain_(plain),
          bias_(bias),
          top_(top),
          sinks_(std::move(sinks)) {
        const mipbake::NetworkCounts& counts = network.counts;
        require(stored.ndim() == 3 && size(stored, 2) == counts.read && sharp.ndim() == 1 && plain.ndim() == 1 &&
                sharp.shape(0) % 2 == 1 &&
                (plain.shape(0) == 0 ? sharp.shape(0) == 1 : sharp.shape(0) == plain.shape(0) + 2) && bias.ndim() == 1);
        require(top.shape(0) == stored.shape(0) && top.shape(1) == stored.shape(1) &&
                static_cast<std::int64_t>(top.shape(2)) == counts.made);
        for (const Sink& sink : sinks_) {
            const auto& [source, rows, columns, out, own] = sink;
            require(source >= -1 && source < static_cast<int>(given_.size()) && out.has_value() == own.has_value());
            const auto finer = [&](std::size_t axis) {
                if (source < 0) return size(stored, axis);
                const mipbake::NetworkSink& from = given_[static_cast<std::size_t>(source)];
                return static_cast<std::int64_t>(axis == 0 ? from.rows.n : from.columns.n);
            };
            const mipbake::AxisWeights down = axis(rows, finer(0)), across = axis(columns, finer(1));
            if (out)
                require(static_cast<int>(out->shape(0)) == down.n && static_cast<int>(out->shape(1)) == across.n &&
                        static_cast<std::int64_t>(out->shape(2)) == counts.made);
            given_.push_back({source, down, across, out ? out->data() : nullptr, own ? own->data() : nullptr});
        }
        args_ = {stored.data(), size(stored, 0), size(stored, 1), wrap_rows,
                 wrap_columns,  sharp.data(),    plain.data(),    static_cast<int>(sharp.shape(0) / 2),
                 bias.data(),   top.data(),      given_.data(),   static_cast<int>(given_.size())};
    }

    std::int64_t advance() {
        const nb::gil_scoped_release release;
        if (bake_ == nullptr) bake_ = std::make_unique<mipbake::NetworkBake>(network_.packed, args_);
        bake_->advance();
        return bake_->rows_done();
    }

    void run_on_card(int device) const {
        const nb::gil_scoped_release release;
#ifdef MIPBAKE_CUDA
        mipbake::network_bake_cuda(network_.args, args_, {device, 0});
#else
        throw std::invalid_argument("no CUDA kernels in this build, so none for card " + std::to_string(device));
#endif
    }

  private:
    static mipbake::AxisWeights axis(const Axis& given, std::int64_t finer) {
        const auto& [index, sharp, plain] = given;
        require(sharp.ndim() == 2 && plain.ndim() == 2);
        for (std::size_t i = 0; i < 2; ++i)
            require(sharp.shape(i) == index.shape(i) && plain.shape(i) == index.shape(i));
        for (std::size_t i = 0; i < index.size(); ++i) require(index.data()[i] >= 0 && index.data()[i] < finer);
        return {index.data(), sharp.data(), plain.data(), static_cast<int>(index.shape(0)),
                static_cast<int>(index.shape(1))};
    }

    const Network& network_;
    Numbers stored_, sharp_, plain_, bias_;
    Image top_;
    std::vector<Sink> sinks_;
    std::vector<mipbake::NetworkSink> given_;
    mipbake::NetworkBakeArgs args_{};
    std::unique_ptr<mipbake::NetworkBake> bake_;
};

}  // namespace

void bind_network(nb::module_& m) {
    m.def(
        "network_counts",
        [](const std::string& kind, int read, int made) {
            const mipbake::NetworkCounts c = mipbake::network_counts(kind_of(kind), read, made);
            return std::make_tuple(c.read, c.made, c.inputs, c.moments, c.detail, c.features, c.outputs);
        },
        nb::arg("kind"), nb::arg("read"), nb::arg("made"),
        "Channels that are read and made, inputs of the encoder, moments, those that sharpening is told by, features "
        "and outputs of a network.");
    nb::class_<Network>(m, "Network", "Packed weights of a network.")
        .def(nb::init<const std::string&, int, int, const std::vector<float>&, const std::optional<Layer>&,
                      const std::vector<Layer>&, const Layer&, const std::vector<Layer>&>(),
             nb::arg("kind"), nb::arg("read"), nb::arg("made"), nb::arg("limits"), nb::arg("whiten").none(),
             nb::arg("encoder"), nb::arg("project"), nb::arg("decoder"));
    nb::class_<Bake>(m, "NetworkBake", "A bake of every level, some rows of level 0 at a time.")
        .def(nb::init<const Network&, const Numbers&, bool, bool, const Numbers&, const Numbers&, const Numbers&,
                      const Image&, std::vector<Sink>>(),
             nb::arg("network"), nb::arg("stored"), nb::arg("wrap_rows"), nb::arg("wrap_columns"), nb::arg("sharp"),
             nb::arg("plain"), nb::arg("bias"), nb::arg("top"), nb::arg("sinks"), nb::keep_alive<1, 2>())
        .def("advance", &Bake::advance, "Bakes the next rows; gives the number of rows of level 0 that are done.")
        .def("run_on_card", &Bake::run_on_card, nb::arg("device"), "Bakes all rows on a graphics card by its number.");
}
