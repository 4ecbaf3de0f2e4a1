// Lines through the texels of blocks: two endpoints of few bits, and an index for each texel between them. A lane of a
// packet is a block.
#pragma once

#include <cstring>

#include "blocks/astc_levels.h"
#include "blocks/layout.h"
#include "core/packet.h"
#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// One row of 16 packets for each channel: texels from 0 to 255, or what a squared error of each counts.
template <class P, int C>
struct Rows {
    const P* row[C];
    const P* operator[](int channel) const { return row[channel]; }
};

template <class P, int C>
struct Line {
    P code[2][C];  // endpoints as they are stored, parity bits included
    P index[kTexels];
    P error;
};

// How decoders make numbers of codes and mix them: exactly, or rounded as BC7's and ASTC's specifications say.
enum class Decoder { exact, bc7, astc };

// What endpoints and indices may be.
struct LineFormat {
    int bits[4];  // of the channels of an endpoint, without their parity bit; not of ASTC, which has `levels`
    Parity parity;
    int index_bits;
    Decoder decoder;
    const AstcLevels* levels;

    static LineFormat bc1() { return {{5, 6, 5, 0}, Parity::none, 2, Decoder::exact, nullptr}; }
    static LineFormat bc7(int bits, Parity parity, int index_bits) {
        return {{bits, bits, bits, bits}, parity, index_bits, Decoder::bc7, nullptr};
    }
    static LineFormat astc(const AstcLevels& levels, int index_bits) {
        return {{}, Parity::none, index_bits, Decoder::astc, &levels};
    }
};

template <class P>
MIPBAKE_INLINE P nearest(const P& x) {
    const P magic(12582912.0f);  // 1.5 * 2^23: numbers that large have no fraction
    return (x + magic) - magic;
}
template <class P>
MIPBAKE_INLINE P floor_of_positive(const P& x) {
    const P near = nearest(x);
    return select(near > x, near - P(1.0f), near);
}
template <class P>
MIPBAKE_INLINE P held(const P& x, float low, float high) {
    return smaller(larger(x, P(low)), P(high));
}

// What a code of so many bits stands for: its bits, repeated to eight.
template <class P>
MIPBAKE_INLINE P expanded(const P& code, int bits) {
    const float up = static_cast<float>(1 << (8 - bits)), down = 1.0f / static_cast<float>(1 << (2 * bits - 8));
    return code * P(up) + (bits == 8 ? P(0.0f) : floor_of_positive(code * P(down)));
}

// The code nearest to a value; with a parity bit of 0 or 1, or -1 for none.
template <class P>
MIPBAKE_INLINE P code_of(const P& value, int bits, int parity) {
    const float last = static_cast<float>((1 << bits) - 1);
    const P at = held(value, 0.0f, 255.0f) * P(last / 255.0f);
    if (parity < 0) return nearest(at);
    const P half = held(nearest((at - P(static_cast<float>(parity))) * P(0.5f)), 0.0f, (last - 1.0f) / 2.0f);
    return half + half + P(static_cast<float>(parity));
}

template <class P, int C>
class LineFitter {
  public:
    // `weight`: 0 where a texel is not of the subset.
    LineFitter(const Rows<P, C>& value, const Rows<P, C>& weight, const LineFormat& format)
        : value_(value), weight_(weight), format_(format) {}

    Line<P, C> fit() {
        best_.error = P(1e30f);
        P ends[2][C];
        first_guess(ends);
        for (int round = 0; round < kRounds; ++round) {
            const P before = best_.error;
            try_parities(ends);
            if (!any(before > best_.error) || !refined(ends)) break;
        }
        return best_;
    }

  private:
    static constexpr int kRounds = 3, kPowers = 4;

