// What differs between compilers: inlining, and functions that also run on a GPU.
#pragma once

#include "core/isa.h"

#if defined(__GNUC__)
#define MIPBAKE_PREFETCH_AT(address, for_writing) __builtin_prefetch(address, for_writing)
#else
#define MIPBAKE_PREFETCH_AT(address, for_writing) static_cast<void>(address)
#endif

#if defined(__CUDACC__)
#define MIPBAKE_INLINE __host__ __device__ __forceinline__
#define MIPBAKE_FUNCTION __host__ __device__ inline
#elif defined(MIPBAKE_SANITIZE)
// Every copy of an inlined function would bring its own checks: minutes of compiling.
#define MIPBAKE_INLINE inline
#define MIPBAKE_FUNCTION inline
#elif defined(__GNUC__)
#define MIPBAKE_INLINE inline __attribute__((always_inline))
#define MIPBAKE_FUNCTION inline
#else
#define MIPBAKE_INLINE __forceinline
#define MIPBAKE_FUNCTION inline
#endif
