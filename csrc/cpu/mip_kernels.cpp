// A MIP step and its adjoint, row by row: rows are combined first, in a stretch that stays in the nearest cache, then
// columns. Both read and write every number once, at the memory's speed.
#include "cpu/texture_block.h"
#include "sampling/mip.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {
namespace {

constexpr int stretch = 2048;  // numbers of a row that are combined at once

// ---- Forward ----

// Equal numbers give exactly their value.
template <class S, class T>
void combine_rows(const MipTaps<T>& taps, const S* __restrict row, Index row_stride, int count, T* __restrict out) {
    const S* const second = row + row_stride;
    const S* const third = row + 2 * row_stride;
    if (taps.count == 1)
        for (int i = 0; i < count; ++i) out[i] = value_of(row[i]);
    else if (taps.count == 2)
        for (int i = 0; i < count; ++i) out[i] = T(0.5) * (value_of(row[i]) + value_of(second[i]));
    else
        for (int i = 0; i < count; ++i) {
            const T a = value_of(row[i]);
            out[i] = a + taps.weights[1] * (value_of(second[i]) - a) + taps.weights[2] * (value_of(third[i]) - a);
        }
}

// Columns [begin, end) of the output from `row`, which starts at the first column that they need.
template <int C, class S, class T>
void combine_columns(int width, int begin, int end, int channels, const T* __restrict row, S* __restrict out) {
    const int n = C > 0 ? C : channels;
    if (width == 1) {
        for (int c = 0; c < n; ++c) store_value(row[c], out + c);
    } else if (width % 2 == 0) {
        for (int i = 0; i < end - begin; ++i)
            for (int c = 0; c < n; ++c)
                store_value(T(0.5) * (row[Index(2 * i) * n + c] + row[Index(2 * i + 1) * n + c]),
                            out + Index(i) * n + c);
    } else {
        for (int i = 0; i < end - begin; ++i) {
            const MipTaps<T> taps = mip_taps<T>(begin + i, width);
            const T* const texels = row + Index(2 * i) * n;
            for (int c = 0; c < n; ++c) {
                const T a = texels[c];
                store_value(a + taps.weights[1] * (texels[n + c] - a) + taps.weights[2] * (texels[2 * n + c] - a),
                            out + Index(i) * n + c);
            }
        }
    }
}

// Where three texels do not fit into a stretch: channels in groups, texel by texel.
template <class S, class T>
void combine_wide(const MipTaps<T>& rows, int width, int channels, const S* row, Index row_stride, S* out) {
    T texels[3][stretch / 4];
    for (int i = 0; i < mip_size(width); ++i) {
        const MipTaps<T> taps = mip_taps<T>(i, width);
        for (int c = 0; c < channels; c += stretch / 4) {
            const int count = channels - c < stretch / 4 ? channels - c : stretch / 4;
            for (int k = 0; k < taps.count; ++k)
                combine_rows(rows, row + Index(taps.first + k) * channels + c, row_stride, count, texels[k]);
            for (int d = 0; d < count; ++d) {
                T value = texels[0][d];
                if (taps.count == 2) value = T(0.5) * (value + texels[1][d]);
                if (taps.count == 3)
                    value += taps.weights[1] * (texels[1][d] - value) + taps.weights[2] * (texels[2][d] - value);
                store_value(value, out + Index(i) * channels + c + d);
            }
        }
    }
}

template <int C, class S>
MIPBAKE_KERNEL void mip_with(const MipShape& shape, const S* level, S* out, Index begin, Index end) {
    using T = Compute<S>;
    const int height = mip_size(shape.height), width = mip_size(shape.width), n = shape.channels;
    const Index row_stride = Index(shape.width) * n;
    T buffer[stretch];
    const int columns = (stretch / n - 1) / 2;  // of the output, in a stretch
    for (Index r = begin; r < end; ++r) {
        const Index image = r / height;
        const MipTaps<T> taps = mip_taps<T>(static_cast<int>(r - image * height), shape.height);
        const S* const row = level + (image * shape.height + taps.first) * row_stride;
        S* const target = out + r * width * n;
        if (columns < 1) {
            combine_wide(taps, shape.width, n, row, row_stride, target);
            continue;
        }
        for (int x = 0; x < width; x += columns) {
            const int last = width - x < columns ? width : x + columns;
            const int from = 2 * x, to = last == width ? shape.width : 2 * last + (shape.width & 1);
            combine_rows(taps, row + Index(from) * n, row_stride, (to - from) * n, buffer);
            combine_columns<C>(shape.width, x, last, n, buffer, target + Index(x) * n);
        }
    }
}

// ---- Adjoint ----

template <class T>
void spread_rows(const MipTaps<T>& taps, const T* __restrict row, Index row_stride, int count, T* __restrict out) {
    const T* const second = row + row_stride;
    if (taps.count == 1)
        for (int i = 0; i < count; ++i) out[i] = taps.weights[0] * row[i];
    else
        for (int i = 0; i < count; ++i) out[i] = taps.weights[0] * row[i] + taps.weights[1] * second[i];
}

// Adds to columns [begin, end) of the finer level; `row` starts at column `from` of the coarser one.
template <int C, class T>
void spread_columns(int width, int begin, int end, int from, int channels, const T* __restrict row,
                    T* __restrict target) {
    const int n = C > 0 ? C : channels;
    if (width % 2 == 0) {
        for (int i = 0; i < (end - begin) / 2; ++i) {
            T* __restrict const pair = target + Index(2 * i) * n;
            for (int c = 0; c < n; ++c) {
                const T value = T(0.5) * row[Index(i) * n + c];
                pair[c] += value;
                pair[n + c] += value;
            }
        }
        return;
    }
    for (int x = begin; x < end; ++x) {
        const MipTaps<T> taps = mip_adjoint_taps<T>(x, width);
        const T* const texels = row + Index(taps.first - from) * n;
        T* __restrict const texel = target + Index(x - begin) * n;
        if (taps.count == 1)
            for (int c = 0; c < n; ++c) texel[c] += taps.weights[0] * texels[c];
        else
            for (int c = 0; c < n; ++c) texel[c] += taps.weights[0] * texels[c] + taps.weights[1] * texels[n + c];
    }
}

// Where two texels do not fit into a stretch.
template <class T>
void spread_wide(const MipTaps<T>& rows, int width, int channels, const T* row, Index row_stride, T* target) {
    for (int x = 0; x < width; ++x) {
        const MipTaps<T> taps = mip_adjoint_taps<T>(x, width);
        T* const texel = target + Index(x) * channels;
        for (int k = 0; k < rows.count; ++k)
            for (int l = 0; l < taps.count; ++l) {
                const T* const from = row + k * row_stride + Index(taps.first + l) * channels;
                const T weight = rows.weights[k] * taps.weights[l];
                for (int c = 0; c < channels; ++c) texel[c] += weight * from[c];
            }
    }
}

template <int C, class T>
MIPBAKE_KERNEL void mip_backward_with(const MipShape& shape, const T* grad_out, T* grad, Index begin, Index end) {
    const int height = mip_size(shape.height), width = mip_size(shape.width), n = shape.channels;
    const Index row_stride = Index(width) * n;
    T buffer[stretch];
    const int columns = (stretch / n - 1) & ~1;  // of the finer level, in a stretch; even, so that pairs stay together
    for (Index r = begin; r < end; ++r) {
        const Index image = r / shape.height;
        const MipTaps<T> taps = mip_adjoint_taps<T>(static_cast<int>(r - image * shape.height), shape.height);
        const T* const row = grad_out + (image * height + taps.first) * row_stride;
        T* const target = grad + r * shape.width * n;
        if (columns < 2) {
            spread_wide(taps, shape.width, n, row, row_stride, target);
            continue;
        }
        for (int x = 0; x < shape.width; x += columns) {
            const int last = shape.width - x < columns ? shape.width : x + columns;
            const int from = mip_adjoint_taps<T>(x, shape.width).first;
            const MipTaps<T> end_taps = mip_adjoint_taps<T>(last - 1, shape.width);
            const int to = end_taps.first + end_taps.count;
            spread_rows(taps, row + Index(from) * n, row_stride, (to - from) * n, buffer);
            spread_columns<C>(shape.width, x, last, from, n, buffer, target + Index(x) * n);
        }
    }
}

template <class S, class F>
void with_mip_channels(int channels, F&& f) {
    if (channels == 4) return f(Channels<4>());
    if (sizeof(S) == sizeof(float) && channels == 3) return f(Channels<3>());
    f(Channels<0>());
}

template <class S>
void mip_of(const MipShape& shape, const void* level, void* out, Index begin, Index end) {
    with_mip_channels<S>(shape.channels, [&](auto c) {
        mip_with<c.value>(shape, static_cast<const S*>(level), static_cast<S*>(out), begin, end);
    });
}

}  // namespace

void mip_rows(const MipShape& shape, Storage storage, const void* level, void* out, Index begin, Index end) {
    switch (storage) {
        case Storage::float32:
            return mip_of<float>(shape, level, out, begin, end);
        case Storage::float64:
            return mip_of<double>(shape, level, out, begin, end);
        case Storage::float16:
            return mip_of<Float16>(shape, level, out, begin, end);
        case Storage::bfloat16:
            return mip_of<Bfloat16>(shape, level, out, begin, end);
    }
}

template <class T>
void mip_backward_rows(const MipShape& shape, const T* grad_out, T* grad, Index begin, Index end) {
    with_mip_channels<T>(shape.channels,
                         [&](auto c) { mip_backward_with<c.value>(shape, grad_out, grad, begin, end); });
}

template void mip_backward_rows<float>(const MipShape&, const float*, float*, Index, Index);
template void mip_backward_rows<double>(const MipShape&, const double*, double*, Index, Index);

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
