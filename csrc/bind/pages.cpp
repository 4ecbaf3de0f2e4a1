#include "core/pages.h"

#include <nanobind/nanobind.h>
#include <nanobind/ndarray.h>

#include <cerrno>
#include <cstdint>
#include <memory>

namespace nb = nanobind;

namespace {

using Bytes = nb::ndarray<nb::numpy, std::uint8_t, nb::ndim<1>>;

Bytes map(mipbake::Pages& pages, int file, std::int64_t size) {
    std::shared_ptr<void> mapped = pages.map(file, size);
    if (mapped == nullptr) {
        PyErr_SetFromErrno(PyExc_OSError);
        throw nb::python_error();
    }
    void* const start = mapped.get();
    auto kept = std::make_unique<std::shared_ptr<void>>(std::move(mapped));
    const nb::capsule owner(kept.get(), [](void* held) noexcept {
        const std::unique_ptr<std::shared_ptr<void>> last(static_cast<std::shared_ptr<void>*>(held));
    });
    static_cast<void>(kept.release());
    return Bytes(start, {static_cast<std::size_t>(size)}, owner);
}

}  // namespace

void bind_pages(nb::module_& m) {
    using namespace nb::literals;
    m.def("pages_supported", &mipbake::pages_supported, "Whether this system has what the class Pages takes.");
    m.def("resident_bytes", &mipbake::resident_bytes, "Bytes that the process holds in memory now; 0 for unknown.");
    nb::class_<mipbake::Pages>(m, "Pages")
        .def(nb::init<std::int64_t>(), "most"_a)
        .def("map", &map, "file"_a, "size"_a, "(size,) uint8, the whole of a file that is open for reading and writing")
        .def("release", &mipbake::Pages::release, "Lets go of every page.");
}
