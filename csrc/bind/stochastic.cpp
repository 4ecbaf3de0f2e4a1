#include "ops/stochastic.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/optional.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <algorithm>
#include <cstdint>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "bind/arrays.h"

using namespace mipbake::bind;

namespace {

using Numbers = std::vector<double>;

void expect(bool condition, const char* what) {
    if (!condition) throw std::invalid_argument(what);
}

Index rows_of(const Input& a) { return static_cast<Index>(a.shape(0)); }
Index columns_of(const Input& a) {
    expect(a.ndim() == 2, "expected (elements, channels)");
    return static_cast<Index>(a.shape(1));
}

// ElementChannels and the numbers that it points to.
template <class T>
struct Channels {
    std::vector<T> magnitude, low, high;
    int lifted;

    Channels(const Numbers& magnitude, const Numbers& low, const Numbers& high, int lifted, Index count)
        : magnitude(magnitude.begin(), magnitude.end()),
          low(low.begin(), low.end()),
          high(high.begin(), high.end()),
          lifted(lifted) {
        const std::size_t wanted = static_cast<std::size_t>(count);
        expect(count >= 1 && count <= mipbake::most_channels && magnitude.size() == wanted && low.size() == wanted &&
                   high.size() == wanted,
               "unexpected numbers of channels");
        expect(lifted < 0 || lifted + 3 <= count, "a lifted normal needs three channels");
    }
    mipbake::ElementChannels<T> view() const {
        return {static_cast<int>(magnitude.size()), lifted, magnitude.data(), low.data(), high.data()};
    }
};

mipbake::ElementList list_of(const std::optional<Input>& elements, const Input& values) {
    if (!elements) return {nullptr, rows_of(values)};
    require(*elements, nb::dtype<std::int32_t>(), values, "elements", {rows_of(*elements)});
    return {static_cast<const std::int32_t*>(elements->data()), rows_of(*elements)};
}

template <class T>
void perturb_as(const Input& values, const std::optional<Input>& elements, const Numbers& magnitude, const Numbers& low,
                const Numbers& high, int lifted, mipbake::SignKey key, const Output& plus, const Output& minus,
                std::uintptr_t stream) {
    const Index n = rows_of(values), c = columns_of(values);
    for (const auto* const each : {&plus, &minus}) require(*each, nb::dtype<T>(), values, "plus or minus", {n, c});
    require(values, nb::dtype<T>(), values, "values", {n, c});
    const Channels<T> channels(magnitude, low, high, lifted, c);
    const mipbake::PerturbArgs<T> args{static_cast<const T*>(values.data()),
                                       channels.view(),
                                       list_of(elements, values),
                                       key,
                                       static_cast<T*>(plus.data()),
                                       static_cast<T*>(minus.data())};
    launch<T>(
        values, stream, [&] { mipbake::perturb_cpu(args); }, [&](auto queue) { mipbake::perturb_cuda(args, queue); });
}

template <class T>
void differences_as(const Input& plus, const Input& minus, const Input& reference, const std::optional<Input>& weights,
                    const Output& out, std::uintptr_t stream) {
    const Index n = rows_of(plus), c = columns_of(plus);
    for (const auto* const each : {&plus, &minus, &reference}) require(*each, nb::dtype<T>(), plus, "image", {n, c});
    if (weights) require(*weights, nb::dtype<T>(), plus, "weights", {n});
    require(out, nb::dtype<T>(), plus, "out", {n});
    const auto read = [](const Input& a) { return static_cast<const T*>(a.data()); };
    T* const to = static_cast<T*>(out.data());
    launch<T>(
        plus, stream,
        [&] { mipbake::differences_cpu(read(plus), read(minus), read(reference), data<const T>(weights), n, c, to); },
        [&](auto queue) {
            mipbake::differences_cuda(read(plus), read(minus), read(reference), data<const T>(weights), n, c, to,
                                      queue);
        });
}

template <class T>
void gradient_as(const Input& differences, const Input& elements, const Input& starts, const Input& pixels,
                 const Numbers& magnitude, mipbake::SignKey key, const Output& gradient, std::uintptr_t stream) {
    expect(gradient.ndim() == 2, "expected (elements, channels)");
    const Index n = static_cast<Index>(gradient.shape(0)), c = static_cast<Index>(gradient.shape(1));
    require(differences, nb::dtype<T>(), differences, "differences", {rows_of(differences)});
    require(starts, nb::dtype<std::int64_t>(), differences, "starts", {rows_of(elements) + 1});
    require(pixels, nb::dtype<std::int32_t>(), differences, "pixels", {rows_of(pixels)});
    require(gradient, nb::dtype<T>(), differences, "gradient", {n, c});
    const Channels<T> channels(magnitude, magnitude, magnitude, -1, c);
    const mipbake::GradientArgs<T> args{static_cast<const T*>(differences.data()),
                                        rows_of(differences),
                                        static_cast<const std::int64_t*>(starts.data()),
                                        static_cast<const std::int32_t*>(pixels.data()),
                                        list_of(elements, differences),
                                        channels.view(),
                                        key,
                                        static_cast<T*>(gradient.data())};
    launch<T>(
        differences, stream, [&] { mipbake::gradient_cpu(args); },
        [&](auto queue) { mipbake::gradient_cuda(args, queue); });
}

template <class T>
void adam_as(const Output& values, const Output& gradient, const Output& first, const Output& second,
             const Output& steps, const std::optional<Input>& elements, const Numbers& rate, const Numbers& low,
             const Numbers& high, int lifted, double beta1, double beta2, double epsilon, std::uintptr_t stream) {
    expect(values.ndim() == 2, "expected (elements, channels)");
    const Input like(values);
    const Index n = rows_of(like), c = columns_of(like);
    for (const auto* const each : {&values, &gradient, &first, &second})
        require(*each, nb::dtype<T>(), like, "values, gradient, first or second", {n, c});
    require(steps, nb::dtype<std::int32_t>(), like, "steps", {n});
    const Channels<T> channels(rate, low, high, lifted, c);
    const auto write = [](const Output& a) { return static_cast<T*>(a.data()); };
    const mipbake::AdamArgs<T> args{write(values),
                                    write(gradient),
                                    write(first),
                                    write(second),
                                    static_cast<std::int32_t*>(steps.data()),
                                    channels.view(),
                                    list_of(elements, like),
                                    static_cast<T>(beta1),
                                    static_cast<T>(beta2),
                                    static_cast<T>(epsilon)};
    launch<T>(like, stream, [&] { mipbake::adam_cpu(args); }, [&](auto queue) { mipbake::adam_cuda(args, queue); });
}

template <class F, class D>
auto typed(const nb::dlpack::dtype& dtype, F as_float, D as_double) {
    return dtype == nb::dtype<double>() ? as_double : as_float;
}

void perturb(const Input& values, const std::optional<Input>& elements, const Numbers& magnitude, const Numbers& low,
             const Numbers& high, int lifted, std::uint32_t step, std::uint32_t seed, const Output& plus,
             const Output& minus, std::uintptr_t stream) {
    typed(values.dtype(), perturb_as<float>, perturb_as<double>)(values, elements, magnitude, low, high, lifted,
                                                                 {step, seed}, plus, minus, stream);
}

void differences(const Input& plus, const Input& minus, const Input& reference, const std::optional<Input>& weights,
                 const Output& out, std::uintptr_t stream) {
    typed(plus.dtype(), differences_as<float>, differences_as<double>)(plus, minus, reference, weights, out, stream);
}

void gradient(const Input& differences, const Input& elements, const Input& starts, const Input& pixels,
              const Numbers& magnitude, std::uint32_t step, std::uint32_t seed, const Output& gradient,
              std::uintptr_t stream) {
    typed(differences.dtype(), gradient_as<float>, gradient_as<double>)(differences, elements, starts, pixels,
                                                                        magnitude, {step, seed}, gradient, stream);
}

void adam(const Output& values, const Output& gradient, const Output& first, const Output& second, const Output& steps,
          const std::optional<Input>& elements, const Numbers& rate, const Numbers& low, const Numbers& high,
          int lifted, double beta1, double beta2, double epsilon, std::uintptr_t stream) {
    typed(values.dtype(), adam_as<float>, adam_as<double>)(values, gradient, first, second, steps, elements, rate, low,
                                                           high, lifted, beta1, beta2, epsilon, stream);
}

mipbake::Boundary boundary_of(const std::string& name) {
    if (name == "wrap") return mipbake::Boundary::wrap;
    if (name == "clamp") return mipbake::Boundary::clamp;
    if (name == "mirror") return mipbake::Boundary::mirror;
    expect(name == "zero", "an unknown boundary");
    return mipbake::Boundary::zero;
}

void touched(const std::vector<std::pair<int, int>>& sizes, const Input& uv, const std::optional<Input>& lod,
             const std::optional<Input>& uv_da, const std::optional<Input>& seen, const std::string& filter,
             const std::string& boundary_u, const std::string& boundary_v, const Output& texels,
             std::uintptr_t stream) {
    expect(!sizes.empty() && sizes.size() <= mipbake::max_levels, "1 to 32 levels");
    mipbake::TouchedArgs args{};
    args.level_count = static_cast<int>(sizes.size());
    for (std::size_t l = 0; l < sizes.size(); ++l) {
        args.heights[l] = sizes[l].first;
        args.widths[l] = sizes[l].second;
    }
    const Index n = rows_of(uv);
    require(uv, nb::dtype<float>(), uv, "uv", {n, 2});
    if (lod) require(*lod, nb::dtype<float>(), uv, "lod", {n});
    if (uv_da) require(*uv_da, nb::dtype<float>(), uv, "uv_da", {n, 4});
    if (seen) require(*seen, nb::dtype<std::uint8_t>(), uv, "seen", {n});
    expect(lod.has_value() != uv_da.has_value(), "expected lod or uv_da");
    args.points = n;
    args.uv = static_cast<const float*>(uv.data());
    args.lod = data<const float>(lod);
    args.uv_da = data<const float>(uv_da);
    args.seen = data<const std::uint8_t>(seen);
    args.filter = filter == "nearest"       ? mipbake::Filter::nearest
                  : filter == "anisotropic" ? mipbake::Filter::anisotropic
                                            : mipbake::Filter::linear_mipmap_linear;
    args.boundary_u = boundary_of(boundary_u);
    args.boundary_v = boundary_of(boundary_v);
    expect(texels.ndim() == 2 && texels.shape(1) >= 1 && texels.shape(1) <= 128, "1 to 128 texels a pixel");
    args.most = static_cast<int>(texels.shape(1));
    require(texels, nb::dtype<std::int32_t>(), uv, "texels", {n, args.most});
    auto* const to = static_cast<std::int32_t*>(texels.data());
    launch<float>(
        uv, stream, [&] { mipbake::touched_cpu(args, to); },
        [&](auto queue) { mipbake::touched_cuda(args, to, queue); });
}

// What names elements from 0 to count - 1, or none.
void check_named(const Input& touched, Index count) {
    expect(touched.ndim() == 2 && touched.device_type() == nb::device::cpu::value,
           "expected (pixels, most) on the CPU");
    require(touched, nb::dtype<std::int32_t>(), touched, "touched", {rows_of(touched), columns_of(touched)});
    const auto* const named = static_cast<const std::int32_t*>(touched.data());
    expect(std::all_of(named, named + touched.size(), [&](std::int32_t e) { return e < count; }),
           "an element that does not exist");
}

void count(const Input& touched, const Output& counts) {
    check_named(touched, static_cast<Index>(counts.size()));
    require(counts, nb::dtype<std::int32_t>(), touched, "counts", {static_cast<Index>(counts.size())});
    const nb::gil_scoped_release unlocked;
    mipbake::count_contributions_cpu(static_cast<const std::int32_t*>(touched.data()), rows_of(touched),
                                     columns_of(touched), static_cast<Index>(counts.size()),
                                     static_cast<std::int32_t*>(counts.data()));
}

void fill(const Input& touched, const Output& cursors, const Output& pixels) {
    check_named(touched, static_cast<Index>(cursors.size()));
    require(cursors, nb::dtype<std::int64_t>(), touched, "cursors", {static_cast<Index>(cursors.size())});
    require(pixels, nb::dtype<std::int32_t>(), touched, "pixels", {static_cast<Index>(pixels.size())});
    const nb::gil_scoped_release unlocked;
    mipbake::fill_contributions_cpu(static_cast<const std::int32_t*>(touched.data()), rows_of(touched),
                                    columns_of(touched), static_cast<Index>(cursors.size()),
                                    static_cast<std::int64_t*>(cursors.data()),
                                    static_cast<std::int32_t*>(pixels.data()));
}

}  // namespace

