"""FLIP written down from its paper, to hold the package against: plain, slow, in float64."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import correlate


def flip_of_the_paper(
    candidate: NDArray[np.float64], reference: NDArray[np.float64], ppd: float
) -> NDArray[np.float64]:
    """The map of FLIP, equation by equation of Andersson et al. 2020, in float64; borders repeat."""
    to_xyz = np.array([[10135552, 8788810, 4435075], [2613072, 8788810, 887015], [1425312, 8788810, 70074490]])
    to_xyz = to_xyz / np.array([[24577794], [12288897], [73733382]])  # sRGB's primaries and white, exactly
    white = to_xyz.sum(1)

    def xyz(encoded: NDArray[np.float64]) -> NDArray[np.float64]:
        low = encoded / 12.92
        return np.where(encoded <= 0.04045, low, ((encoded + 0.055) / 1.055) ** 2.4) @ to_xyz.T / white

    def filtered(image: NDArray[np.float64], kernel: NDArray[np.float64]) -> NDArray[np.float64]:
        return correlate(image, kernel, mode="nearest")

    def grid(radius: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        r = int(np.ceil(radius))
        y, x = np.mgrid[-r : r + 1, -r : r + 1].astype(float)
        return x, y

    def hunt(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """L, a, b of XYZ relative to white, chroma scaled with lightness."""
        f = np.where(values > (6 / 29) ** 3, np.cbrt(values), values / (3 * (6 / 29) ** 2) + 4 / 29)
        lightness = 116 * f[..., 1] - 16
        chroma = np.stack([500 * (f[..., 0] - f[..., 1]), 200 * (f[..., 1] - f[..., 2])], -1)
        return np.concatenate([lightness[..., None], 0.01 * lightness[..., None] * chroma], -1)

    def hyab(a: NDArray[np.float64], b: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.abs(a - b)[..., 0] + np.hypot(*np.moveaxis((a - b)[..., 1:], -1, 0))

    def seen(values: NDArray[np.float64]) -> NDArray[np.float64]:
        """After the contrast sensitivity of each opponent channel, clipped to what a display shows."""
        X, Y, Z = np.moveaxis(values, -1, 0)
        opponent = [116 * Y - 16, 500 * (X - Y), 200 * (Y - Z)]
        terms = (((1, 0.0047),), ((1, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))  # a and b of each Gaussian
        x, y = grid(3 * np.sqrt(0.04 / (2 * np.pi**2)) * ppd)
        d2 = (x * x + y * y) / ppd**2
        for channel, gaussians in enumerate(terms):
            g = sum(a * np.sqrt(np.pi / b) * np.exp(-(np.pi**2) * d2 / b) for a, b in gaussians)
            opponent[channel] = filtered(opponent[channel], g / g.sum())
        Y = (opponent[0] + 16) / 116
        back = np.stack([opponent[1] / 500 + Y, Y, Y - opponent[2] / 200], -1)
        linear = np.clip(back * white @ np.linalg.inv(to_xyz).T, 0, 1)
        return hunt(linear @ to_xyz.T / white)

    def features(Y: NDArray[np.float64]) -> list[NDArray[np.float64]]:
        """Strength of edges and of points."""
        sigma = 0.5 * 0.082 * ppd
        x, y = grid(3 * sigma)
        g = np.exp(-(x * x + y * y) / (2 * sigma**2))
        found = []
        for kernel in (-x * g, (x * x / sigma**2 - 1) * g):
            balanced = np.where(kernel > 0, kernel / kernel[kernel > 0].sum(), kernel / -kernel[kernel < 0].sum())
            found.append(np.hypot(filtered(Y, balanced), filtered(Y, balanced.T)))
        return found

    p, r = xyz(candidate), xyz(reference)
    green, blue = xyz(np.array([0.0, 1, 0])), xyz(np.array([0.0, 0, 1]))
    largest = hyab(hunt(green), hunt(blue)) ** 0.7
    error, knee = hyab(seen(p), seen(r)) ** 0.7, 0.4 * largest
    colour = np.where(error < knee, error * 0.95 / knee, 0.95 + 0.05 * (error - knee) / (largest - knee))
    changes = [np.abs(a - b) for a, b in zip(features(p[..., 1]), features(r[..., 1]), strict=True)]
    feature = np.clip(np.maximum(*changes) / np.sqrt(2), 0, 1) ** 0.5
    return colour ** (1 - feature)
