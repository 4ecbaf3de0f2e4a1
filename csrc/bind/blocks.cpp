#include "ops/blocks.h"

#include <nanobind/stl/optional.h>
#include <nanobind/stl/string.h>

#include <cstdint>
#include <stdexcept>
#include <string>

#include "bind/arrays.h"

namespace {

using mipbake::BlockFormat;
using mipbake::bind::Index;
using mipbake::bind::Input;
using mipbake::bind::Output;

BlockFormat format_of(const std::string& name) {
    constexpr const char* names[] = {"bc1", "bc2", "bc3", "bc4", "bc5", "bc7", "uastc"};
    for (int i = 0; i < 7; ++i)
        if (name == names[i]) return static_cast<BlockFormat>(i);
    throw std::invalid_argument("unknown format of blocks");
}

void encode(const std::string& name, const Input& values, const std::optional<Input>& weights, const Output& blocks) {
    const BlockFormat format = format_of(name);
    if (format == BlockFormat::bc2 || format == BlockFormat::bc3) throw std::invalid_argument("not written");
    if (values.ndim() != 3 || values.shape(0) == 0 || values.shape(1) == 0) throw std::invalid_argument("no texels");
    const Index height = static_cast<Index>(values.shape(0)), width = static_cast<Index>(values.shape(1));
    const std::initializer_list<Index> shape{height, width, channels_of(format)};
    mipbake::bind::require(values, nb::dtype<float>(), values, "values", shape);
    if (weights) mipbake::bind::require(*weights, nb::dtype<float>(), values, "weights", shape);
    mipbake::bind::require(blocks, nb::dtype<std::uint8_t>(), values, "blocks",
                           {(height + 3) / 4 * ((width + 3) / 4), bytes_of(format)});
    const mipbake::BlockArgs args{format, height, width, static_cast<const float*>(values.data()),
                                  mipbake::bind::data<const float>(weights)};
    auto* const out = static_cast<std::uint8_t*>(blocks.data());
    const nb::gil_scoped_release unlocked;
    mipbake::encode_blocks_cpu(args, out);
}

void decode(const std::string& name, const Input& blocks, const Output& values) {
    const BlockFormat format = format_of(name);
    if (values.ndim() != 3) throw std::invalid_argument("expected three axes");
    const Index height = static_cast<Index>(values.shape(0)), width = static_cast<Index>(values.shape(1));
    mipbake::bind::require(values, nb::dtype<float>(), blocks, "values", {height, width, channels_of(format)});
    mipbake::bind::require(blocks, nb::dtype<std::uint8_t>(), blocks, "blocks",
                           {(height + 3) / 4 * ((width + 3) / 4), bytes_of(format)});
    const auto* const from = static_cast<const std::uint8_t*>(blocks.data());
    auto* const out = static_cast<float*>(values.data());
    const nb::gil_scoped_release unlocked;
    mipbake::decode_blocks_cpu(format, height, width, from, out);
}

}  // namespace

void bind_blocks(nb::module_& m) {
    using namespace nb::literals;
    m.def("encode_blocks", &encode, "format"_a, "values"_a, "weights"_a.none(), "blocks"_a,
          "Fills blocks (N, 8 or 16) of bc1, bc4, bc5, bc7 or uastc from values (H, W, C) from 0 to 1, with the least "
          "error "
          "that "
          "weights (H, W, C) count; all float32 but the blocks, uint8.");
    m.def("decode_blocks", &decode, "format"_a, "blocks"_a, "values"_a,
          "Fills values (H, W, C), float32 from 0 to 1, from blocks of bc1, bc2, bc3, bc4, bc5, bc7 or uastc.");
}
