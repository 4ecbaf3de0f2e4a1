#include <nanobind/nanobind.h>

namespace nb = nanobind;

void bind_shading(nb::module_&) {}
