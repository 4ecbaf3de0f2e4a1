"""A textured plane under directional lights, for renderers that share no code with the library, and a plain twin.

The twin is NumPy in float64: rays through pixels met with the plane, bilinear lookups by index, and the equations of
docs/conventions.md written out again. It has what the library does not: the separable masking of other renderers.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from mipbake.comparing.meshes import shapes
from mipbake.comparing.meshes.camera import Camera
from mipbake.quality.environment import directional

from .input_files import height_field

RESOLUTION = (48, 64)  # height, width
POSITION, TARGET, FIELD_OF_VIEW = (0.6, 2.0, 2.6), (0.1, 0.0, -0.2), 40.0
SIDE, REPEAT = 12.0, (3, 4)  # of the plane; with 64 x 48 texels, texels are square, and lods from 0 to 2.7
LIGHTS = np.array([[-0.5, 1.0, -0.6], [0.9, 0.35, 0.4], [0.1, 0.5, 0.9]])
IRRADIANCE = np.array([[2.0, 1.8, 1.5], [0.4, 0.6, 0.9], [0.5, 0.3, 0.2]])

CAMERA = Camera(POSITION, TARGET, field_of_view=FIELD_OF_VIEW)
PLANE = shapes.plane(SIDE, SIDE, REPEAT)
LIGHTING = directional("three", LIGHTS, IRRADIANCE)
WRAP = ("wrap", "wrap")


@dataclass(frozen=True)
class Surface:
    """Points of a metal, or of a diffuse surface with a coat: (..., 3) except for the (..., 1) alphas along t and b."""

    albedo: Any
    f0: Any
    normal: Any
    alpha_t: Any
    alpha_b: Any
    isotropic: bool


def stored(model: str, white: bool, height: int = 48, width: int = 64) -> np.ndarray:
    """(H, W, C) float32 of a bumpy metal (`gltf`), or of a brushed coat over a diffuse ground (`ggx`)."""
    rng = np.random.default_rng(11)
    colour = np.ones((height, width, 3)) if white else rng.uniform(0.15, 0.95, (height, width, 3))
    normal = height_field(height, width, seed=3, steepness=0.04)  # none turns away from the camera
    if model == "gltf":
        roughness = rng.uniform(0.45, 0.9, (height, width, 1))
        channels = [colour, np.ones_like(roughness), roughness, normal]
    else:
        tensor = [4 * np.log(rng.uniform(0.45, 0.9, (height, width, 1))) for _ in range(2)]
        albedo = rng.uniform(0.0, 0.3, (height, width, 3))
        channels = [albedo, colour, normal[..., :2], *tensor, np.zeros_like(tensor[0])]
    return np.concatenate(channels, -1).astype(np.float32)


def surface(model: str, texels: np.ndarray) -> Surface:
    """What stored channels mean, for the two kinds of `stored` alone."""
    c = texels.astype(np.float64)
    if model == "gltf":
        alpha = c[..., 4:5] ** 2
        return Surface(0 * c[..., :3], c[..., :3], c[..., 5:8], alpha, alpha, isotropic=True)
    z = np.sqrt(1 - np.square(c[..., 6:8]).sum(-1, keepdims=True))
    normal = np.concatenate([c[..., 6:8], z], -1)
    return Surface(c[..., :3], c[..., 3:6], normal, *(np.exp(c[..., i : i + 1] / 2) for i in (8, 9)), isotropic=False)


def bilinear(texture: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """(..., C) of a texture that repeats: texel (i, j) at u = (j + 1/2) / W, v = (i + 1/2) / H."""
    height, width = texture.shape[:2]
    x, y = uv[..., 0] * width - 0.5, uv[..., 1] * height - 0.5
    j, i = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    a, b = (x - j)[..., None], (y - i)[..., None]
    rows, columns = (i % height, (i + 1) % height), (j % width, (j + 1) % width)
    upper = texture[rows[0], columns[0]] * (1 - a) + texture[rows[0], columns[1]] * a
    lower = texture[rows[1], columns[0]] * (1 - a) + texture[rows[1], columns[1]] * a
    return np.asarray(upper * (1 - b) + lower * b)


def radiance(s: Surface, light: np.ndarray, view: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(..., 3): albedo / pi + D V F times the cosine, towards views (..., 3) in the tangent frame, of one light (3,).

    Returns:
        By the library's conventions; and as Mitsuba's rough conductor has it: Smith's masking is the product G1(l)
        G1(v) (Walter et al. 2007), and the reflectance F0 at every angle.
    """
    n = _unit(s.normal)
    t = _unit([1.0, 0, 0] - n[..., :1] * n)
    b = np.cross(n, t)
    light = np.broadcast_to(light, view.shape)
    half = _unit(light + view)
    (lt, lb, ln), (vt, vb, vn), (ht, hb, hn) = (
        tuple((w * axis).sum(-1, keepdims=True) for axis in (t, b, n)) for w in (light, view, half)
    )
    root_l = np.sqrt(ln**2 + (s.alpha_t * lt) ** 2 + (s.alpha_b * lb) ** 2)
    root_v = np.sqrt(vn**2 + (s.alpha_t * vt) ** 2 + (s.alpha_b * vb) ** 2)
    held = np.maximum(vn, 1e-4)  # where the normal turns away from the viewer
    tangential2 = (s.alpha_t * vt) ** 2 + (s.alpha_b * vb) ** 2
    round_held = s.isotropic & (vn < held)
    held_root = np.sqrt(held**2 + np.where(round_held, s.alpha_t**2 * (1 - held**2), tangential2))
    d = 1 / (math.pi * s.alpha_t * s.alpha_b * ((ht / s.alpha_t) ** 2 + (hb / s.alpha_b) ** 2 + hn**2) ** 2)
    schlick = s.f0 + (1 - s.f0) * (1 - (light * half).sum(-1, keepdims=True)) ** 5
    correlated = np.where(hn > 0, 0.5 / (ln * held_root + held * root_l), 0.0)
    separable = 1 / ((ln + root_l) * (vn + root_v))  # G / (4 l_n v_n), with G1(w) = 2 w_n / (w_n + root)
    diffuse = s.albedo / math.pi
    ours, theirs = ((diffuse + d * v * f) * ln for v, f in ((correlated, schlick), (separable, s.f0)))
    return np.where(ln > 0, ours, 0.0), np.where((ln > 0) & (vn > 0), theirs, 0.0)


