#include "cpu/stochastic.h"

#include <vector>

#include "core/parallel.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

// Calls f(element, pixel) for what each pixel names, once each. A pixel may name thousands, so that each element
// remembers the pixel that named it last.
template <class F>
void for_each_named(const std::int32_t* touched, Index pixels, Index most, Index elements, F&& f) {
    std::vector<std::int32_t> last(static_cast<std::size_t>(elements), -1);
    for (Index i = 0; i < pixels * most; ++i) {
        const std::int32_t named = touched[i], pixel = static_cast<std::int32_t>(i / most);
        if (named < 0 || last[static_cast<std::size_t>(named)] == pixel) continue;
        last[static_cast<std::size_t>(named)] = pixel;
        f(named, pixel);
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

void count_contributions_cpu(const std::int32_t* touched, Index pixels, Index most, Index elements,
                             std::int32_t* counts) {
    for_each_named(touched, pixels, most, elements, [&](std::int32_t element, std::int32_t) { ++counts[element]; });
}

void fill_contributions_cpu(const std::int32_t* touched, Index pixels, Index most, Index elements, Index* cursors,
                            std::int32_t* out) {
    for_each_named(touched, pixels, most, elements,
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
