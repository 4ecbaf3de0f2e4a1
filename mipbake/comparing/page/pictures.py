"""Pictures of a report: how they are coloured and encoded."""

from __future__ import annotations

import base64
import io
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from mipbake.comparing.page.markup import Html, element
from mipbake.quality.metrics import images as metrics

_SMALL = 64 * 64 * 3  # bytes
_STOPS = 24  # places on the ramp that a page has
_SHADES = 64  # shades of error maps: fewer than a byte has, so that maps compress


def picture(pixels: NDArray[np.uint8], alt: str, quality: int = 85, **attributes: str | int | None) -> Html:
    """(H, W, 3) sRGB-encoded pixels, top row first, as an `img` that holds them, described by `alt`.

    They are encoded as WebP; small pictures, which are shown enlarged, without loss.
    """
    from PIL import Image

    image, buffer = Image.fromarray(np.ascontiguousarray(pixels)), io.BytesIO()
    image.save(buffer, "WEBP", lossless=pixels.size < _SMALL, method=2, quality=quality)
    uri = f"data:image/webp;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
    size = {"width": image.width, "height": image.height}
    return element("img", src=uri, alt=alt, decoding="async", **size, **attributes)


# ---- colours


def bytes_of(encoded: NDArray[np.floating]) -> NDArray[np.uint8]:
    """Numbers from 0 to 1 to bytes, rounded."""
    rounded: NDArray[np.uint8] = np.rint(255 * np.clip(encoded, 0, 1)).astype(np.uint8)
    return rounded


def displayed_bytes(linear: NDArray[np.floating]) -> NDArray[np.uint8]:
    """(H, W, 3) linear radiance as bytes of what a display shows of it; what is not a number is black."""
    return bytes_of(metrics.displayed(np.nan_to_num(linear).astype(np.float64)))


@lru_cache(maxsize=1)
def ramp() -> NDArray[np.uint8]:
    """(256, 3) sRGB colours of error maps, black for none over violet and orange to pale yellow.

    Lightness rises linearly in Oklab (Ottosson 2020, "A perceptual color space for image processing"), so equal steps
    of error look equal, in grey too; the hue turns from 295 to 100 degrees the short way over red. Chroma is reduced
    where sRGB cannot hold it.
    """
    share = np.linspace(0, 1, 256)
    lightness, hue = 0.08 + 0.88 * share, np.radians(295 + 165 * share)
    chroma = 0.2 * np.sin(np.pi * np.clip(0.06 + 0.86 * share, 0, 1)) ** 0.8
    colours = np.zeros((256, 3))
    for factor in np.linspace(0, 1, 65):  # the largest that fits comes last
        rgb = _oklab_to_linear(lightness, factor * chroma * np.cos(hue), factor * chroma * np.sin(hue))
        fits = ((rgb >= 0) & (rgb <= 1)).all(-1)
        colours[fits] = rgb[fits]
    return bytes_of(metrics.srgb_encode(colours))


def _oklab_to_linear(
    lightness: NDArray[np.float64], a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    long = (lightness + 0.3963377774 * a + 0.2158037573 * b) ** 3
    middle = (lightness - 0.1055613458 * a - 0.0638541728 * b) ** 3
    short = (lightness - 0.0894841775 * a - 1.2914855480 * b) ** 3
    return np.stack(
        [
            4.0767416621 * long - 3.3077115913 * middle + 0.2309699292 * short,
            -1.2684380046 * long + 2.6097574011 * middle - 0.3413193965 * short,
            -0.0041960863 * long - 0.7034186147 * middle + 1.7076147010 * short,
        ],
        -1,
    )


def heat(values: NDArray[np.floating], top: float) -> NDArray[np.uint8]:
    """(H, W) errors as (H, W, 3) colours of the ramp: 0 is its first, `top` and above its last."""
    steps = np.rint((_SHADES - 1) * np.clip(np.nan_to_num(values, posinf=top) / top, 0, 1)).astype(int)
    coloured: NDArray[np.uint8] = ramp()[np.rint(steps * 255 / (_SHADES - 1)).astype(int)]
    return coloured


def gradient_stops() -> str:
    """Evenly spaced places on the ramp, as a gradient of CSS lists them."""
    shares = [index / (_STOPS - 1) for index in range(_STOPS)]
    return ", ".join(f"#{ramp()[round(255 * share)].tobytes().hex()} {100 * share:.1f}%" for share in shares)
