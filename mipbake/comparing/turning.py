"""One column of pixels of a plane that turns slowly, for many frames at once: no other pixel is rendered."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from mipbake import sampling, shading
from mipbake.comparing.meshes.camera import Camera
from mipbake.material.aim import DEFAULT_SAMPLER
from mipbake.material.filtered_source import FilteredSource
from mipbake.material.pixel_filter import Wrap, filter_named
from mipbake.quality.environment import Lighting
from mipbake.quality.reference.sequences import SEQUENCE
from mipbake.quality.samplers import RenderSampler, level_of_detail, look_up, over_frames

Array = NDArray[np.float64]

DEGREES = 0.1
"""The turn from frame to frame."""

# Rows see the plane at these angles below its horizon. Footprints grow by 1 / sin^2, twofold from bottom to top.
_TOP = 35.0
_BOTTOM = math.degrees(math.asin(math.sqrt(2) * math.sin(math.radians(_TOP))))


class Turning:
    """A plane, y = 0, that turns around +y through the world's origin, which is the middle of the picture.

    The picture is twice as wide as high; the column lies at seven eighths of its width, where the plane moves by about
    a quarter of a pixel a frame along the column when `height` is 192. In frame 0 u grows along +x, v along +z, and
    texels are square and so large that the level of detail is 0 at the bottom of the column and about 1 at its top.

    Args:
        lighting: stays where it is.
        size: (height, width) of the texture.
        frames: how many, DEGREES of a turn apart.
        height: of the column, in pixels.
    """

    def __init__(self, lighting: Lighting, size: tuple[int, int], frames: int, height: int) -> None:
        middle = math.radians(_TOP + _BOTTOM) / 2
        self.resolution = height, 2 * height
        self.column = 2 * height * 7 // 8
        self.camera = Camera((0.0, math.sin(middle), math.cos(middle)), field_of_view=_BOTTOM - _TOP)
        self.angles = np.radians(DEGREES * np.arange(frames))
        """(frames,) radians, from +z towards +x."""
        self._size, self._lighting = size, lighting
        self._tangent_frames = np.repeat(self._frames().astype(np.float32), height, axis=0)
        self.texel = 1.0
        bottom = self._see((0.0, 0.0))[1].reshape(frames, height, 4)[0, -1:]
        self.texel = float(2 ** level_of_detail(bottom, size)[0])
        """Side of a texel in the world."""

    def candidate(
        self,
        levels: Sequence[NDArray[np.float32]],
        model: str,
        wrap: Wrap,
        sampler: RenderSampler = DEFAULT_SAMPLER,
        rng: np.random.Generator | None = None,
    ) -> NDArray[np.float32]:
        """(height, frames, 3) linear radiance: what an unchanged engine shows, as
        `mipbake.comparing.meshes.mesh_render.candidate` has it.
        """

        def frame(offset: tuple[float, float]) -> NDArray[np.float32]:
            uv, uv_da, view = self._see(offset)
            return np.asarray(self._lit(look_up(levels, uv, uv_da, wrap, sampler, rng), view, model))

        return np.asarray(over_frames(sampler, frame).swapaxes(0, 1))

    def reference(
        self,
        source: FilteredSource,
        passes: int,
        rng: np.random.Generator,
        progress: Callable[[float], None] = lambda _share: None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Two independent halves, (height, frames, 3) each, of `passes` samples a pixel together.

        As `mipbake.comparing.meshes.mesh_render.reference`: the pixel filter's mean of level 0, interpolated bilinearly
        and shaded at each sample; one sub-pixel offset a pass, which all frames share.
        """
        kernel = filter_named(source.pixel_filter)
        level = np.asarray(source.stored, np.float32)[None]
        halves = []
        for half, shift in enumerate(rng.random((2, 2))):
            total, weights = np.zeros((len(self.angles), self.resolution[0], 3)), 0.0
            for index in range(passes // 2):
                offset, sign = kernel.offsets((shift + index * SEQUENCE) % 1.0)
                uv, _, view = self._see((float(offset[0]), float(offset[1])))
                texels = sampling.texture(level, uv[None, None], filter_mode="linear", boundary_mode=source.wrap)
                weight = float(sign.prod())
                total += weight * self._lit(texels[0, 0], view, source.model)
                weights += weight
                progress((half + 2 * (index + 1) / passes) / 2)
            # As mesh_render divides: a constant stays constant under signed filters too.
            halves.append(np.asarray(total / weights, np.float32).swapaxes(0, 1))
        return halves[0], halves[1]

    def _see(self, offset: tuple[float, float]) -> tuple[Array, Array, NDArray[np.float32]]:
        """uv (P, 2), its derivatives (P, 4) per pixel, and views (P, 3) in the world; P frame by frame.

        The ray through the point (X, Y) of the picture, in pixels, has the direction d = d_0 + X d_X + Y d_Y, and
        meets the plane y = 0 at o - d o_y / d_y.
        """
        height, width = self.resolution
        right, up, back = self.camera.view_matrix()[:3, :3]
        pixel = 2 * math.tan(math.radians(self.camera.field_of_view) / 2) / height
        x = (self.column + 0.5 - width / 2 + offset[0]) * pixel
        y = (height / 2 - np.arange(height) - 0.5 + offset[1]) * pixel
        origin = np.asarray(self.camera.position)
        d = x * right + y[:, None] * up - back
        hit = origin - d * (origin[1] / d[:, 1:2])
        dx, dy = (
            -origin[1] * (along * d[:, 1:2] - d * along[1]) / d[:, 1:2] ** 2 for along in (pixel * right, pixel * up)
        )
        view = -d / np.linalg.norm(d, axis=-1, keepdims=True)
        frame = self._frames()
        on_plane = frame[:, None, :2] * [[[[1.0], [-1.0]]]]
        scale = 1 / (self.texel * np.array([self._size[1], self._size[0]]))
        uv, du, dv = ((on_plane @ p[None, :, :, None])[..., 0] * scale for p in (hit, dx, dy))
        uv_da = np.stack([du[..., 0], dv[..., 0], du[..., 1], dv[..., 1]], -1)
        views = np.tile(view.astype(np.float32), (len(frame), 1))
        return uv.reshape(-1, 2), uv_da.reshape(-1, 4), views

    def _frames(self) -> Array:
        """(frames, 3, 3): rows t, b and n in the world; u grows along t and v along -b."""
        c, s, zero = np.cos(self.angles), np.sin(self.angles), np.zeros(len(self.angles))
        t, b, n = (c, zero, -s), (-s, zero, -c), (zero, zero + 1, zero)
        return np.stack([np.stack(each, -1) for each in (t, b, n)], 1)

    def _lit(self, texels: NDArray[np.float32], view: NDArray[np.float32], model: str) -> NDArray[np.float32]:
        """(frames, height, 3) radiance of all lights together."""
        lit = shading.shade_lit(
            model, texels, self._tangent_frames, view, self._lighting.direction, self._lighting.radiance
        )
        return lit.reshape(len(self.angles), self.resolution[0], 3)
