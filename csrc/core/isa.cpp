#include "core/isa.h"

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <initializer_list>
#include <string>

#include "core/environment.h"

#if defined(MIPBAKE_X86_ISAS) && defined(_MSC_VER)
#include <immintrin.h>
#include <intrin.h>
#endif

namespace mipbake {
namespace {

#ifdef MIPBAKE_X86_ISAS
#ifdef _MSC_VER
Isa detect() {
    int leaf1[4], leaf7[4];
    __cpuid(leaf1, 1);
    __cpuidex(leaf7, 7, 0);
    const bool os_saves_registers = (leaf1[2] & (1 << 27)) != 0;
    const unsigned long long saved = os_saves_registers ? _xgetbv(0) : 0;
    const bool fma = (leaf1[2] & (1 << 12)) != 0;
    const bool avx2 = (leaf7[1] & (1 << 5)) != 0 && fma && (saved & 0x6) == 0x6;
    // AVX-512 F, DQ, BW, VL: bits 16, 17, 30, 31.
    const unsigned wanted = (1u << 16) | (1u << 17) | (1u << 30) | (1u << 31);
    const bool avx512 = avx2 && (static_cast<unsigned>(leaf7[1]) & wanted) == wanted && (saved & 0xe6) == 0xe6;
    return avx512 ? Isa::avx512 : avx2 ? Isa::avx2 : Isa::baseline;
}
#else
Isa detect() {
    __builtin_cpu_init();
    const bool avx2 = __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma");
    const bool avx512 = avx2 && __builtin_cpu_supports("avx512f") && __builtin_cpu_supports("avx512dq") &&
                        __builtin_cpu_supports("avx512bw") && __builtin_cpu_supports("avx512vl");
    return avx512 ? Isa::avx512 : avx2 ? Isa::avx2 : Isa::baseline;
}
#endif
#else
Isa detect() { return Isa::baseline; }
#endif

Isa choose() {
    const Isa best = detect();
    const char* const wish = std::getenv("MIPBAKE_ISA");
    if (wish == nullptr || *wish == '\0') return best;
    for (const Isa isa : {Isa::baseline, Isa::avx2, Isa::avx512})
        if (std::strcmp(wish, isa_name(isa)) == 0) return std::min(isa, best);
    throw EnvironmentFault("the environment variable MIPBAKE_ISA is '" + std::string(wish) +
                           "': expected baseline, avx2 or avx512, or no such variable for the best that there is");
}

}  // namespace

Isa active_isa() {
    static const Isa isa = choose();
    return isa;
}

const char* isa_name(Isa isa) {
    switch (isa) {
        case Isa::avx512:
            return "avx512";
        case Isa::avx2:
            return "avx2";
        default:
            return "baseline";
    }
}

}  // namespace mipbake
