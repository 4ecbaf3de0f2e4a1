"""Where the numbers of the `beckmann` model come from: `python docs/fit_beckmann.py [--results FILE]`, minutes.

`python docs/remake.py --measure beckmann` keeps what it writes to the file. It prints

1. the polynomials of csrc/shading/beckmann_masking.h, and how far they are from erfc;
2. for each alpha, the `beckmann` mirror that is nearest to a GGX mirror, what `mipbake.material.ggx_to_beckmann` keeps
   of the reflection beside it, and the curves through these mirrors that it uses;
3. for each g, the narrow GGX lobe that is nearest to a narrow `beckmann` one, the polynomial through them that
   `mipbake.material.beckmann_to_ggx` uses, and what it keeps.

Near is meant in the mean square of the specular radiance of an upright isotropic mirror, relative to the radiance of
the lobe that is to be replaced: in 2. the mean of the decibels of the two pair sets of docs/conventions.md, in 3. over
all half vectors.

The fit of 2. sees as many views as it takes to see some that graze, because the pair sets hold these, too: there both
lobes are brightest and differ most. Weights of networks that convert between the models were trained with its curves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.polynomial import Chebyshev, Polynomial
from numpy.typing import NDArray
from records.scripts import script
from scipy.optimize import least_squares, minimize, minimize_scalar
from scipy.special import erfc, erfcx, gamma

from mipbake import material
from mipbake.quality.metrics.pairs import NEAR_MIRROR_SPREAD
from mipbake.shading import shade

timing = script("benchmarks", "timing")

Array = NDArray[np.float64]

ALPHAS = (0.002, 0.01, 0.03, 0.07, 0.1, 0.14, 0.2, 0.3, 0.4, 0.5, 0.7, 1.0)
VIEWS = 768
"""Heights of views, in equal parts of the pair sets: the lowest has a cosine of 0.026."""
LOG_GAMMAS = np.linspace(-material.MAX_LOG_GAMMA, material.MAX_LOG_GAMMA, 13)


def masking_polynomial(reach: float, degree: int) -> tuple[Array, float]:
    """sqrt(pi) erfcx(a), a from 0 to `reach`, in powers of 1 / (3 + a) in -1..1, highest first; error of erfc."""
    low, high = 1 / (3 + reach), 1 / 3

    def place(a: Array) -> Array:
        return np.asarray((2 / (3 + a) - high - low) / (high - low))

    def scaled(x: Array) -> Array:
        return np.asarray(np.sqrt(np.pi) * erfcx(np.clip(2 / (x * (high - low) + high + low) - 3, 0, reach)))

    found = Chebyshev.interpolate(scaled, 63).truncate(degree + 1)
    a = np.linspace(0, reach, 10_001)
    error = np.abs(np.exp(-a * a) / np.sqrt(np.pi) * found(place(a)) - erfc(a)).max()
    return found.convert(kind=Polynomial).coef[::-1], float(error)


class Mirrors:
    """Light-view pairs dense where a GGX mirror of that alpha is bright, and what the pair sets weigh them by."""

    def __init__(self, alpha: float, views: int, rings: int = 96, spokes: int = 32) -> None:
        nodes, weights = np.polynomial.legendre.leggauss(rings)
        angle, azimuth = (nodes + 1) * np.pi / 4, (np.arange(spokes) + 0.5) * 2 * np.pi / spokes
        radius = np.tan(angle)
        area = weights * np.pi / 4 / np.cos(angle) ** 2 * radius * 2 * np.pi / spokes * alpha**2
        slopes = alpha * radius[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], -1)
        half = np.concatenate([slopes, np.ones((rings, spokes, 1))], -1)
        length = np.linalg.norm(half, axis=-1)
        solid = (area[:, None] / length**3).reshape(-1)
        half = (half / length[..., None]).reshape(-1, 3)
        lights, seen, near, hemisphere = [], [], [], []
        for height in np.sqrt((np.arange(views) + 0.5) / views):  # cosine-distributed, in equal parts
            view = np.array([np.sqrt(1 - height * height), 0, height])
            cosine = half @ view
            light = 2 * cosine[:, None] * half - view
            kept = (cosine > 0) & (light[:, 2] > 0)
            measure = (4 * cosine * solid)[kept]  # of the lights' solid angles
            away = np.arccos(np.clip(light[kept] @ (view * [-1, -1, 1]), -1, 1))
            lights.append(light[kept])
            seen.append(np.broadcast_to(view, light[kept].shape))
            near.append(measure * np.exp(-np.square(away / NEAR_MIRROR_SPREAD) / 2))
            hemisphere.append(measure * light[kept, 2])
        self.light, self.view = np.concatenate(lights), np.concatenate(seen)
        self.weights = np.stack([np.concatenate(near), np.concatenate(hemisphere)])

    def radiance(self, model: str, stored: Any) -> Array:
        """(P,) specular radiance of stored channels from the seventh on, F0 = 1."""
        texel = np.concatenate([[0, 0, 0, 1, 1, 1, 0, 0], stored])
        return np.asarray(shade(model, texel[None], self.light, self.view)[:, 0, 0])

    def decibels(self, found: Array, wanted: Array) -> Array:
        """(2,) signal to error near the mirror direction and over the hemisphere."""
        return np.asarray(10 * np.log10((self.weights @ wanted**2) / (self.weights @ (found - wanted) ** 2)))


def nearest_beckmann(mirrors: Mirrors, alpha: float, start: Array) -> tuple[Array, Array]:
    """ln(alpha_b / alpha) and g, and the decibels they keep."""
    ggx = mirrors.radiance("ggx", [2 * np.log(alpha)] * 2 + [0])

    def kept(shift_and_g: Array) -> Array:
        tensor = [2 * (np.log(alpha) + shift_and_g[0])] * 2
        return mirrors.decibels(mirrors.radiance("beckmann", [*tensor, 0, shift_and_g[1]]), ggx)

    found = minimize(lambda x: -kept(x).mean(), start, method="Nelder-Mead", options={"xatol": 1e-3, "fatol": 1e-3}).x
    return found, kept(found)


def nearest_narrow_ggx(g: float) -> tuple[float, float]:
    """ln(alpha_b / alpha) of the narrow GGX lobe nearest to a narrow `beckmann` one, and the decibels it keeps."""
    nodes, weights = np.polynomial.legendre.leggauss(2000)
    x = np.tan((nodes + 1) * np.pi / 4)  # tan(theta) / alpha_b
    measure = weights * (1 + x * x) * x
    exponent = np.exp(g)
    beckmann = np.exp(-(x ** (2 * exponent))) / gamma(1 + 1 / exponent)

    def error(shift: float) -> float:
        scale = np.exp(2 * shift)
        return float(measure @ (scale / (1 + x * x * scale) ** 2 - beckmann) ** 2 / (measure @ beckmann**2))

    grid = np.linspace(-6, 6, 1201)
    start = grid[np.argmin([error(shift) for shift in grid])]
    found = minimize_scalar(error, bounds=(start - 0.02, start + 0.02), method="bounded")
    return float(found.x), -10 * np.log10(found.fun)


def kept_by_rule(mirrors: Mirrors, alpha: float) -> Array:
    """(2,) decibels that `ggx_to_beckmann` keeps near the mirror direction and over the hemisphere."""
    tensor = np.array([2 * np.log(alpha)] * 2 + [0])
    rule = material.ggx_to_beckmann(np.concatenate([np.zeros(8), tensor]))[8:]
    return mirrors.decibels(mirrors.radiance("beckmann", rule), mirrors.radiance("ggx", tensor))


def curve(values: Array) -> tuple[Array, float]:
    """The numbers a, b, n, h of a + b alpha^n / (alpha^n + h^n) that lies nearest to values at ALPHAS, and how far it
    is from them at most."""
    alpha = np.array(ALPHAS)

    def off(numbers: Array) -> Array:
        low, rise, power, half = numbers
        return np.asarray(low + rise * alpha**power / (alpha**power + half**power) - values)

    found = least_squares(off, [values[0], values[-1] - values[0], 2, 0.3])
    return found.x, float(np.abs(found.fun).max())


def main() -> None:
    """Prints everything, and writes what conversions keep."""
    options = timing.arguments(__doc__, results=None)
    for reach, degree in ((4, 9), (6, 16)):
        powers, error = masking_polynomial(reach, degree)
        print(f"masking, a to {reach}, error of erfc {error:.1e}: " + ", ".join(f"{c:.17g}" for c in powers))

    print("\nalpha: nearest ln(alpha_b / alpha), g (dB near-mirror, hemisphere); what the rule keeps")
    twin = np.array([-0.39, -0.61])
    by_rule, nearest = {}, {}
    for alpha in ALPHAS:
        mirrors = Mirrors(alpha, VIEWS)
        twin, best = nearest_beckmann(mirrors, alpha, twin)
        kept = kept_by_rule(mirrors, alpha)
        nearest[f"{alpha:g}"], by_rule[f"{alpha:g}"] = [*twin.tolist(), *best.tolist()], kept.tolist()
        print(f"{alpha}: {twin[0]:.3f}, {twin[1]:.3f} ({best[0]:.1f}, {best[1]:.1f}); {kept[0]:.1f}, {kept[1]:.1f}")
    curves = {}
    for index, name in enumerate(("shift", "g")):
        numbers, off = curve(np.array([each[index] for each in nearest.values()]))
        curves[name] = [*numbers.tolist(), off]
        print(f"{name}: a, b, n, h = {np.round(numbers, 3).tolist()}, off by {off:.4f} at most", flush=True)

    found = [nearest_narrow_ggx(g) for g in LOG_GAMMAS]
    shifts = np.array([shift for shift, _ in found])
    fitted = Polynomial.fit(LOG_GAMMAS, shifts, 5).convert()
    print("\nnarrow lobes, g: ln(alpha_b / alpha) (dB)")
    print(", ".join(f"{g:.2f}: {shift:.3f} ({dB:.1f})" for g, (shift, dB) in zip(LOG_GAMMAS, found, strict=True)))
    off = float(np.abs(fitted(LOG_GAMMAS) - shifts).max())
    print(f"polynomial: {np.round(fitted.coef, 4).tolist()}, off by {off:.4f} at most")
    narrow = {f"{g:g}": list(each) for g, each in zip(LOG_GAMMAS, found, strict=True)}
    written = {"rule": by_rule, "nearest": nearest, "curves": curves, "narrow": narrow}
    timing.keep(written | {"polynomial": fitted.coef.tolist(), "off": off}, options.results)


if __name__ == "__main__":
    main()
