// BC4: one channel as two endpoints of 8 bits and seven steps between them, or five steps, 0 and 255. Graphics cards
// mix the endpoints to 14 bits and more, so texels are fitted as they are, not as they round to 8 bits.
#pragma once

#include "blocks/line.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class P>
struct Ramp {
    P first, second, code[kTexels], error;
};

template <class P>
class RampFitter {
  public:
    RampFitter(const P* value, const P* weight) : value_(value), weight_(weight) {}

    Ramp<P> fit() {
        best_.error = P(1e30f);
        P low(255.0f), high(0.0f), inner_low(255.0f), inner_high(0.0f), extremes(0.0f);
        for (int i = 0; i < kTexels; ++i) {
            const P& v = value_[i];
            low = smaller(low, v);
            high = larger(high, v);
            const auto inside = both(v >= P(kEdge), P(255.0f - kEdge) >= v);
            inner_low = select(inside, smaller(inner_low, v), inner_low);
            inner_high = select(inside, larger(inner_high, v), inner_high);
            extremes = extremes + select(inside, P(0.0f), P(1.0f));
        }
        const auto always = high >= low;
        around<7>(floor_of_positive(low), P(255.0f) - floor_of_positive(P(255.0f) - high), 2, always);
        P ends[2];
        refined(ends);
        around<7>(nearest(ends[0]), nearest(ends[1]), 1, always);
        const auto some = extremes > P(0.5f);
        if (any(some))
            around<5>(floor_of_positive(smaller(inner_low, inner_high)),
                      P(255.0f) - floor_of_positive(P(255.0f) - larger(inner_low, inner_high)), 1, some);
        return best_;
    }

  private:
    static constexpr float kEdge = 1.0f;  // texels nearer to 0 or 255 are taken for these

    // In the lanes of `allowed` alone.
    template <int last, class M>
    void around(const P& low, const P& high, int reach, const M& allowed) {
        for (int a = -reach; a <= reach; ++a)
            for (int b = -reach; b <= reach; ++b)
                attempt<last>(held(low + P(static_cast<float>(a)), 0.0f, 255.0f),
                              held(high + P(static_cast<float>(b)), 0.0f, 255.0f), allowed);
    }

    template <int last, class M>
    void attempt(const P& one, const P& other, const M& allowed) {
        const P low = smaller(one, other), high = larger(one, other);
        const P span = high - low, scale = P(static_cast<float>(last)) / larger(span, P(1.0f));
        P step[kTexels], error(0.0f);
        for (int i = 0; i < kTexels; ++i) {
            step[i] = held(nearest((value_[i] - low) * scale), 0.0f, static_cast<float>(last));
            P off = low + span * step[i] * P(1.0f / last) - value_[i];
            if constexpr (last == 5) {
                const P& v = value_[i];
                const P bottom = v, top = P(255.0f) - v;
                P size = larger(off, -off);
                step[i] = select(size > bottom, P(6.0f), step[i]);
                size = smaller(size, bottom);
                step[i] = select(size > top, P(7.0f), step[i]);
                off = smaller(size, top);
            }
            error = error + off * off * weight_[i];
        }
        const auto better = both(allowed, best_.error > error);
        best_.error = select(better, error, best_.error);
        // Seven steps are meant where the first endpoint is the greater one.
        best_.first = select(better, last == 7 ? high : low, best_.first);
        best_.second = select(better, last == 7 ? low : high, best_.second);
        for (int i = 0; i < kTexels; ++i) best_.code[i] = select(better, stored<last>(step[i]), best_.code[i]);
    }

    // Codes: 0 and 1 are the endpoints, and the others follow from the first endpoint to the second.
    template <int last>
    static MIPBAKE_INLINE P stored(const P& step) {
        if constexpr (last == 7) {
            const P code = P(8.0f) - step;
            return select(code > P(7.5f), P(1.0f), select(code < P(1.5f), P(0.0f), code));
        } else {
            const auto end = both(step > P(4.5f), step < P(5.5f));
            const P code = select(both(step > P(0.5f), step < P(4.5f)), step + P(1.0f), step);
            return select(end, P(1.0f), code);
        }
    }

    // Least squares for the steps of the best seven.
    void refined(P (&ends)[2]) {
        P aa(0.0f), ab(0.0f), bb(0.0f), av(0.0f), bv(0.0f);
        for (int i = 0; i < kTexels; ++i) {
            const P& code = best_.code[i];
            const P share =
                select(code < P(0.5f), P(1.0f), select(code < P(1.5f), P(0.0f), (P(8.0f) - code) * P(1.0f / 7)));
            const P b = share, a = P(1.0f) - share, &w = weight_[i];
            aa = aa + w * a * a;
            ab = ab + w * a * b;
            bb = bb + w * b * b;
            av = av + w * a * value_[i];
            bv = bv + w * b * value_[i];
        }
        const P determinant = aa * bb - ab * ab;
        const auto good = determinant > P(1e-4f) * aa * bb;
        const P scale = P(1.0f) / larger(determinant, P(1e-30f));
        ends[0] = select(good, (av * bb - bv * ab) * scale, best_.second);
        ends[1] = select(good, (bv * aa - av * ab) * scale, best_.first);
    }

    const P *value_, *weight_;
    Ramp<P> best_{};
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
