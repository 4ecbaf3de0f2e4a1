// BC7: the mode, the partition and the lines of least error, for as many blocks at a time as a packet has lanes.
//
// Mode 6 has one line for all channels, 4 and 5 a channel with indices of its own, 1, 3 and 7 a line for each of two
// subsets. Modes 0 and 2, of three subsets, are read but not written.
#pragma once

#include "blocks/choice.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class P>
class Bc7Fitter : Chooser<P> {
  public:
    // Rows of `weight` are changed.
    Bc7Fitter(const P (&value)[4][kTexels], P (&weight)[4][kTexels]) : Chooser<P>(value, weight) {}

    const BlockChoice<P>& fit() {
        this->template try_one_line<4>(6, line_of(6));
        if (this->any_needs_more()) alone_modes();
        if (this->any_needs_more()) {
            this->divide(kHalves, 64);
            if (any(this->best_.error > this->opaque_error_))
                for (int mode : {1, 3}) this->template try_two_subsets<3>(mode, line_of(mode));
            this->template try_two_subsets<4>(7, line_of(7));
        }
        return this->best_;
    }

  private:
    static LineFormat line_of(int mode) {
        const Mode& made = kModes[mode];
        return LineFormat::bc7(made.colour_bits, made.parity, made.index_bits);
    }

    void alone_modes() {
        for (int alone : {3, 0, 1, 2})
            for (int mode : {5, 4}) {
                const Mode& made = kModes[mode];
                for (int selector = 0; selector <= made.selector_bits; ++selector) {
                    const int lengths[2] = {made.index_bits, made.second_bits};
                    const LineFormat colours = LineFormat::bc7(made.colour_bits, Parity::none, lengths[selector]);
                    const LineFormat alpha = LineFormat::bc7(made.alpha_bits, Parity::none, lengths[1 - selector]);
                    this->template try_alone<4>(mode, alone, colours, alpha, selector != 0);
                }
            }
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
