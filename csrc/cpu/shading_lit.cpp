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
    if (args.N == 0) return;
    std::vector<unsigned char> lights(
        static_cast<std::size_t>(args.K * MIPBAKE_DISPATCH(shade_light_bytes)(args.is_double)));
    MIPBAKE_DISPATCH(shade_make_lights)(args, lights.data());
    const auto points = MIPBAKE_DISPATCH(shade_points);
    const std::int64_t blocks = kEvaluationsPerItem / (kPointsAtLeast * std::max<std::int64_t>(args.K, 1));
    const std::int64_t grain = kPointsAtLeast * std::max<std::int64_t>(blocks, 1);
    parallel_for(args.N, grain,
                 [&](std::int64_t begin, std::int64_t end) { points(args, begin, end, lights.data(), out); });
}

}  // namespace mipbake
