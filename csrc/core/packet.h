// Packets: N numbers of one type that a kernel treats as one number. N is the number of 32-bit lanes of the instruction
// set, so a packet of float is one register and one of double two (or N half of that for kernels in double throughout).
// Built on the vector extensions of GCC and Clang; other compilers, and WebAssembly without SIMD, get packets of one
// lane.
#pragma once

#include <cstdint>
#include <cstring>
#include <type_traits>
#include <utility>

#include "core/real.h"

#if defined(__GNUC__) && !defined(__CUDACC__) && (!defined(__wasm__) || defined(__wasm_simd128__))
#define MIPBAKE_VECTORS
#if defined(__x86_64__)
#include <immintrin.h>
#endif
#endif
#if defined(MIPBAKE_VECTORS) && defined(__has_builtin)
#if __has_builtin(__builtin_shufflevector)
#define MIPBAKE_SHUFFLES
#endif
#endif

namespace mipbake {
inline namespace MIPBAKE_ISA {

#ifdef MIPBAKE_VECTORS

#if defined(__AVX512F__)
constexpr int kRegisterBytes = 64;
#elif defined(__AVX2__)
constexpr int kRegisterBytes = 32;
#else
constexpr int kRegisterBytes = 16;
#endif

template <class T>
struct IntegerOf;
template <>
struct IntegerOf<float> {
    using type = std::int32_t;
};
template <>
struct IntegerOf<double> {
    using type = std::int64_t;
};

// One register.
template <class T>
struct Register {
    typedef T type __attribute__((vector_size(kRegisterBytes)));
    static constexpr int lanes = kRegisterBytes / static_cast<int>(sizeof(T));
};

MIPBAKE_INLINE Register<float>::type register_sqrt(Register<float>::type x) {
#if defined(__AVX512F__)
    return _mm512_sqrt_ps(x);
#elif defined(__AVX2__)
    return _mm256_sqrt_ps(x);
#elif defined(__SSE2__)
    return _mm_sqrt_ps(x);
#elif defined(__wasm_simd128__)
    return __builtin_wasm_sqrt_f32x4(x);
#else
    for (int i = 0; i < Register<float>::lanes; ++i) x[i] = sqrtf(x[i]);
    return x;
#endif
}
MIPBAKE_INLINE Register<double>::type register_sqrt(Register<double>::type x) {
#if defined(__AVX512F__)
    return _mm512_sqrt_pd(x);
#elif defined(__AVX2__)
    return _mm256_sqrt_pd(x);
#elif defined(__SSE2__)
    return _mm_sqrt_pd(x);
#elif defined(__wasm_simd128__)
    return __builtin_wasm_sqrt_f64x2(x);
#else
    for (int i = 0; i < Register<double>::lanes; ++i) x[i] = ::sqrt(x[i]);
    return x;
#endif
}

// A register of doubles from as many consecutive floats.
MIPBAKE_INLINE Register<double>::type register_widen(const float* data) {
#if defined(__AVX512F__)
    return _mm512_cvtps_pd(_mm256_loadu_ps(data));
#elif defined(__AVX2__)
    return _mm256_cvtps_pd(_mm_loadu_ps(data));
#else
    Register<double>::type out;
    for (int i = 0; i < Register<double>::lanes; ++i) out[i] = static_cast<double>(data[i]);
    return out;
#endif
}

MIPBAKE_INLINE Register<float>::type register_narrow(Register<double>::type low, Register<double>::type high) {
#if defined(__AVX512DQ__)
    return _mm512_insertf32x8(_mm512_castps256_ps512(_mm512_cvtpd_ps(low)), _mm512_cvtpd_ps(high), 1);
#elif defined(__AVX2__)
    return _mm256_insertf128_ps(_mm256_castps128_ps256(_mm256_cvtpd_ps(low)), _mm256_cvtpd_ps(high), 1);
#elif defined(__SSE2__)
    return _mm_movelh_ps(_mm_cvtpd_ps(low), _mm_cvtpd_ps(high));
#else
    constexpr int half = Register<double>::lanes;
    Register<float>::type out;
    for (int i = 0; i < half; ++i) {
        out[i] = static_cast<float>(low[i]);
        out[i + half] = static_cast<float>(high[i]);
    }
    return out;
#endif
}

template <class T, int N>
struct Mask {
    using Integers = typename Register<typename IntegerOf<T>::type>::type;
    static constexpr int registers = N / Register<T>::lanes;
    Integers r[registers];
};

template <class T, int N>
struct Packet {
    using Scalar = T;
    using V = typename Register<T>::type;
    static constexpr int lanes = N;
    static constexpr int registers = N / Register<T>::lanes;
    static_assert(N % Register<T>::lanes == 0, "a packet is a whole number of registers");

    V r[registers];

    Packet() = default;
    MIPBAKE_INLINE Packet(T value) {
        for (V& v : r) v = value - V{};
    }

    static MIPBAKE_INLINE Packet load(const T* data) {
        Packet p;
        std::memcpy(p.r, data, sizeof p.r);
        return p;
    }
    MIPBAKE_INLINE void store(T* data) const { std::memcpy(data, r, sizeof r); }

#define MIPBAKE_PACKET_OPERATOR(op)                                              \
    friend MIPBAKE_INLINE Packet operator op(const Packet& a, const Packet& b) { \
        Packet out;                                                              \
        for (int i = 0; i < registers; ++i) out.r[i] = a.r[i] op b.r[i];         \
        return out;                                                              \
    }                                                                            \
    friend MIPBAKE_INLINE Packet& operator op## = (Packet & a, const Packet& b) { return a = a op b; }
    MIPBAKE_PACKET_OPERATOR(+)
    MIPBAKE_PACKET_OPERATOR(-)
    MIPBAKE_PACKET_OPERATOR(*)
    MIPBAKE_PACKET_OPERATOR(/)
#undef MIPBAKE_PACKET_OPERATOR
    friend MIPBAKE_INLINE Packet operator-(const Packet& a) {
        Packet out;
        for (int i = 0; i < registers; ++i) out.r[i] = -a.r[i];
        return out;
    }

#define MIPBAKE_PACKET_COMPARISON(op)                                                                     \
    friend MIPBAKE_INLINE Mask<T, N> operator op(const Packet& a, const Packet& b) {                      \
        Mask<T, N> out;                                                                                   \
        for (int i = 0; i < registers; ++i) out.r[i] = (typename Mask<T, N>::Integers)(a.r[i] op b.r[i]); \
        return out;                                                                                       \
    }
    MIPBAKE_PACKET_COMPARISON(<)
    MIPBAKE_PACKET_COMPARISON(>)
    MIPBAKE_PACKET_COMPARISON(>=)
#undef MIPBAKE_PACKET_COMPARISON

    friend MIPBAKE_INLINE Packet select(const Mask<T, N>& condition, const Packet& yes, const Packet& no) {
        Packet out;
        for (int i = 0; i < registers; ++i) out.r[i] = condition.r[i] ? yes.r[i] : no.r[i];
        return out;
    }
    friend MIPBAKE_INLINE Packet square_root(const Packet& a) {
        Packet out;
        for (int i = 0; i < registers; ++i) out.r[i] = register_sqrt(a.r[i]);
        return out;
    }
};

template <class T, int N>
MIPBAKE_INLINE Mask<T, N> both(const Mask<T, N>& a, const Mask<T, N>& b) {
    Mask<T, N> out;
    for (int i = 0; i < Mask<T, N>::registers; ++i) out.r[i] = a.r[i] & b.r[i];
    return out;
}

// Whether any lane is set.
template <class T, int N>
MIPBAKE_INLINE bool any(const Mask<T, N>& mask) {
    auto joined = mask.r[0];
    for (int i = 1; i < Mask<T, N>::registers; ++i) joined |= mask.r[i];
#if defined(__AVX512F__)
    return _mm512_test_epi32_mask(reinterpret_cast<__m512i>(joined), reinterpret_cast<__m512i>(joined)) != 0;
#elif defined(__AVX2__)
    return _mm256_movemask_epi8(reinterpret_cast<__m256i>(joined)) != 0;
#elif defined(__SSE2__)
    return _mm_movemask_epi8(reinterpret_cast<__m128i>(joined)) != 0;
#elif defined(__wasm_simd128__)
    typedef signed char Bytes __attribute__((vector_size(16)));
    return __builtin_wasm_any_true_v128(reinterpret_cast<Bytes>(joined)) != 0;
#else
    bool found = false;
    for (int i = 0; i < Register<T>::lanes; ++i) found = found || joined[i] != 0;
    return found;
#endif
}

template <int N>
struct Narrow<Packet<float, N>> {
    static MIPBAKE_INLINE Packet<float, N> from(const Packet<double, N>& wide) {
        Packet<float, N> out;
        for (int i = 0; i < Packet<float, N>::registers; ++i)
            out.r[i] = register_narrow(wide.r[2 * i], wide.r[2 * i + 1]);
        return out;
    }
    static MIPBAKE_INLINE Packet<float, N> from(const Packet<float, N>& same) { return same; }
};

template <class W, class T, int N>
MIPBAKE_INLINE W widen(const Packet<T, N>& x) {
    if constexpr (std::is_same_v<typename W::Scalar, T>) {
        return x;
    } else {
        W out;
#if defined(__AVX512DQ__)
        for (int i = 0; i < x.registers; ++i) {
            out.r[2 * i] = _mm512_cvtps_pd(_mm512_castps512_ps256(x.r[i]));
            out.r[2 * i + 1] = _mm512_cvtps_pd(_mm512_extractf32x8_ps(x.r[i], 1));
        }
#elif defined(__AVX2__)
        for (int i = 0; i < x.registers; ++i) {
            out.r[2 * i] = _mm256_cvtps_pd(_mm256_castps256_ps128(x.r[i]));
            out.r[2 * i + 1] = _mm256_cvtps_pd(_mm256_extractf128_ps(x.r[i], 1));
        }
#else
        T lanes[N];
        x.store(lanes);
        for (int i = 0; i < W::registers; ++i) out.r[i] = register_widen(lanes + i * Register<double>::lanes);
#endif
        return out;
    }
}

template <class P, class T, int N>
MIPBAKE_INLINE auto narrow_mask(const Mask<T, N>& mask) {
    if constexpr (sizeof(typename P::Scalar) == sizeof(T)) {
        return mask;
    } else {
        // 0 or -1, as a number and back: exact, and cheap beside the arithmetic that it guards.
        const auto as_number = select(mask, Packet<T, N>(1), Packet<T, N>(0));
        return narrow<P>(as_number) > P(0.5f);
    }
}

template <class T, int N>
struct PlainOf<Packet<T, N>> {
    using type = T;
};

#ifdef MIPBAKE_SHUFFLES
namespace rgb {
// Lane i of register k of an interleaved triple is channel (kN + i) % 3 of texel (kN + i) / 3.
template <class V, int K, int... I>
MIPBAKE_INLINE V pack(V r, V g, V b, std::integer_sequence<int, I...>) {
    constexpr int N = sizeof...(I);
    const V rg = __builtin_shufflevector(r, g, ((K * N + I) / 3 + ((K * N + I) % 3 == 1 ? N : 0))...);
    return __builtin_shufflevector(rg, b, ((K * N + I) % 3 == 2 ? N + (K * N + I) / 3 : I)...);
}
template <class V, int C, int... I>
MIPBAKE_INLINE V unpack(V a, V b, V c, std::integer_sequence<int, I...>) {
    constexpr int N = sizeof...(I);
    const V ab = __builtin_shufflevector(a, b, (3 * I + C < 2 * N ? 3 * I + C : 0)...);
    return __builtin_shufflevector(ab, c, (3 * I + C < 2 * N ? I : 3 * I + C - N)...);
}
}  // namespace rgb
#endif

// N interleaved triples to or from three packets.
template <class T, int N>
MIPBAKE_INLINE void store_interleaved(T* data, const Vec3<Packet<T, N>>& p) {
#ifdef MIPBAKE_SHUFFLES
    if constexpr (Packet<T, N>::registers == 1) {
        using V = typename Packet<T, N>::V;
        constexpr std::make_integer_sequence<int, N> lanes{};
        const V out[3] = {rgb::pack<V, 0>(p.x.r[0], p.y.r[0], p.z.r[0], lanes),
                          rgb::pack<V, 1>(p.x.r[0], p.y.r[0], p.z.r[0], lanes),
                          rgb::pack<V, 2>(p.x.r[0], p.y.r[0], p.z.r[0], lanes)};
        std::memcpy(data, out, sizeof out);
        return;
    }
#endif
    T planes[3][N];
    p.x.store(planes[0]);
    p.y.store(planes[1]);
    p.z.store(planes[2]);
    for (int i = 0; i < 3 * N; ++i) data[i] = planes[i % 3][i / 3];
}
template <class T, int N>
MIPBAKE_INLINE Vec3<Packet<T, N>> load_interleaved(const T* data, const Packet<T, N>&) {
    using P = Packet<T, N>;
#ifdef MIPBAKE_SHUFFLES
    if constexpr (P::registers == 1) {
        using V = typename P::V;
        constexpr std::make_integer_sequence<int, N> lanes{};
        V in[3];
        std::memcpy(in, data, sizeof in);
        Vec3<P> out;
        out.x.r[0] = rgb::unpack<V, 0>(in[0], in[1], in[2], lanes);
        out.y.r[0] = rgb::unpack<V, 1>(in[0], in[1], in[2], lanes);
        out.z.r[0] = rgb::unpack<V, 2>(in[0], in[1], in[2], lanes);
        return out;
    }
#endif
    T planes[3][N];
    for (int i = 0; i < 3 * N; ++i) planes[i % 3][i / 3] = data[i];
    return {P::load(planes[0]), P::load(planes[1]), P::load(planes[2])};
}

// The packets of kernels that read and write Scalar: Real has its precision, Wide is double, both as many lanes.
template <class Scalar>
struct Lanes {
    static constexpr int count = Register<Scalar>::lanes;
    using Real = Packet<Scalar, count>;
    using Wide = Packet<double, count>;
};
// The last argument of the loads names the type alone, so that the same call serves packets and plain numbers.
template <int N>
MIPBAKE_INLINE Packet<double, N> load_widened(const double* data, const Packet<double, N>&) {
    return Packet<double, N>::load(data);
}
template <int N>
MIPBAKE_INLINE Packet<double, N> load_widened(const float* data, const Packet<double, N>&) {
    Packet<double, N> out;
    for (int i = 0; i < out.registers; ++i) out.r[i] = register_widen(data + i * Register<double>::lanes);
    return out;
}
template <class T, int N>
MIPBAKE_INLINE void store_lanes(T* data, const Packet<T, N>& p) {
    p.store(data);
}

#else  // no vector extensions: packets of one lane are plain numbers

MIPBAKE_INLINE bool any(bool mask) { return mask; }

template <class Scalar>
struct Lanes {
    static constexpr int count = 1;
    using Real = Scalar;
    using Wide = double;
};
template <class T>
MIPBAKE_INLINE double load_widened(const T* data, double) {
    return static_cast<double>(*data);
}
template <class T>
MIPBAKE_INLINE void store_lanes(T* data, const T& value) {
    *data = value;
}
template <class T>
MIPBAKE_INLINE Vec3<T> load_interleaved(const T* data, const T&) {
    return {data[0], data[1], data[2]};
}
template <class T>
MIPBAKE_INLINE void store_interleaved(T* data, const Vec3<T>& p) {
    data[0] = p.x;
    data[1] = p.y;
    data[2] = p.z;
}

#endif

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
