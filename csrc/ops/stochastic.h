// What the core offers for stochastic gradients (Deliot, Heitz and Belcour 2024): plain pointers, sizes, a stream.
//
// Parameters lie in elements: texels, triangles or vertices of `channels` numbers each, one element after the other.
#pragma once

#include <cstdint>

#include "ops/runtime.h"
#include "ops/texture.h"

namespace mipbake {

constexpr int most_channels = 64;  // of an element

// Which random signs: those of one step under one seed. Nothing is stored; see csrc/stochastic/signs.h.
struct SignKey {
    std::uint32_t step, seed;
};

// What all elements have in common. Arrays have one number a channel, in the memory of the host, also for CUDA.
template <class T>
struct ElementChannels {
    int count;
    int lifted;          // first of three channels that hold a unit normal as (n + 1) / 2, z from x and y; -1 for none
    const T* magnitude;  // how far a channel is perturbed; 0 for one that stays as it is
    const T *low, *high;
};

// The elements that a call is about: all of them where `listed` is null.
struct ElementList {
    const std::int32_t* listed;  // (count) in the order in which they are worked on, none twice
    std::int64_t count;
};

template <class T>
struct PerturbArgs {
    const T* values;  // (elements, channels)
    ElementChannels<T> channels;
    ElementList elements;
    SignKey key;
    T *plus, *minus;  // (elements, channels): written where elements are listed
};

// For each pixel the elements that it was made of: pixels[starts[i]] ... pixels[starts[i + 1] - 1] show listed[i].
template <class T>
struct GradientArgs {
    const T* differences;  // (pixels) error with the signs, less the error with opposite signs
    std::int64_t pixel_count;
    const std::int64_t* starts;   // (count + 1)
    const std::int32_t* pixels;   // each below pixel_count
    ElementList elements;         // listed
    ElementChannels<T> channels;  // only count and magnitude are read
    SignKey key;
    T* gradient;  // (elements, channels): the estimate is added
};

// Adam (Kingma and Ba 2015, algorithm 1), with a count of steps for each element.
template <class T>
struct AdamArgs {
    T* values;                    // (elements, channels)
    T* gradient;                  // (elements, channels); read, and set to 0 for the next step
    T *first, *second;            // (elements, channels): the moments
    std::int32_t* steps;          // (elements): how often an element has been updated
    ElementChannels<T> channels;  // magnitude: the rate
    ElementList elements;
    T beta1, beta2, epsilon;
};

// Lookups of a MIP stack: where pixels see it.
struct TouchedArgs {
    int heights[max_levels], widths[max_levels];
    int level_count;
    std::int64_t points;
    const float* uv;           // (points, 2)
    const float* lod;          // (points), or null
    const float* uv_da;        // (points, 4), or null; the level of detail comes from one of the two
    const std::uint8_t* seen;  // (points): 0 where a pixel shows something else; null where all count
    Filter filter;             // nearest: the nearest texel of the nearest level; linear_mipmap_linear; or anisotropic
    Boundary boundary_u, boundary_v;  // not cube
    int most;                         // texels of a pixel: 1, 8, or 8 * 16
};

// plus, minus: theta + s epsilon and theta - s epsilon, algorithm 1.
template <class T>
void perturb_cpu(const PerturbArgs<T>& args);
// out (pixels): the error of plus less that of minus, algorithm 2. Images are (pixels, channels); weights (pixels) or
// null.
template <class T>
void differences_cpu(const T* plus, const T* minus, const T* reference, const T* weights, std::int64_t pixels,
                     std::int64_t channels, T* out);
// Adds equation 8. Sums do not depend on the number of threads.
template <class T>
void gradient_cpu(const GradientArgs<T>& args);
template <class T>
void adam_cpu(const AdamArgs<T>& args);
// texels (points, most): numbers of texels, level after level and row after row, each once; -1 behind the last.
void touched_cpu(const TouchedArgs& args, std::int32_t* texels);

// Turning (pixels, most) touched elements round, by a counting sort; -1 is none, and an element that a pixel names
// twice counts once. First counts[e] += the pixels of element e; then, with cursors[e] where the pixels of e begin,
// their numbers in increasing order, and each cursor is moved behind them. On the CPU alone, by one thread, in a time
// that grows with pixels * most and with the number of elements.
void count_contributions_cpu(const std::int32_t* touched, std::int64_t pixels, std::int64_t most, std::int64_t elements,
                             std::int32_t* counts);
void fill_contributions_cpu(const std::int32_t* touched, std::int64_t pixels, std::int64_t most, std::int64_t elements,
                            std::int64_t* cursors, std::int32_t* out);

// No atomics: results are the same from run to run.
void perturb_cuda(const PerturbArgs<float>& args, CudaStream stream);
void differences_cuda(const float* plus, const float* minus, const float* reference, const float* weights,
                      std::int64_t pixels, std::int64_t channels, float* out, CudaStream stream);
void gradient_cuda(const GradientArgs<float>& args, CudaStream stream);
void adam_cuda(const AdamArgs<float>& args, CudaStream stream);
void touched_cuda(const TouchedArgs& args, std::int32_t* texels, CudaStream stream);

}  // namespace mipbake
