#include "ops/shading.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>
#include <nanobind/stl/pair.h>
#include <nanobind/stl/string.h>
#include <nanobind/stl/vector.h>

#include <cstdint>
#include <initializer_list>
#include <string>
#include <utility>
#include <vector>

#include "bind/arrays.h"

namespace {

using mipbake::bind::Input, mipbake::bind::Output, mipbake::bind::launch;

// (B, K, 3), or (B, K, N, 3) where texels have directions of their own.
mipbake::StridedDirections directions(const Input& a) {
    if (a.ndim() == 3) return {a.data(), {a.stride(0), a.stride(1), a.stride(2)}};
    return {a.data(), {a.stride(0), a.stride(1), a.stride(3)}, a.stride(2)};
}

mipbake::StridedArray3 strided(const Input& a) { return {a.data(), {a.stride(0), a.stride(1), a.stride(2)}}; }

template <class Array>
void require(const Array& a, const Input& like, const char* name, std::initializer_list<std::size_t> shape,
             bool contiguous) {
    bool good = a.ndim() == shape.size() && a.dtype() == like.dtype() && a.device_type() == like.device_type() &&
                a.device_id() == like.device_id();
    std::int64_t stride = 1;
    for (std::size_t i = shape.size(); good && i-- > 0;) {
        good = a.shape(i) == shape.begin()[i];
        if (contiguous) good = good && (a.shape(i) == 1 || a.size() == 0 || a.stride(i) == stride);
        stride *= static_cast<std::int64_t>(shape.begin()[i]);
    }
    if (!good) throw nb::value_error((std::string("unexpected shape, strides, dtype or device of ") + name).c_str());
}

int index_of(const std::string& model) {
    for (int i = 0; i < mipbake::model_count(); ++i)
        if (model == mipbake::model_info(i).name) return i;
    throw nb::value_error("no such model");
}

bool is_double(const Input& material) {
    if (material.dtype() == nb::dtype<double>()) return true;
    if (material.dtype() != nb::dtype<float>()) throw nb::value_error("expected float32 or float64");
    return false;
}

// The Python modules check what users pass; these checks keep a mistake of theirs from reading out of bounds.
mipbake::ShadeArgs arguments(const std::string& model, const Input& material, const Input& light, const Input& view,
                             bool black) {
    const int index = index_of(model);
    if (material.ndim() != 3) throw nb::value_error("expected a material of 3 axes");
    if (light.ndim() != 3 && light.ndim() != 4) throw nb::value_error("expected lights of 3 or 4 axes");
    const std::size_t B = material.shape(0), N = material.shape(1), K = light.shape(1);
    const auto channels = static_cast<std::size_t>(mipbake::model_info(index).channels);
    require(material, material, "material", {B, N, channels}, false);
    for (const auto& [name, array] : {std::pair("light", &light), std::pair("view", &view)}) {
        if (light.ndim() == 3) {
            require(*array, material, name, {B, K, 3}, false);
        } else {
            require(*array, material, name, {B, K, N, 3}, false);
        }
    }
    return {index,
            is_double(material),
            static_cast<std::int64_t>(B),
            static_cast<std::int64_t>(K),
            static_cast<std::int64_t>(N),
            strided(material),
            directions(light),
            directions(view),
            black};
}

void shade(const std::string& model, const Input& material, const Input& light, const Input& view,
           const Output& radiance, std::uintptr_t stream, bool black) {
    const mipbake::ShadeArgs args = arguments(model, material, light, view, black);
    require(radiance, material, "radiance", {material.shape(0), light.shape(1), material.shape(1), 3}, true);
    void* const out = radiance.data();
    launch(
        args.is_double, material, stream, [&] { mipbake::shade_cpu(args, out); },
        [&](auto queue) { mipbake::shade_cuda(args, out, queue); });
}

void shade_backward(const std::string& model, const Input& material, const Input& light, const Input& view,
                    const Input& grad_radiance, const Output& grad_material, std::uintptr_t stream, bool duals,
                    bool black) {
    const mipbake::ShadeArgs args = arguments(model, material, light, view, black);
    const std::size_t B = material.shape(0), N = material.shape(1), C = material.shape(2);
    require(grad_radiance, material, "grad_radiance", {B, light.shape(1), N, 3}, true);
    require(grad_material, material, "grad_material", {B, N, C}, true);
    const void* const in = grad_radiance.data();
    void* const out = grad_material.data();
    if (duals && (material.device_type() != nb::device::cpu::value || args.per_texel()))
        throw nb::value_error("duals are for the CPU and for shared directions");
    launch(
        args.is_double, material, stream, [&] { mipbake::shade_backward_cpu(args, in, out, duals); },
        [&](auto queue) { mipbake::shade_backward_cuda(args, in, out, queue); });
}

void shade_directions_backward(const std::string& model, const Input& material, const Input& light, const Input& view,
                               const Input& grad_radiance, const Output& grad_light, const Output& grad_view,
                               std::uintptr_t stream, bool black) {
    const mipbake::ShadeArgs args = arguments(model, material, light, view, black);
    const std::size_t B = material.shape(0), N = material.shape(1), K = light.shape(1);
    require(grad_radiance, material, "grad_radiance", {B, K, N, 3}, true);
    require(grad_light, material, "grad_light", {B, K, N, 3}, true);
    require(grad_view, material, "grad_view", {B, K, N, 3}, true);
    const void* const in = grad_radiance.data();
    void *const to_light = grad_light.data(), *const to_view = grad_view.data();
    launch(
        args.is_double, material, stream, [&] { mipbake::shade_directions_backward_cpu(args, in, to_light, to_view); },
        [&](auto queue) { mipbake::shade_directions_backward_cuda(args, in, to_light, to_view, queue); });
}

void shade_lit(const std::string& model, const Input& material, const Input& frame, const Input& view,
               const Input& light, const Input& radiance, const Output& out, bool black) {
    if (material.ndim() != 3 || light.ndim() != 3) throw nb::value_error("expected materials and lights of 3 axes");
    if (material.device_type() != nb::device::cpu::value) throw nb::value_error("expected arrays on the CPU");
    const mipbake::ModelInfo info = mipbake::model_info(index_of(model));
    const std::size_t B = material.shape(0), N = material.shape(1), K = light.shape(1);
    require(material, material, "material", {B, N, static_cast<std::size_t>(info.channels)}, false);
    require(frame, material, "frame", {B, N, 3, 3}, false);
    require(view, material, "view", {B, N, 3}, false);
    require(light, material, "light", {B, K, 3}, true);
    require(radiance, material, "radiance", {B, K, 3}, true);
    require(out, material, "out", {B, N, 3}, true);
    const mipbake::ShadeLitArgs args = {index_of(model),
                                        is_double(material),
                                        static_cast<std::int64_t>(B),
                                        static_cast<std::int64_t>(N),
                                        static_cast<std::int64_t>(K),
                                        material.data(),
                                        {material.stride(0), material.stride(1), material.stride(2)},
                                        frame.data(),
                                        {frame.stride(0), frame.stride(1), frame.stride(2), frame.stride(3)},
                                        view.data(),
                                        {view.stride(0), view.stride(1), view.stride(2)},
                                        light.data(),
                                        radiance.data(),
                                        black};
    void* const to = out.data();
    const nb::gil_scoped_release release;
    mipbake::shade_lit_cpu(args, to);
}

}  // namespace

