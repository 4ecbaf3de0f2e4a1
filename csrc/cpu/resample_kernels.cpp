// Separable resampling, row by row: the rows that an output row needs are combined in registers, a stretch at a time,
// into a scratch row that stays in the nearest caches. Columns are then combined texel by texel, with the channels of a
// texel in the lanes of a register.
#include <cstring>

#include "core/packet.h"
#include "cpu/resample.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

using Index = std::int64_t;

template <class P, class T>
MIPBAKE_INLINE P load(const T* data) {
    P p;
    std::memcpy(&p, data, sizeof p);
    return p;
}

template <class P, class T>
MIPBAKE_INLINE void store(T* data, const P& p) {
    std::memcpy(data, &p, sizeof p);
}

// `count` packets of the sum of rows, from number `at` on. The sum begins with 0, as the twin's does: it has no -0.
template <class P, int count, class T>
MIPBAKE_INLINE void combine_stretch(const ResampleArgs<T>& args, const Index* index, const T* weights, Index at,
                                    T* out) {
    constexpr int lanes = static_cast<int>(sizeof(P) / sizeof(T));
    P sums[count];
    for (P& sum : sums) sum = P(T(0));
    for (Index t = 0; t < args.rows.taps; ++t) {
        const T* const row = args.image + index[t] * args.row_stride + at;
        const P weight(weights[t]);
        for (int i = 0; i < count; ++i) sums[i] = sums[i] + load<P>(row + i * lanes) * weight;
    }
    for (int i = 0; i < count; ++i) store(out + at + i * lanes, sums[i]);
}

template <class T>
void combine_rows(const ResampleArgs<T>& args, const Index* index, const T* weights, T* out) {
    using P = typename Lanes<T>::Real;
    constexpr int lanes = Lanes<T>::count, at_once = 8;
    const Index numbers = args.width * args.channels;
    Index at = 0;
    for (; at + at_once * lanes <= numbers; at += at_once * lanes)
        combine_stretch<P, at_once>(args, index, weights, at, out);
    for (; at + lanes <= numbers; at += lanes) combine_stretch<P, 1>(args, index, weights, at, out);
    for (; at < numbers; ++at) combine_stretch<T, 1>(args, index, weights, at, out);
}

// Lanes beyond a texel's channels hold what lies behind the texel. What is stored of them is overwritten by the texels
// that follow, and is not stored where none does.
template <class T>
void combine_columns(const ResampleArgs<T>& args, const T* row, T* out) {
    using P = typename Lanes<T>::Real;
    constexpr int lanes = Lanes<T>::count;
    static_assert(lanes <= resample_margin, "texels are read a register at a time");
    const ResampleAxis<T>& axis = args.columns;
    const Index channels = args.channels, end = axis.count * channels;
    for (Index i = 0; i < axis.count; ++i) {
        const Index* const index = axis.index + i * axis.taps;
        const T* const weights = axis.weights + i * axis.taps;
        for (Index c = 0; c < channels; c += lanes) {
            P sum(T(0));
            for (Index t = 0; t < axis.taps; ++t) sum = sum + load<P>(row + index[t] * channels + c) * P(weights[t]);
            const Index to = i * channels + c;
            if (to + lanes <= end) {
                store(out + to, sum);
            } else {
                T last[lanes];
                store(last, sum);
                for (Index lane = 0; to + lane < end; ++lane) out[to + lane] = last[lane];
            }
        }
    }
}

}  // namespace

template <class T>
void resample_rows(const ResampleArgs<T>& args, T* scratch, T* out, Index begin, Index end) {
    const ResampleAxis<T>&rows = args.rows, &columns = args.columns;
    const Index numbers = args.width * args.channels, texel = args.channels * Index(sizeof(T));
    for (Index r = begin; r < end; ++r) {
        const Index* const index = rows.index + r * rows.taps;
        T* const target = out + r * columns.count * args.channels;
        const T* const first = args.image + index[0] * args.row_stride;
        if (columns.taps == 1) {
            if (rows.taps > 1) combine_rows(args, index, rows.weights + r * rows.taps, scratch);
            const T* const row = rows.taps > 1 ? scratch : first;
            for (Index i = 0; i < columns.count; ++i)
                std::memcpy(target + i * args.channels, row + columns.index[i] * args.channels,
                            static_cast<std::size_t>(texel));
            continue;
        }
        if (rows.taps > 1)
            combine_rows(args, index, rows.weights + r * rows.taps, scratch);
        else
            std::memcpy(scratch, first, static_cast<std::size_t>(numbers) * sizeof(T));
        combine_columns(args, scratch, target);
    }
}

template void resample_rows<float>(const ResampleArgs<float>&, float*, float*, Index, Index);
template void resample_rows<double>(const ResampleArgs<double>&, double*, double*, Index, Index);

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
