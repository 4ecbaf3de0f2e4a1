#include "ops/splats.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <algorithm>
#include <cstdint>
#include <stdexcept>

#include "bind/arrays.h"

using namespace mipbake::bind;

namespace {

void splats(const Input& order, const Input& centers, const Input& conics, const Input& paint, const Output& image,
            const Output& shown) {
    if (order.ndim() != 1 || centers.ndim() != 2 || image.ndim() != 3 || shown.ndim() != 3 ||
        order.device_type() != nb::device::cpu::value)
        throw std::invalid_argument("splats have an unexpected number of axes, or are not on the CPU");
    mipbake::SplatArgs args{};
    args.splats = static_cast<Index>(centers.shape(0));
    args.listed = static_cast<Index>(order.shape(0));
    args.height = static_cast<int>(image.shape(0));
    args.width = static_cast<int>(image.shape(1));
    args.most = static_cast<int>(shown.shape(2));
    require(order, nb::dtype<std::int32_t>(), order, "order", {args.listed});
    require(centers, nb::dtype<float>(), order, "centers", {args.splats, 2});
    require(conics, nb::dtype<float>(), order, "conics", {args.splats, 3});
    require(paint, nb::dtype<float>(), order, "paint", {args.splats, 4});
    require(image, nb::dtype<float>(), order, "image", {args.height, args.width, 4});
    require(shown, nb::dtype<std::int32_t>(), order, "shown", {args.height, args.width, args.most});
    args.order = static_cast<const std::int32_t*>(order.data());
    const bool exist =
        std::all_of(args.order, args.order + args.listed, [&](std::int32_t s) { return s >= 0 && s < args.splats; });
    if (!exist || args.most > mipbake::most_splats_shown)
        throw std::invalid_argument("a splat that does not exist, or too many shown");
    args.centers = static_cast<const float*>(centers.data());
    args.conics = static_cast<const float*>(conics.data());
    args.paint = static_cast<const float*>(paint.data());
    args.image = static_cast<float*>(image.data());
    args.shown = static_cast<std::int32_t*>(shown.data());
    const nb::gil_scoped_release unlocked;
    mipbake::splats_cpu(args);
}

}  // namespace

void bind_splats(nb::module_& m) {
    using namespace nb::literals;
    m.def("splats", &splats, "order"_a, "centers"_a, "conics"_a, "paint"_a, "image"_a, "shown"_a,
          "Fills image (H, W, 4) and shown (H, W, K) int32 from centers (N, 2), conics (N, 3) and paint (N, 4), in the "
          "order (L) int32, nearest first. On the CPU alone.");
}
