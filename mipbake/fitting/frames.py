"""Frames as a fit takes them: checked, in float32."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake.base.errors import RendererError
from mipbake.fitting.program import Frame
from mipbake.fitting.renderer import Array

_FARTHEST = 2.0**16
"""How many repeats of the maps a texture coordinate may be away; farther, float32 cannot tell texels apart."""


def named(view: Any) -> str:
    """What messages call a view."""
    return str(getattr(view, "name", None) or f"a view ({type(view).__name__})")


def image_of(frame: Any, who: str, size: tuple[int, int] | None = None) -> Array:
    """The (H, W, 3) image of a frame, float32, of a view `who`. RendererError: it is none, or of another size."""
    if not hasattr(frame, "image"):
        raise RendererError(f"{who}: the renderer returned a {type(frame).__name__}: expected a Frame")
    image = _numbers(frame.image, "the image", who)
    if image.ndim != 3 or image.shape[2] not in (3, 4) or not image.size:
        raise RendererError(f"{who}: the image has shape {image.shape}: expected (height, width, 3)")
    if size is not None and image.shape[:2] != size:
        raise RendererError(
            f"{who}: the image measures {image.shape[1]} x {image.shape[0]} pixels: expected {size[1]} x {size[0]}, as "
            "before"
        )
    _check_finite(image[..., :3], "the image", who)
    return np.ascontiguousarray(image[..., :3])


def cover_of(frame: Any, size: tuple[int, int], who: str) -> NDArray[np.bool_]:
    """(H, W) where a frame shows the maps. RendererError for an `id` of another shape, or of other numbers."""
    if getattr(frame, "id", None) is None:
        return np.ones(size, np.bool_)
    numbers = _numbers(frame.id, "id", who)
    if numbers.shape != size:
        raise RendererError(f"{who}: id has shape {numbers.shape}: expected {size}, as the image has")
    bad = ~(np.isfinite(numbers) & (numbers >= 0) & (numbers == np.floor(numbers)))
    if bad.any():
        row, column = np.argwhere(bad)[0].tolist()
        raise RendererError(
            f"{who}: id is {numbers[row, column]:g} at row {row}, column {column}: expected 0 where a pixel shows "
            "nothing of the maps, and a whole number above 0 elsewhere"
        )
    return np.asarray(numbers > 0)


def looked(frame: Any, who: str) -> Frame:
    """A frame that says where its pixels look the maps up: one of `lod` and `uv_da`, and `id` as (H, W) booleans. Its
    arrays are copies, since a renderer may use its own again.

    Raises:
        RendererError: neither lod nor uv_da, other shapes, values that are not finite, or no pixel that shows the maps.
    """
    image = image_of(frame, who)
    size = image.shape[0], image.shape[1]
    if getattr(frame, "uv", None) is None:
        raise RendererError(
            f"{who}: the frame has no uv: expected where each pixel looks the maps up, (height, width, 2); without it "
            "no error can be credited to a texel"
        )
    shown = cover_of(frame, size, who)
    if not shown.any():
        raise RendererError(f"{who}: no pixel shows the maps (id is 0 everywhere): expected a view of the material")
    uv = _of_pixels(frame.uv, "uv", (*size, 2), shown, who)
    if np.abs(uv).max() > _FARTHEST:
        row, column = np.argwhere(np.abs(uv).max(-1) > _FARTHEST)[0].tolist()
        raise RendererError(
            f"{who}: uv is {uv[row, column].tolist()} at row {row}, column {column}: expected texture coordinates, in "
            "units of the whole texture"
        )
    lod, uv_da = getattr(frame, "lod", None), getattr(frame, "uv_da", None)
    if lod is None and uv_da is None:
        raise RendererError(f"{who}: the frame has neither lod nor uv_da: expected one of the two, to know the level")
    if lod is not None:
        return Frame(image.copy(), uv, lod=_of_pixels(lod, "lod", size, shown, who)[..., 0], id=shown)
    return Frame(image.copy(), uv, uv_da=_of_pixels(uv_da, "uv_da", (*size, 4), shown, who), id=shown)


def _of_pixels(value: Any, what: str, wanted: tuple[int, ...], shown: NDArray[np.bool_], who: str) -> Array:
    array = _numbers(value, what, who)
    if array.shape not in (wanted, (*wanted, 1)):
        raise RendererError(f"{who}: {what} has shape {array.shape}: expected {wanted}")
    array = np.array(array.reshape(*shown.shape, -1), np.float32)
    array[~shown] = 0
    _check_finite(array, what, who)
    return array


def _numbers(value: Any, what: str, who: str) -> Array:
    if hasattr(value, "detach"):  # a tensor, which may be on a graphics card, or have a gradient
        value = value.detach().cpu()
    try:
        array = np.asarray(value)
        if not np.iscomplexobj(array):
            return np.asarray(array, np.float32)
    except (TypeError, ValueError):
        pass
    raise RendererError(f"{who}: {what} is a {type(value).__name__}: expected an array of real numbers")


def _check_finite(array: Array, what: str, who: str) -> None:
    bad = ~np.isfinite(array)
    if bad.any():
        row, column = np.argwhere(bad)[0][:2].tolist()
        raise RendererError(
            f"{who}: {what} holds {array[row, column].tolist()} at row {row}, column {column}, and is not finite in "
            f"{int(bad.any(-1).sum())} pixels: expected finite numbers"
        )
