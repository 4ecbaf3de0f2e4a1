#include "ops/resample.h"

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "bind/arrays.h"

namespace {

using mipbake::bind::Index;
using mipbake::bind::Input;
using mipbake::bind::Output;

void require(bool condition, const char* what) {
    if (!condition) throw std::invalid_argument(what);
}

// One axis, from (count, taps) indices below `size` and as many weights.
mipbake::ResampleAxis<float> axis_of(const Input& index, const Input& weights, Index size) {
    require(index.ndim() == 2 && index.shape(1) > 0, "expected indices of two axes, and a tap or more");
    const Index count = static_cast<Index>(index.shape(0)), taps = static_cast<Index>(index.shape(1));
    mipbake::bind::require(index, nb::dtype<std::int64_t>(), index, "index", {count, taps});
    mipbake::bind::require(weights, nb::dtype<float>(), index, "weights", {count, taps});
    const auto* const found = static_cast<const std::int64_t*>(index.data());
    require(std::all_of(found, found + count * taps, [&](std::int64_t i) { return i >= 0 && i < size; }),
            "an index is out of range");
    return {found, static_cast<const float*>(weights.data()), count, taps};
}

void resample(const Input& image, const Input& row_index, const Input& row_weights, const Input& column_index,
              const Input& column_weights, const Output& out) {
    require(image.ndim() == 3 && image.dtype() == nb::dtype<float>(), "expected an image of three axes in float32");
    require(image.device_type() == nb::device::cpu::value, "expected an array in the memory of the host");
    const Index height = static_cast<Index>(image.shape(0)), width = static_cast<Index>(image.shape(1)),
                channels = static_cast<Index>(image.shape(2));
    require(image.shape(2) == 1 || image.stride(2) == 1, "channels must lie side by side");
    require(image.shape(1) == 1 || image.stride(1) == channels, "texels of a row must lie side by side");
    mipbake::ResampleArgs<float> args{};
    args.image = static_cast<const float*>(image.data());
    args.row_stride = image.stride(0);
    args.width = width;
    args.channels = channels;
    args.rows = axis_of(row_index, row_weights, height);
    args.columns = axis_of(column_index, column_weights, width);
    mipbake::bind::require(out, nb::dtype<float>(), image, "out", {args.rows.count, args.columns.count, channels});
    auto* const to = static_cast<float*>(out.data());
    const nb::gil_scoped_release unlocked;
    mipbake::resample_cpu(args, to);
}

}  // namespace

void bind_resample(nb::module_& m) {
    using namespace nb::literals;
    m.def("resample", &resample, "image"_a, "row_index"_a, "row_weights"_a, "column_index"_a, "column_weights"_a,
          "out"_a,
          "Fills out (h, w, C) from image (H, W, C), both float32: rows by row_index and row_weights (h, taps), then "
          "columns by column_index and column_weights (w, taps); int64 and float32. Rows of image may lie apart.");
}
