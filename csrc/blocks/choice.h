// What formats with several modes have in common: the best mode of each block so far, its lines and its indices.
#pragma once

#include "blocks/partition.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class P>
struct BlockChoice {
    P error, mode, partition;
    P alone;          // the channel with indices of its own, or 4
    P selector;       // BC7's: whether that channel has the shorter indices
    P code[2][2][4];  // of subset, endpoint and channel
    P index[kTexels], second[kTexels];
};

template <class P>
class Chooser {
  protected:
    // Blocks that are opaque stay so: their alpha counts much.
    Chooser(const P (&value)[4][kTexels], P (&weight)[4][kTexels]) : value_(value), weight_(weight) {
        P transparent(0.0f), total(0.0f);
        for (int i = 0; i < kTexels; ++i) transparent = transparent + select(value[3][i] < P(254.9f), P(1.0f), P(0.0f));
        const P factor = select(transparent > P(0.5f), P(1.0f), P(1e4f));
        opaque_error_ = P(0.0f);
        for (int i = 0; i < kTexels; ++i) {
            for (int c = 0; c < 4; ++c) total = total + weight[c][i];
            weight[3][i] = weight[3][i] * factor;
            opaque_error_ = opaque_error_ + square(P(255.0f) - value[3][i]) * weight[3][i];
        }
        little_ = total * P(kLittle);
        best_.error = P(1e30f);
        best_.alone = P(4.0f);
    }

    auto better_than(const P& error, int mode) {
        // Blocks that are good already keep what they have, whatever the others of the packet need.
        const auto better = both(best_.error > error, best_.error > little_);
        best_.error = select(better, error, best_.error);
        best_.mode = select(better, P(static_cast<float>(mode)), best_.mode);
        return better;
    }

    bool any_needs_more() const { return any(best_.error > little_); }

    // One line for C channels, in one subset.
    template <int C>
    void try_one_line(int mode, const LineFormat& format) {
        const Line<P, C> line = LineFitter<P, C>(first<C>(value_), first<C>(weight_), format).fit();
        const auto better = better_than(C == 3 ? line.error + opaque_error_ : line.error, mode);
        best_.alone = select(better, P(4.0f), best_.alone);
        keep(better, line, 0);
        keep_index(better, line.index, best_.index);
    }

    // A line for all of C channels but one, which has indices of its own. BC7's modes keep the channels in other
    // places: alpha takes the place of the one that is alone.
    template <int C>
    void try_alone(int mode, int alone, const LineFormat& format, const LineFormat& alone_format,
                   bool selector = false) {
        Rows<P, C - 1> value, weight;
        for (int c = 0, to = 0; c < C; ++c)
            if (c != alone) {
                value.row[to] = value_[c];
                weight.row[to++] = weight_[c];
            }
        const Rows<P, 1> one{{value_[alone]}}, one_weight{{weight_[alone]}};
        const Line<P, C - 1> line = LineFitter<P, C - 1>(value, weight, format).fit();
        const Line<P, 1> other = LineFitter<P, 1>(one, one_weight, alone_format).fit();
        const P error = line.error + other.error;
        const auto better = better_than(C == 3 ? error + opaque_error_ : error, mode);
        best_.alone = select(better, P(static_cast<float>(alone)), best_.alone);
        best_.selector = select(better, P(selector ? 1.0f : 0.0f), best_.selector);
        for (int end = 0; end < 2; ++end)
            for (int c = 0, from = 0; c < C; ++c) {
                P& code = best_.code[0][end][c];
                code = select(better, c == alone ? other.code[end][0] : line.code[end][from++], code);
            }
        keep_index(better, line.index, best_.index);
        keep_index(better, other.index, best_.second);
    }

    // Sets what try_two_subsets tries.
    void divide(const std::uint16_t* partitions, int count) {
        partition_ = best_partition(value_, weight_, partitions, count, inside_);
        for (int c = 0; c < 4; ++c)
            for (int i = 0; i < kTexels; ++i) {
                part_[1][c][i] = weight_[c][i] * inside_[i];
                part_[0][c][i] = weight_[c][i] - part_[1][c][i];
            }
    }

    // A line for each of two subsets.
    template <int C>
    void try_two_subsets(int mode, const LineFormat& format) {
        const Line<P, C> lines[2] = {LineFitter<P, C>(first<C>(value_), first<C>(part_[0]), format).fit(),
                                     LineFitter<P, C>(first<C>(value_), first<C>(part_[1]), format).fit()};
        P index[kTexels];
        for (int i = 0; i < kTexels; ++i) index[i] = select(inside_[i] > P(0.5f), lines[1].index[i], lines[0].index[i]);
        const P error = lines[0].error + lines[1].error;
        const auto better = better_than(C == 3 ? error + opaque_error_ : error, mode);
        best_.alone = select(better, P(4.0f), best_.alone);
        best_.partition = select(better, partition_, best_.partition);
        for (int s = 0; s < 2; ++s) keep(better, lines[s], s);
        keep_index(better, index, best_.index);
    }

    const P (&value_)[4][kTexels];
    const P (&weight_)[4][kTexels];
    P opaque_error_;  // of formats without alpha
    BlockChoice<P> best_{};

  private:
    static constexpr float kLittle = 0.02f;  // mean squared error, of 255, that is not worth another mode

    template <int C, class M>
    void keep(const M& better, const Line<P, C>& line, int subset) {
        for (int end = 0; end < 2; ++end)
            for (int c = 0; c < C; ++c) {
                P& code = best_.code[subset][end][c];
                code = select(better, line.code[end][c], code);
            }
    }
    template <class M>
    static void keep_index(const M& better, const P (&from)[kTexels], P (&to)[kTexels]) {
        for (int i = 0; i < kTexels; ++i) to[i] = select(better, from[i], to[i]);
    }
    template <int C>
    static Rows<P, C> first(const P (&rows)[4][kTexels]) {
        Rows<P, C> out;
        for (int c = 0; c < C; ++c) out.row[c] = rows[c];
        return out;
    }

    P little_, partition_, inside_[kTexels], part_[2][4][kTexels];
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
