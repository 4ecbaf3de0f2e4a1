// Smith's masking of a Beckmann surface. Where GGX has G(w) = w_n (1 + 2 Lambda(w)) = sqrt(w_n^2 + s^2), with
// s^2 = w_t^T S w_t, Beckmann has, with a = w_n / s (Walter et al. 2007, "Microfacet models for refraction through
// rough surfaces", section 5.2),
//
//     Lambda = exp(-a^2) / (2 sqrt(pi) a) - erfc(a) / 2
//     G(w) = w_n erf(a) + s E,   E = exp(-a^2) / sqrt(pi),   and   dG / dw_n = erf(a),   dG / ds = E
//
// so that nothing divides by a cosine and nothing cancels. erfc(a) = E X(a) with X = sqrt(pi) erfcx(a), smooth and of
// polynomial decay: a polynomial in 1 / (3 + a), of Chebyshev interpolation, written in powers (docs/fit_beckmann.py).
// s is held to no less than w_n / 4 (in double, w_n / 6): from there on G is w_n to rounding.
#pragma once

#include "core/real.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

template <class T>
struct BeckmannMasking {
    T g;      // G(w)
    T s;      // as held
    T slope;  // dG / ds = E
    T erfc;   // 1 - dG / dw_n

    // Makes the masking from w_n > 0 and s^2.
    static MIPBAKE_INLINE BeckmannMasking of(const T& w_n, const T& s2) {
        using S = typename PlainOf<T>::type;
        constexpr double reach = sizeof(S) == 8 ? 6 : 4;
        constexpr double low = 1 / (3 + reach), high = 1.0 / 3;  // of 1 / (3 + a)
        BeckmannMasking m;
        m.s = square_root(larger(s2, w_n * w_n * S(1 / (reach * reach))));
        const T sum = m.s * S(3) + w_n;
        const T inverse = S(1) / (m.s * sum);
        const T a = w_n * sum * inverse;
        const T x = m.s * m.s * inverse * S(2 / (high - low)) - S((high + low) / (high - low));
        m.slope = exponential(-(a * a)) * S(0.5641895835477563);
        m.erfc = m.slope * scaled_erfc<S>(x);
        m.g = w_n - w_n * m.erfc + m.s * m.slope;
        return m;
    }

  private:
    // X, from the place of 1 / (3 + a) in its range, as -1 to 1.
    template <class S>
    static MIPBAKE_INLINE T scaled_erfc(const T& x) {
        if constexpr (sizeof(S) == 8) {
            constexpr double c[] = {3.5412575941956299e-11, -1.3153730970470188e-9, 1.5972521273371041e-9,
                                    2.502332021662828e-8,   -6.1815437144852563e-8, -4.0275406213900447e-7,
                                    1.4389594185274139e-6,  8.0335437994430403e-6,  -2.685943405593963e-5,
                                    -2.2539258664382442e-4, 1.2429388602552756e-4,  7.0120961889156169e-3,
                                    4.1312817379308202e-2,  1.4467981599607728e-1,  3.5704107749125564e-1,
                                    6.525316589207929e-1,   5.6999530978950905e-1};
            return polynomial<17, S>(c, x);
        } else {
            constexpr double c[] = {2.1784751211269205e-6,  -4.102542513136699e-6, -8.4676151428906824e-5,
                                    -4.5690552634556762e-5, 3.2469286836252158e-3, 2.5011023501480297e-2,
                                    1.0688037988669915e-1,  3.1173820022474969e-1, 6.5476950651200488e-1,
                                    6.7094010264603815e-1};
            return polynomial<10, S>(c, x);
        }
    }
    template <int terms, class S>
    static MIPBAKE_INLINE T polynomial(const double (&c)[terms], const T& x) {
        T sum = x * S(c[0]) + S(c[1]);
        for (int i = 2; i < terms; ++i) sum = sum * x + S(c[i]);
        return sum;
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
