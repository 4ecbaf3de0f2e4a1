#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/tuple.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <memory>
#include <optional>
#include <stdexcept>
#include <tuple>
#include <vector>

#include "ops.h"

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

std::shared_ptr<const mipbake::MomentNetwork> network(int made, const std::vector<float>& limits,
                                                      const std::vector<Layer>& encoder, const Layer& project,
                                                      const std::vector<Layer>& decoder) {
    require(made >= 0 && made < 4 && limits.size() == 6 && !decoder.empty());
    std::vector<mipbake::NetworkLayer> first, last;
    for (const Layer& each : encoder) first.push_back(layer(each));
    for (const Layer& each : decoder) last.push_back(layer(each));
    return mipbake::moment_network({made,
                                    {limits[0], limits[1], limits[2], limits[3], limits[4], limits[5]},
                                    first.data(),
                                    static_cast<int>(first.size()),
                                    layer(project),
                                    last.data(),
                                    static_cast<int>(last.size())});
}

// A bake, and the arrays that it reads and writes.
class Bake {
  public:
    Bake(std::shared_ptr<const mipbake::MomentNetwork> network, int made, const Numbers& stored, bool wrap_rows,
         bool wrap_columns, const Numbers& sharp, const Numbers& plain, const Numbers& bias, const Image& top,
         std::vector<Sink> sinks)
        : stored_(stored), sharp_(sharp), plain_(plain), bias_(bias), top_(top), sinks_(std::move(sinks)) {
        const mipbake::MomentCounts counts = mipbake::moment_counts(made);
        require(stored.ndim() == 3 && size(stored, 2) == counts.read && sharp.ndim() == 1 && plain.ndim() == 1 &&
                sharp.shape(0) % 2 == 1 && sharp.shape(0) == plain.shape(0) + 2 && bias.ndim() == 1);
        require(top.shape(0) == stored.shape(0) && top.shape(1) == stored.shape(1) &&
                static_cast<std::int64_t>(top.shape(2)) == counts.made);
        std::vector<mipbake::MomentSink> given;
        for (const Sink& sink : sinks_) {
            const auto& [source, rows, columns, out, own] = sink;
            require(source >= -1 && source < static_cast<int>(given.size()) && out.has_value() == own.has_value());
            require(source < 0 || given[static_cast<std::size_t>(source)].out == nullptr);
            const auto finer = [&](std::size_t axis) {
                if (source < 0) return size(stored, axis);
                const mipbake::MomentSink& from = given[static_cast<std::size_t>(source)];
                return static_cast<std::int64_t>(axis == 0 ? from.rows.n : from.columns.n);
            };
            const mipbake::AxisWeights down = axis(rows, finer(0)), across = axis(columns, finer(1));
            if (out)
                require(static_cast<int>(out->shape(0)) == down.n && static_cast<int>(out->shape(1)) == across.n &&
                        static_cast<std::int64_t>(out->shape(2)) == counts.made);
            given.push_back({source, down, across, out ? out->data() : nullptr, own ? own->data() : nullptr});
        }
        bake_ = std::make_unique<mipbake::MomentBake>(
            std::move(network),
            mipbake::MomentBakeArgs{stored.data(), size(stored, 0), size(stored, 1), wrap_rows, wrap_columns,
                                    sharp.data(), plain.data(), static_cast<int>(sharp.shape(0) / 2), bias.data(),
                                    top.data(), given.data(), static_cast<int>(given.size())});
    }

    std::int64_t advance() {
        const nb::gil_scoped_release release;
        bake_->advance();
        return bake_->rows_done();
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

    Numbers stored_, sharp_, plain_, bias_;
    Image top_;
    std::vector<Sink> sinks_;
    std::unique_ptr<mipbake::MomentBake> bake_;
};

struct Network {
    int made;
    std::shared_ptr<const mipbake::MomentNetwork> packed;
};

}  // namespace

void bind_network(nb::module_& m) {
    m.def(
        "moment_counts",
        [](int made) {
            const mipbake::MomentCounts c = mipbake::moment_counts(made);
            return std::make_tuple(c.read, c.made, c.inputs, c.moments, c.detail, c.features, c.outputs);
        },
        nb::arg("made"),
        "Channels that are read and made, inputs of the encoder, moments, those that sharpening is told by, features "
        "and outputs of a moment network.");
    nb::class_<Network>(m, "MomentNetwork", "Packed weights of a moment network.")
        .def(
            "__init__",
            [](Network* self, int made, const std::vector<float>& limits, const std::vector<Layer>& encoder,
               const Layer& project, const std::vector<Layer>& decoder) {
                new (self) Network{made, network(made, limits, encoder, project, decoder)};
            },
            nb::arg("made"), nb::arg("limits"), nb::arg("encoder"), nb::arg("project"), nb::arg("decoder"));
    nb::class_<Bake>(m, "MomentBake", "A bake of every level, some rows of level 0 at a time.")
        .def(
            "__init__",
            [](Bake* self, const Network& network, const Numbers& stored, bool wrap_rows, bool wrap_columns,
               const Numbers& sharp, const Numbers& plain, const Numbers& bias, const Image& top,
               std::vector<Sink> sinks) {
                new (self) Bake(network.packed, network.made, stored, wrap_rows, wrap_columns, sharp, plain, bias, top,
                                std::move(sinks));
            },
            nb::arg("network"), nb::arg("stored"), nb::arg("wrap_rows"), nb::arg("wrap_columns"), nb::arg("sharp"),
            nb::arg("plain"), nb::arg("bias"), nb::arg("top"), nb::arg("sinks"))
        .def("advance", &Bake::advance, "Bakes the next rows; gives the number of rows of level 0 that are done.");
}
