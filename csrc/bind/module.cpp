#include <nanobind/nanobind.h>

#include <exception>

#include "ops/runtime.h"

namespace nb = nanobind;

void bind_shading(nb::module_& m);
void bind_texture(nb::module_& m);
void bind_resample(nb::module_& m);
void bind_blocks(nb::module_& m);
void bind_raster(nb::module_& m);
void bind_interpolate(nb::module_& m);
void bind_antialias(nb::module_& m);
void bind_network(nb::module_& m);
void bind_pages(nb::module_& m);
void bind_stochastic(nb::module_& m);
void bind_splats(nb::module_& m);

NB_MODULE(_native, m) {
    nb::register_exception_translator([](const std::exception_ptr& thrown, void*) {
        try {
            std::rethrow_exception(thrown);
        } catch (const mipbake::EnvironmentFault& fault) {
            PyErr_SetString(nb::module_::import_("mipbake.base.errors").attr("UsageError").ptr(), fault.what());
        }
    });
    m.doc() = "The native core of mipbake. Arguments are checked by the Python modules that call it, not here.";
    m.def("isa", &mipbake::active_isa_name, "Instruction set of the CPU kernels: 'baseline', 'avx2' or 'avx512'.");
    m.def("num_threads", &mipbake::num_threads, "Threads that a CPU kernel may use, the caller included.");
    m.def("set_num_threads", &mipbake::set_num_threads, nb::arg("count"));
    m.def("cuda_compiled", &mipbake::cuda_compiled, "Whether this build has CUDA kernels.");
    m.def("cuda_available", &mipbake::cuda_available, "Whether it also finds a CUDA device to run them on.");
    bind_shading(m);
    bind_texture(m);
    bind_resample(m);
    bind_blocks(m);
    bind_raster(m);
    bind_interpolate(m);
    bind_antialias(m);
    bind_network(m);
    bind_pages(m);
    bind_stochastic(m);
    bind_splats(m);
}
