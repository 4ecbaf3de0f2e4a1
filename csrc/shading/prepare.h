// What every kernel does with a model once per texel: prepare its surface, and pull a gradient back through that.
#pragma once

#include <type_traits>

#include "core/dual.h"
#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// Stored channels are held to this magnitude, far beyond any material, so that nothing overflows.
constexpr double kLargestChannel = 1e4;

template <class Model>
struct Prepare {
    static constexpr int C = Model::channels;
    static constexpr int colours = Model::colour_channels;
    template <class A, class B>
    using Surface = typename Model::template Surface<A, B>;

    // Visits the fields of both halves.
    template <class A, class B, class F>
    static MIPBAKE_INLINE void zip(A& a, B& b, F f) {
        std::decay_t<A>::zip_colour(a, b, f);
        std::decay_t<A>::zip_shape(a, b, f);
    }

    // Prepares in A, then brings the fields that only the lobe's precision needs to B.
    template <class A, class B>
    static MIPBAKE_FUNCTION Surface<A, B> surface(const A (&channels)[C]) {
        A held[C];
        for (int c = 0; c < C; ++c) held[c] = clamp(channels[c], -kLargestChannel, kLargestChannel);
        Surface<A, A> wide;
        Model::prepare_colour(held, wide);
        Model::prepare_shape(held + colours, wide);
        Surface<A, B> out;
        zip(out, wide, [](auto& to, const A& from) { to = narrow<std::decay_t<decltype(to)>>(from); });
        return out;
    }

    // The gradient by the stored channels, from the gradient by the surface: each half on dual numbers.
    template <class W, class T>
    static MIPBAKE_FUNCTION void pull_back(const W (&channels)[C], const Surface<T, T>& adjoint, T (&gradient)[C]) {
        for (T& g : gradient) g = T(0);
        {
            using D = Dual<W, colours, T>;
            D inputs[colours];
            for (int c = 0; c < colours; ++c) inputs[c] = input<D>(channels[c], c);
            Surface<D, D> surface;
            Model::prepare_colour(inputs, surface);
            Surface<D, D>::zip_colour(adjoint, surface, [&](const T& bar, const D& field) {
                for (int c = 0; c < colours; ++c) gradient[c] = gradient[c] + bar * field.d[c];
            });
        }
        {
            using D = Dual<W, C - colours, T>;
            D inputs[C - colours];
            for (int c = colours; c < C; ++c) inputs[c - colours] = input<D>(channels[c], c - colours);
            Surface<D, D> surface;
            Model::prepare_shape(inputs, surface);
            Surface<D, D>::zip_shape(adjoint, surface, [&](const T& bar, const D& field) {
                for (int c = colours; c < C; ++c) gradient[c] = gradient[c] + bar * field.d[c - colours];
            });
        }
    }

  private:
    template <class D, class W>
    static MIPBAKE_INLINE D input(const W& channel, int index) {
        return clamp(D::input(channel, index), -kLargestChannel, kLargestChannel);
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