    // Through the weighted mean, along the axis of the greatest spread, as far as texels lie.
    void first_guess(P (&ends)[2][C]) {
        P mean[C], scale[C], all(1e-20f), low(1e30f), high(-1e30f);
        for (int c = 0; c < C; ++c) {
            P total(1e-20f), sum(0.0f);
            for (int i = 0; i < kTexels; ++i) {
                total = total + weight_[c][i];
                sum = sum + weight_[c][i] * value_[c][i];
            }
            mean[c] = sum / total;
            scale[c] = total;
            all = all + total;
        }
        for (int c = 0; c < C; ++c) scale[c] = square_root(scale[c] / all);
        P axis[C];
        axis_of(mean, scale, axis);
        for (int i = 0; i < kTexels; ++i) {
            P along(0.0f), count(0.0f);
            for (int c = 0; c < C; ++c) {
                along = along + (value_[c][i] - mean[c]) * scale[c] * axis[c];
                count = count + weight_[c][i];
            }
            const auto counts = count > P(0.0f);
            low = select(counts, smaller(low, along), low);
            high = select(counts, larger(high, along), high);
        }
        const auto none = low > high;  // no texel is of the subset
        for (int c = 0; c < C; ++c) {
            const P step = axis[c] / larger(scale[c], P(1e-6f));
            ends[0][c] = select(none, mean[c], mean[c] + step * low);
            ends[1][c] = select(none, mean[c], mean[c] + step * high);
        }
    }

    // Of the weighted covariance, by powers.
    void axis_of(const P (&mean)[C], const P (&scale)[C], P (&axis)[C]) {
        if constexpr (C == 1) {
            axis[0] = P(1.0f);
        } else {
            P moments[C][C];
            for (auto& row : moments)
                for (P& each : row) each = P(0.0f);
            for (int i = 0; i < kTexels; ++i) {
                P counts(0.0f), off[C];
                for (int c = 0; c < C; ++c) counts = counts + weight_[c][i];
                for (int c = 0; c < C; ++c) off[c] = (value_[c][i] - mean[c]) * scale[c];
                for (int a = 0; a < C; ++a)
                    for (int b = 0; b <= a; ++b) moments[a][b] = moments[a][b] + counts * off[a] * off[b];
            }
            for (int a = 0; a < C; ++a)
                for (int b = 0; b < a; ++b) moments[b][a] = moments[a][b];
            P most(-1.0f);
            for (int a = 0; a < C; ++a) {  // the row of the greatest variance is not orthogonal to the axis
                const auto more = moments[a][a] > most;
                most = select(more, moments[a][a], most);
                for (int c = 0; c < C; ++c) axis[c] = a == 0 ? moments[0][c] : select(more, moments[a][c], axis[c]);
            }
            for (int round = 0; round < kPowers; ++round) {
                P next[C], length(1e-30f);
                for (int a = 0; a < C; ++a) {
                    next[a] = P(0.0f);
                    for (int c = 0; c < C; ++c) next[a] = next[a] + moments[a][c] * axis[c];
                    length = larger(length, larger(next[a], -next[a]));
                }
                for (int a = 0; a < C; ++a) axis[a] = next[a] / length;
            }
            P square_sum(1e-30f);
            for (int c = 0; c < C; ++c) square_sum = square_sum + axis[c] * axis[c];
            const P length = square_root(square_sum);
            for (int c = 0; c < C; ++c) axis[c] = axis[c] / length;
        }
    }

    void try_parities(const P (&ends)[2][C]) {
        const int count = format_.parity == Parity::none ? 1 : format_.parity == Parity::shared ? 2 : 4;
        for (int choice = 0; choice < count; ++choice) {
            P code[2][C], from[2][C];
            for (int end = 0; end < 2; ++end) {
                const int bit = format_.parity == Parity::each ? choice >> end & 1 : choice & 1;
                for (int c = 0; c < C; ++c) quantise(ends[end][c], c, bit, code[end][c], from[end][c]);
            }
            try_codes(code, from);
        }
    }

    void quantise(const P& value, int channel, int parity, P& code, P& from) const {
        if (format_.decoder == Decoder::astc) {
            constexpr int kLanes = Lanes<float>::count;
            code = nearest(held(value, 0.0f, 255.0f) * P(static_cast<float>(format_.levels->count - 1) / 255.0f));
            float lanes[kLanes];
            store_lanes(lanes, code);
            for (float& lane : lanes) lane = static_cast<float>(format_.levels->value[static_cast<int>(lane)]);
            std::memcpy(&from, lanes, sizeof from);
        } else {
            const bool has = format_.parity != Parity::none;
            const int bits = format_.bits[channel] + (has ? 1 : 0);
            code = code_of(value, bits, has ? parity : -1);
            from = expanded(code, bits);
        }
    }

