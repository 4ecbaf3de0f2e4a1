// Exceptions end the module: whoever called it finds the sentence in `last_fault`, and starts another module.
#include <cxxabi.h>

#include <cstdlib>
#include <exception>
#include <stdexcept>
#include <string>
#include <typeinfo>

namespace {

std::string& fault() {
    static std::string text;
    return text;
}

}  // namespace

extern "C" {

__attribute__((export_name("last_fault"))) const char* mipbake_last_fault() { return fault().c_str(); }

void* __cxa_allocate_exception(std::size_t size) noexcept { return std::malloc(size); }

// All that csrc throws is of std::exception, first in the object. What the C++ library throws comes here, too.
void __cxa_throw(void* exception, std::type_info*, void* (*)(void*)) {
    fault() = static_cast<const std::exception*>(exception)->what();
    __builtin_trap();
}
}
