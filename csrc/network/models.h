// Which channels the material models have that moment networks read and make. mipbake/material has the same layouts;
// models/moment_baker.py checks that they agree.
#pragma once

#include "core/isa.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace network {

// Places of stored channels. `metallic`: one colour at 0 and its share of metal; else two reflectances, at 0 and 3.
// `tensor`: a log-roughness tensor stands for the roughness. `heights`: normals have their z.
struct ReadGltf {
    static constexpr bool metallic = true, tensor = false, gamma = false, heights = true;
    static constexpr int channels = 8, normal = 5, lobe = 4;
};
struct ReadGgx {
    static constexpr bool metallic = false, tensor = true, gamma = false, heights = false;
    static constexpr int channels = 11, normal = 6, lobe = 8;
};
struct ReadBeckmann {
    static constexpr bool metallic = false, tensor = true, gamma = true, heights = false;
    static constexpr int channels = 12, normal = 6, lobe = 8, peak = 11;
};

// What is made of what is read: the same, or a direction and a strength of anisotropy behind the channels of glTF.
template <class R, bool Lines>
struct Made {
    using Read = R;
    static constexpr bool lines = Lines;
    static constexpr int channels = R::channels + (Lines ? 3 : 0);
};

// Calls f(M()) for what is made, by its index.
template <class F>
decltype(auto) visit_model(int model, F&& f) {
    switch (model) {
        case 0:
            return f(Made<ReadGltf, false>());
        case 1:
            return f(Made<ReadGltf, true>());
        case 2:
            return f(Made<ReadGgx, false>());
        default:
            return f(Made<ReadBeckmann, false>());
    }
}

constexpr float kSlope = 0.1f;  // of the rectifier below zero, as dense.py has it

}  // namespace network
}  // namespace MIPBAKE_ISA
}  // namespace mipbake