void bind_shading(nb::module_& m) {
    m.def(
        "models",
        [] {
            std::vector<std::pair<std::string, int>> models;
            for (int i = 0; i < mipbake::model_count(); ++i) {
                const mipbake::ModelInfo info = mipbake::model_info(i);
                models.emplace_back(info.name, info.channels);
            }
            return models;
        },
        "(name, stored channels) of every material model.");
    m.def("shade", &shade, nb::arg("model"), nb::arg("material"), nb::arg("light"), nb::arg("view"),
          nb::arg("radiance"), nb::arg("stream") = 0, nb::arg("black") = false,
          "Writes f(theta, l, v) of material (B, N, C), light and view (B, K, 3) or both (B, K, N, 3) into radiance "
          "(B, K, N, 3). `black` is what is shaded where the normal turns away from the viewer.");
    m.def(
        "shade_lit", &shade_lit, nb::arg("model"), nb::arg("material"), nb::arg("frame"), nb::arg("view"),
        nb::arg("light"), nb::arg("radiance"), nb::arg("out"), nb::arg("black") = false,
        "Writes the sum over lights (B, K, 3) of radiance (B, K, 3) * f(theta, l, v) of material (B, N, C) with frame "
        "(B, N, 3, 3), view (B, N, 3) into out (B, N, 3).");
    m.def(
        "shade_backward", &shade_backward, nb::arg("model"), nb::arg("material"), nb::arg("light"), nb::arg("view"),
        nb::arg("grad_radiance"), nb::arg("grad_material"), nb::arg("stream") = 0, nb::arg("duals") = false,
        nb::arg("black") = false,
        "Writes the gradient by the material into grad_material (B, N, C), from grad_radiance (B, K, N, 3); arguments "
        "as for shade.");
    m.def("shade_directions_backward", &shade_directions_backward, nb::arg("model"), nb::arg("material"),
          nb::arg("light"), nb::arg("view"), nb::arg("grad_radiance"), nb::arg("grad_light"), nb::arg("grad_view"),
          nb::arg("stream") = 0, nb::arg("black") = false,
          "Writes the gradients by light and view of each texel into grad_light and grad_view (B, K, N, 3), at right "
          "angles to them, from grad_radiance (B, K, N, 3); arguments as for shade.");
}
