// THE list of material models. The kernels, their dispatch, CUDA, the binding and the tests enumerate it.
//
// A model is a struct with
//
//     static constexpr const char* name;             what users call it
//     static constexpr int channels;                 stored channels C
//     static constexpr int colour_channels;          how many of them, the first ones, prepare_colour reads
//     static constexpr bool has_adjoint;             whether evaluate_adjoint exists
//     template <class W, class T> Surface;           what is prepared per texel; see GgxSurface for what it offers
//     prepare_colour(const R* c, Surface<R, R>&)     once per texel, from the first colour_channels stored channels
//     prepare_shape(const R* c, Surface<R, R>&)      once per texel, from the rest
//     evaluate(Surface<W, T>, Pair<S, ...>) -> Vec3<T>
//                                                    once per texel and light-view pair: f(theta, l, v), cosine
//                                                    included
//     evaluate_adjoint(Surface<W, T>, Pair<S, ...>, Vec3<T> gradient, Surface<T, T>& adjoint)
//     template <class W, class T> Seen;              a surface for one viewer and many lights; see GgxSeen for what it
//                                                    offers
//
// all of them templates that run on numbers, packets and dual numbers; R is double. It is prepared in two halves
// because dual numbers cost as much as they have inputs. A model with no adjoint of its own is differentiated by
// evaluating it on dual numbers; one that reflects with the GGX lobe inherits everything but the names and the two
// halves from GgxLobe. To add one: a header, a line here, a twin in mipbake/shading/reference.py, a description in
// mipbake/material/.
#pragma once

#include "shading/beckmann.h"
#include "shading/beckmann_seen.h"
#include "shading/ggx.h"
#include "shading/ggx_seen.h"
#include "shading/gltf.h"
#include "shading/gltf_anisotropic.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class... M>
struct ModelList {
    static constexpr int size = sizeof...(M);

    // Calls f(M{}) on the model at `index`.
    template <class F>
    static void visit(int index, F f) {
        int i = 0;
        static_cast<void>(((i++ == index ? (f(M{}), true) : false) || ...));
    }
};

using Models = ModelList<Gltf, GltfAnisotropic, Ggx, Beckmann>;

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
