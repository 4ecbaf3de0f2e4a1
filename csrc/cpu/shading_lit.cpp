#include "cpu/shading_lit.h"

#include <algorithm>
#include <vector>

#include "core/parallel.h"

namespace mipbake {

namespace {

// What a work item should hold, in evaluations: long against the cost of handing it out, short against the whole.
constexpr std::int64_t kEvaluationsPerItem = 16384;

// A whole number of packets of any instruction set.
constexpr std::int64_t kPointsAtLeast = 64;

}  // namespace

void shade_lit_cpu(const ShadeLitArgs& args, void* out) {
    if (args.B * args.N == 0) return;
    const std::int64_t bytes = MIPBAKE_DISPATCH(shade_light_bytes)(args.is_double);
    std::vector<unsigned char> lights(static_cast<std::size_t>(args.B * args.K * bytes));
    MIPBAKE_DISPATCH(shade_make_lights)(args, lights.data());
    const auto points = MIPBAKE_DISPATCH(shade_points);
    const std::int64_t blocks = kEvaluationsPerItem / (kPointsAtLeast * std::max<std::int64_t>(args.K, 1));
    const std::int64_t grain = kPointsAtLeast * std::max<std::int64_t>(blocks, 1), parts = (args.N + grain - 1) / grain;
    parallel_for(args.B * parts, std::max<std::int64_t>(grain / std::max<std::int64_t>(args.N, 1), 1),
                 [&](std::int64_t begin, std::int64_t end) {
                     for (std::int64_t item = begin; item < end; ++item) {
                         const std::int64_t surface = item / parts, from = item % parts * grain;
                         points(args, surface, from, std::min(args.N, from + grain),
                                lights.data() + surface * args.K * bytes, out);
                     }
                 });
}

}  // namespace mipbake
