// How wide a surface is for masking: the form w_t^T S w_t of a direction w, of two kinds of surfaces.
#pragma once

#include "core/real.h"
#include "shading/sums.h"

namespace mipbake {
inline namespace MIPBAKE_ISA {

// The tangent frame's axes as rows, in the space of lights and viewer.
template <class T>
struct Axes {
    Vec3<T> t, b, n;

    // The vector with components a along the axes.
    MIPBAKE_INLINE Vec3<T> combine(const Vec3<T>& a) const { return t * a.x + b * a.y + n * a.z; }
};

// A width along each of two axes: S = U U^T with U = [u1 u2], vectors of tangent space, so the form is
// (w.u1)^2 + (w.u2)^2. It keeps the tangential components of w, whatever its cosine is held to.
template <class T>
struct TwoWidths {
    Vec3<T> u1, u2;

    template <class A, class B, class F>
    static MIPBAKE_INLINE void zip(A& a, B& b, F f) {
        zip_vector(a.u1, b.u1, f);
        zip_vector(a.u2, b.u2, f);
    }

    // The form of one direction, and what its adjoint needs.
    struct Form {
        T along1, along2;
        MIPBAKE_INLINE T value() const { return along1 * along1 + along2 * along2; }
    };
    template <class S>
    MIPBAKE_INLINE Form form(const Vec3<S>& w, const T&) const {
        return {dot(u1, w), dot(u2, w)};
    }

    // Adds -bar times the gradient of half the form, of light and of view.
    template <class S>
    MIPBAKE_INLINE void add_adjoint(const Form& l, const T& l_bar, const Vec3<S>& light, const Form& v, const T& v_bar,
                                    const Vec3<S>& view, TwoWidths& adjoint) const {
        accumulate(adjoint.u1, -(l_bar * l.along1), light, -(v_bar * v.along1), view);
        accumulate(adjoint.u2, -(l_bar * l.along2), light, -(v_bar * v.along2), view);
    }
    MIPBAKE_INLINE TwoWidths turned(const Axes<T>& axes) const { return {axes.combine(u1), axes.combine(u2)}; }

    // The share of w_n in the derivative of (w_n^2 + form) / 2 by w_n: the rest goes through the axes.
    template <class S>
    MIPBAKE_INLINE S by_cosine() const {
        return S(1);
    }
};

// The same width in all directions: the form is alpha^2 (1 - w_n^2), of the cosine as it is held.
template <class T>
struct OneWidth {
    T alpha2;

    template <class A, class B, class F>
    static MIPBAKE_INLINE void zip(A& a, B& b, F f) {
        f(a.alpha2, b.alpha2);
    }

    struct Form {
        T square, sine2;  // the form, and 1 - w_n^2
        MIPBAKE_INLINE T value() const { return square; }
    };
    template <class S>
    MIPBAKE_INLINE Form form(const Vec3<S>&, const T& w_n) const {
        using Plain = typename PlainOf<T>::type;
        const T sine2 = Plain(1) - w_n * w_n;
        return {alpha2 * sine2, sine2};
    }

    template <class S>
    MIPBAKE_INLINE void add_adjoint(const Form& l, const T& l_bar, const Vec3<S>&, const Form& v, const T& v_bar,
                                    const Vec3<S>&, OneWidth& adjoint) const {
        using Plain = typename PlainOf<T>::type;
        adjoint.alpha2 = adjoint.alpha2 - (l_bar * l.sine2 + v_bar * v.sine2) * Plain(0.5);
    }
    MIPBAKE_INLINE OneWidth turned(const Axes<T>&) const { return *this; }

    template <class S>
    MIPBAKE_INLINE T by_cosine() const {
        return S(1) - alpha2;
    }
};

}  // namespace MIPBAKE_ISA
}  // namespace mipbake