void bind_stochastic(nb::module_& m) {
    using namespace nb::literals;
    m.def("stochastic_perturb", &perturb, "values"_a, "elements"_a.none(), "magnitude"_a, "low"_a, "high"_a, "lifted"_a,
          "step"_a, "seed"_a, "plus"_a, "minus"_a, "stream"_a = 0,
          "Fills plus and minus (N, C) from values (N, C), at the listed elements (K) int32, or at all.");
    m.def("stochastic_differences", &differences, "plus"_a, "minus"_a, "reference"_a, "weights"_a.none(), "out"_a,
          "stream"_a = 0, "Fills out (P) from images (P, C) and weights (P).");
    m.def("stochastic_gradient", &gradient, "differences"_a, "elements"_a, "starts"_a, "pixels"_a, "magnitude"_a,
          "step"_a, "seed"_a, "gradient"_a, "stream"_a = 0,
          "Adds to gradient (N, C) from differences (P), elements (K) int32, starts (K + 1) int64, pixels int32.");
    m.def("stochastic_adam", &adam, "values"_a, "gradient"_a, "first"_a, "second"_a, "steps"_a, "elements"_a.none(),
          "rate"_a, "low"_a, "high"_a, "lifted"_a, "beta1"_a, "beta2"_a, "epsilon"_a, "stream"_a = 0,
          "Updates values, first, second (N, C) and steps (N) int32 in place, and sets gradient (N, C) to 0.");
    m.def("stochastic_count", &count, "touched"_a, "counts"_a, "Adds to counts (N) int32 from touched (P, K) int32.");
    m.def("stochastic_fill", &fill, "touched"_a, "cursors"_a, "pixels"_a,
          "Fills pixels int32 from touched (P, K) int32 and cursors (N) int64, which are moved.");
    m.def("stochastic_touched", &touched, "sizes"_a, "uv"_a, "lod"_a.none(), "uv_da"_a.none(), "seen"_a.none(),
          "filter"_a, "boundary_u"_a, "boundary_v"_a, "texels"_a, "stream"_a = 0,
          "Fills texels (P, K) int32 with numbers of texels of levels of these sizes, from uv (P, 2).");
}