    void try_codes(const P (&code)[2][C], const P (&from)[2][C]) {
        const float last = static_cast<float>((1 << format_.index_bits) - 1);
        P index[kTexels], error(0.0f);
        for (int i = 0; i < kTexels; ++i) {
            P along(0.0f), length(1e-20f);
            for (int c = 0; c < C; ++c) {
                const P step = (from[1][c] - from[0][c]) * weight_[c][i];
                along = along + (value_[c][i] - from[0][c]) * step;
                length = length + (from[1][c] - from[0][c]) * step;
            }
            index[i] = held(nearest(along / length * P(last)), 0.0f, last);
            const P share = share_at(index[i], last);
            for (int c = 0; c < C; ++c) {
                const P off = mixed(from[0][c], from[1][c], share) - value_[c][i];
                error = error + off * off * weight_[c][i];
            }
        }
        const auto better = best_.error > error;
        best_.error = select(better, error, best_.error);
        for (int i = 0; i < kTexels; ++i) best_.index[i] = select(better, index[i], best_.index[i]);
        for (int end = 0; end < 2; ++end)
            for (int c = 0; c < C; ++c) best_.code[end][c] = select(better, code[end][c], best_.code[end][c]);
    }

    // How far an index is from the first endpoint to the second.
    MIPBAKE_INLINE P share_at(const P& index, float last) const {
        switch (format_.decoder) {
            case Decoder::exact:
                return index * P(1.0f / last);
            case Decoder::bc7:
                return nearest(index * P(64.0f / last)) * P(1.0f / 64.0f);
            default:
                return astc_share(index) * P(1.0f / 64.0f);
        }
    }
    // The bits of an index, repeated to six; numbers above 32 are one more.
    MIPBAKE_INLINE P astc_share(const P& index) const {
        const int bits = format_.index_bits;
        P whole(0.0f);
        for (int shift = 6 - bits; shift > -bits; shift -= bits)
            whole = whole + floor_of_positive(index * P(shift >= 0 ? static_cast<float>(1 << shift)
                                                                   : 1.0f / static_cast<float>(1 << -shift)));
        return select(whole > P(32.0f), whole + P(1.0f), whole);
    }
    MIPBAKE_INLINE P mixed(const P& low, const P& high, const P& share) const {
        const P sum = low + (high - low) * share;
        switch (format_.decoder) {
            case Decoder::exact:
                return sum;
            case Decoder::bc7:
                return floor_of_positive(sum + P(0.5f));
            default:  // of 16 bits, of which the upper eight are left
                return floor_of_positive(sum * P(257.0f / 256.0f) + P(0.5f / 256.0f));
        }
    }

    // The endpoints of least squares for the best indices; false where no block has any.
    bool refined(P (&ends)[2][C]) {
        const float last = static_cast<float>((1 << format_.index_bits) - 1);
        bool found = false;
        for (int c = 0; c < C; ++c) {
            P aa(0.0f), ab(0.0f), bb(0.0f), av(0.0f), bv(0.0f);
            for (int i = 0; i < kTexels; ++i) {
                const P b = share_at(best_.index[i], last), a = P(1.0f) - b, w = weight_[c][i];
                aa = aa + w * a * a;
                ab = ab + w * a * b;
                bb = bb + w * b * b;
                av = av + w * a * value_[c][i];
                bv = bv + w * b * value_[c][i];
            }
            const P determinant = aa * bb - ab * ab;
            const auto good = determinant > P(1e-4f) * aa * bb;
            const P scale = P(1.0f) / larger(determinant, P(1e-30f));
            ends[0][c] = select(good, (av * bb - bv * ab) * scale, ends[0][c]);
            ends[1][c] = select(good, (bv * aa - av * ab) * scale, ends[1][c]);
            found = found || any(good);
        }
        return found;
    }

    const Rows<P, C> value_, weight_;
    const LineFormat format_;
    Line<P, C> best_{};
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
