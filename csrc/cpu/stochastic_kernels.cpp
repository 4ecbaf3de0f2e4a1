// Stochastic gradients on the CPU: a loop over elements or pixels.
#include "core/real.h"
#include "cpu/stochastic.h"
#include "stochastic/elements.h"
#include "stochastic/touched.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;

Index element_at(const ElementList& list, Index i) { return list.listed != nullptr ? list.listed[i] : i; }

// The number of an element's first parameter, which its signs hang on.
std::uint32_t first_of(Index element, int channels) { return static_cast<std::uint32_t>(element * channels); }

}  // namespace

template <class T>
void perturb_range(const PerturbArgs<T>& args, Index begin, Index end) {
    const ChannelNumbers<T> n = numbers_of(args.channels);
    for (Index i = begin; i < end; ++i) {
        const Index e = element_at(args.elements, i), at = e * n.count;
        perturb_element(args.values + at, n, first_of(e, n.count), args.key, args.plus + at, args.minus + at);
    }
}

template <class T>
void gradient_range(const GradientArgs<T>& args, Index begin, Index end) {
    const ChannelNumbers<T> n = numbers_of(args.channels);
    for (Index i = begin; i < end; ++i) {
        double sum = 0;
        for (Index k = args.starts[i]; k < args.starts[i + 1]; ++k)
            sum += static_cast<double>(args.differences[args.pixels[k]]);
        const Index e = element_at(args.elements, i);
        add_gradient(static_cast<T>(sum), n, first_of(e, n.count), args.key, args.gradient + e * n.count);
    }
}

template <class T>
void adam_range(const AdamArgs<T>& args, Index begin, Index end) {
    const ChannelNumbers<T> n = numbers_of(args.channels);
    // Powers take longer than all else, and neighbours mostly have as many steps.
    std::int32_t known = 0;
    AdamScales<T> whole{};
    for (Index i = begin; i < end; ++i) {
        const Index e = element_at(args.elements, i), at = e * n.count;
        const std::int32_t steps = ++args.steps[e];
        if (steps != known) whole = adam_scales(known = steps, args.beta1, args.beta2);
        adam_element(args.values + at, args.gradient + at, args.first + at, args.second + at, whole, n, args.beta1,
                     args.beta2, args.epsilon);
    }
}

// |p - r|^2 - |m - r|^2 as (p - m) . (p + m - 2 r), which does not cancel.
template <class T>
void differences_range(const T* plus, const T* minus, const T* reference, const T* weights, Index begin, Index end,
                       Index channels, T* out) {
    for (Index i = begin; i < end; ++i) {
        T sum = 0;
        for (Index c = i * channels; c < (i + 1) * channels; ++c)
            sum += (plus[c] - minus[c]) * (plus[c] + minus[c] - 2 * reference[c]);
        out[i] = weights != nullptr ? weights[i] * sum : sum;
    }
}

void touched_range(const TouchedArgs& args, Index begin, Index end, std::int32_t* texels) {
    for (Index i = begin; i < end; ++i) add_touched(args, i, texels + i * args.most);
}

template void perturb_range<float>(const PerturbArgs<float>&, Index, Index);
template void perturb_range<double>(const PerturbArgs<double>&, Index, Index);
template void gradient_range<float>(const GradientArgs<float>&, Index, Index);
template void gradient_range<double>(const GradientArgs<double>&, Index, Index);
template void adam_range<float>(const AdamArgs<float>&, Index, Index);
template void adam_range<double>(const AdamArgs<double>&, Index, Index);
template void differences_range<float>(const float*, const float*, const float*, const float*, Index, Index, Index,
                                       float*);
template void differences_range<double>(const double*, const double*, const double*, const double*, Index, Index, Index,
                                        double*);

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
