#include "cpu/stochastic.h"

#include "core/parallel.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

// Calls f(element, pixel) for what each pixel names, once each.
template <class F>
void for_each_named(const std::int32_t* touched, Index pixels, Index most, F&& f) {
    for (Index p = 0; p < pixels; ++p) {
        const std::int32_t* const named = touched + p * most;
        for (Index k = 0; k < most; ++k) {
            bool is_first = named[k] >= 0;
            for (Index j = 0; j < k && is_first; ++j) is_first = named[j] != named[k];
            if (is_first) f(named[k], static_cast<std::int32_t>(p));
        }
    }
}

constexpr Index elements_per_part = 2048, pixels_per_part = 4096;  // enough to outweigh waking a thread

}  // namespace

template <class T>
void perturb_cpu(const PerturbArgs<T>& args) {
    parallel_for(args.elements.count, elements_per_part,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(perturb_range<T>)(args, begin, end); });
}

template <class T>
void gradient_cpu(const GradientArgs<T>& args) {
    parallel_for(args.elements.count, elements_per_part,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(gradient_range<T>)(args, begin, end); });
}

template <class T>
void adam_cpu(const AdamArgs<T>& args) {
    parallel_for(args.elements.count, elements_per_part,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(adam_range<T>)(args, begin, end); });
}

template <class T>
void differences_cpu(const T* plus, const T* minus, const T* reference, const T* weights, Index pixels, Index channels,
                     T* out) {
    parallel_for(pixels, pixels_per_part, [&](Index begin, Index end) {
        MIPBAKE_DISPATCH(differences_range<T>)(plus, minus, reference, weights, begin, end, channels, out);
    });
}

void touched_cpu(const TouchedArgs& args, std::int32_t* texels) {
    parallel_for(args.points, pixels_per_part,
                 [&](Index begin, Index end) { MIPBAKE_DISPATCH(touched_range)(args, begin, end, texels); });
}

void count_contributions_cpu(const std::int32_t* touched, Index pixels, Index most, std::int32_t* counts) {
    for_each_named(touched, pixels, most, [&](std::int32_t element, std::int32_t) { ++counts[element]; });
}

void fill_contributions_cpu(const std::int32_t* touched, Index pixels, Index most, Index* cursors, std::int32_t* out) {
    for_each_named(touched, pixels, most,
                   [&](std::int32_t element, std::int32_t pixel) { out[cursors[element]++] = pixel; });
}

template void perturb_cpu<float>(const PerturbArgs<float>&);
template void perturb_cpu<double>(const PerturbArgs<double>&);
template void gradient_cpu<float>(const GradientArgs<float>&);
template void gradient_cpu<double>(const GradientArgs<double>&);
template void adam_cpu<float>(const AdamArgs<float>&);
template void adam_cpu<double>(const AdamArgs<double>&);
template void differences_cpu<float>(const float*, const float*, const float*, const float*, Index, Index, float*);
template void differences_cpu<double>(const double*, const double*, const double*, const double*, Index, Index,
                                      double*);

}  // namespace mipbake
