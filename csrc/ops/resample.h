// What the core offers for resampling.
#pragma once

#include <cstdint>

namespace mipbake {

// One axis of a resampling: output i is the sum over its `taps` of weights[i * taps + t] times input index[i * taps +
// t].
template <class T>
struct ResampleAxis {
    const std::int64_t* index;  // (count, taps), in range
    const T* weights;           // (count, taps)
    std::int64_t count, taps;
};

// Rows of `width` texels of `channels` consecutive numbers each.
template <class T>
struct ResampleArgs {
    const T* image;
    std::int64_t row_stride, width, channels;  // the stride is in elements
    ResampleAxis<T> rows, columns;
};

// out: (rows.count, columns.count, channels), C-contiguous. Rows are combined first, then columns, tap after tap, each
// product and sum rounded by itself: the same bits on every instruction set and for any number of threads. An axis of
// one tap is copied, whatever its weights.
template <class T>
void resample_cpu(const ResampleArgs<T>& args, T* out);

}  // namespace mipbake