def twins(model: str, texture: np.ndarray, pixel_filter: str) -> np.ndarray:
    """(2, H, W, 3), rows from the top: both images of `radiance`, by the midpoint rule over the pixel filter."""
    total, weights = np.zeros((2, *RESOLUTION, 3)), 0.0
    places, density = _PLACES[pixel_filter]
    for (x, p), (y, q) in itertools.product(zip(places, density, strict=True), repeat=2):
        uv, view = _seen((x, y))
        at = surface(model, bilinear(texture.astype(np.float64), uv))
        for light, irradiance in zip(LIGHTING.direction, LIGHTING.radiance, strict=True):
            total += np.stack(radiance(at, light @ _TO_FRAME, view)) * irradiance * (p * q)
        weights += p * q
    return total / weights


def decibels(image: np.ndarray, expected: np.ndarray) -> float:
    """SNR of `image`, sum R^2 / sum (P - R)^2."""
    return float(10 * np.log10(np.square(expected).sum() / np.square(image - expected).sum()))


_BOX = (np.arange(12) + 0.5) / 12 - 0.5
_GAUSSIAN = (np.arange(24) + 0.5) / 6 - 2  # of 0.5, cut at 2
_PLACES = {"box": (_BOX, np.ones(12)), "gaussian": (_GAUSSIAN, np.exp(-2 * _GAUSSIAN**2))}
_TO_FRAME = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])  # rows: world x, y, z; columns: t = +x, b = -z, n = +y


def _seen(offset: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Texture coordinates, and directions to the eye in the frame, that far to the right of, and below, the centres."""
    height, width = RESOLUTION
    back = _unit(np.subtract(POSITION, TARGET))
    right = _unit(np.cross([0.0, 1.0, 0.0], back))
    slope = math.tan(math.radians(FIELD_OF_VIEW) / 2)
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    x = (2 * (column + offset[0]) - width) / height * slope
    y = (1 - 2 * (row + offset[1]) / height) * slope
    ray = x[..., None] * right + y[..., None] * np.cross(back, right) - back
    place = np.array(POSITION) - POSITION[1] / ray[..., 1:2] * ray
    assert (np.abs(place[..., [0, 2]]) < SIDE / 2).all()
    return (place[..., [0, 2]] / SIDE + 0.5) * REPEAT, -_unit(ray) @ _TO_FRAME


def _unit(v: Any) -> np.ndarray:
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))
