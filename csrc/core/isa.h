// Instruction sets: one translation unit, compiled once per set, picked at run time.
//
// The pattern. A file csrc/cpu/NAME_kernels.cpp is compiled once per instruction set with MIPBAKE_ISA defined as
// isa_baseline, isa_avx2 or isa_avx512. It and every header it includes from core/, shading/ and sampling/ put their
// code into `namespace mipbake { inline namespace MIPBAKE_ISA { ... } }`: without a namespace of its own the linker
// would fold the copies of an inline function into one, and the baseline could end up running AVX-512 code. For the
// same reason kernels keep away from containers and other out-of-line templates of the standard library.
//
// A kernel's entry point is declared for every set with MIPBAKE_FOR_EACH_ISA and called through MIPBAKE_DISPATCH in
// csrc/cpu/NAME.cpp, which is compiled once:
//
//     MIPBAKE_FOR_EACH_ISA(void shade(const ShadeArgs&);)
//     void shade_cpu(const ShadeArgs& args) { MIPBAKE_DISPATCH(shade)(args); }
#pragma once

#ifndef MIPBAKE_ISA
#define MIPBAKE_ISA isa_common
#endif

namespace mipbake {

enum class Isa { baseline, avx2, avx512 };

// The best set that this processor has, or a lower one that MIPBAKE_ISA=baseline|avx2|avx512 in the environment asks
// for. EnvironmentFault where MIPBAKE_ISA is anything else.
Isa active_isa();
const char* isa_name(Isa isa);

}  // namespace mipbake

#ifdef MIPBAKE_X86_ISAS
#define MIPBAKE_FOR_EACH_ISA(...) \
    namespace isa_baseline {      \
    __VA_ARGS__                   \
    }                             \
    namespace isa_avx2 {          \
    __VA_ARGS__                   \
    }                             \
    namespace isa_avx512 {        \
    __VA_ARGS__                   \
    }
#define MIPBAKE_DISPATCH(name)                                            \
    (::mipbake::active_isa() == ::mipbake::Isa::avx512 ? isa_avx512::name \
     : ::mipbake::active_isa() == ::mipbake::Isa::avx2 ? isa_avx2::name   \
                                                       : isa_baseline::name)
#else
#define MIPBAKE_FOR_EACH_ISA(...) \
    namespace isa_baseline {      \
    __VA_ARGS__                   \
    }
#define MIPBAKE_DISPATCH(name) (isa_baseline::name)
#endif
