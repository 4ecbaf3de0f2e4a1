#include "cpu/resample.h"

#include <algorithm>
#include <cstddef>
#include <vector>

#include "core/parallel.h"

namespace mipbake {
namespace {

using Index = std::int64_t;

constexpr Index parts_per_thread = 4;               // so that no thread waits long for the last part
constexpr Index numbers_per_part = Index(1) << 15;  // that a part reads, at least

}  // namespace

template <class T>
void resample_cpu(const ResampleArgs<T>& args, T* out) {
    const Index row = args.width * args.channels, rows = args.rows.count;
    if (rows == 0 || row == 0) return;
    const Index work = rows * row * std::max<Index>(1, args.rows.taps);
    const Index parts =
        std::clamp(work / numbers_per_part, Index(1), std::min(rows, parts_per_thread * Index(num_threads())));
    const Index scratch = row + resample_margin;
    std::vector<T> buffers(static_cast<std::size_t>(parts * scratch));
    parallel_for(parts, 1, [&](Index begin, Index end) {
        for (Index part = begin; part < end; ++part) MIPBAKE_DISPATCH(resample_rows<T>)
        (args, buffers.data() + part * scratch, out, rows * part / parts, rows * (part + 1) / parts);
    });
}

template void resample_cpu<float>(const ResampleArgs<float>&, float*);
template void resample_cpu<double>(const ResampleArgs<double>&, double*);

}  // namespace mipbake
