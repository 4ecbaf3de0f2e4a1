"""Cube maps, made in code: a planet with detail at every scale, and surroundings to be reflected. Values 0 to 1."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor


def cube_directions(size: int) -> np.ndarray:
    """(6, size, size, 3): unit directions of a cube map's texel centres, faces +x -x +y -y +z -z as OpenGL has them."""
    t, s = np.meshgrid(*2 * [(np.arange(size) + 0.5) / size * 2 - 1], indexing="ij")
    one = np.ones_like(s)
    faces = [[one, -t, -s], [-one, -t, s], [s, one, t], [s, -one, -t], [s, -t, one], [-s, -t, -one]]
    direction = np.stack([np.stack(face, -1) for face in faces])
    return direction / np.linalg.norm(direction, axis=-1, keepdims=True)


def _lattice_noise(points: np.ndarray, seed: int) -> np.ndarray:
    """Value noise: random numbers from -1 to 1 on the integer lattice (period 64), smoothly joined; points (..., 3)."""
    lattice = np.random.default_rng(seed).uniform(-1, 1, (64, 64, 64)).astype(np.float32)
    cell = np.floor(points).astype(np.int64)
    part = (points - cell).astype(np.float32)
    part = part * part * (3 - 2 * part)
    total = np.zeros(points.shape[:-1], np.float32)
    for corner in np.ndindex(2, 2, 2):
        x, y, z = ((cell[..., axis] + corner[axis]) % 64 for axis in range(3))
        weight = np.where(corner, part, 1 - part).prod(-1)
        total += weight * lattice[x, y, z]
    return total


def fractal_noise(direction: np.ndarray, first: float, last: float, fall: float, seed: int) -> np.ndarray:
    """Sum of noises from `first` to `last` cycles a unit length, an octave apart, each `fall` times the one before."""
    octaves = max(int(np.log2(last / first)), 0) + 1
    noises = [
        fall**octave * _lattice_noise(direction * first * 2**octave + 17.3 * octave, seed + octave)
        for octave in range(octaves)
    ]
    return np.sum(noises, axis=0)


def _mix(first: np.ndarray, second: np.ndarray, amount: np.ndarray) -> np.ndarray:
    return first + (second - first) * amount[..., None]


def planet(size: int) -> Tensor:
    """(1, 6, size, size, 3): seas, ragged coasts, mountains, ice and clouds; the finest detail is two texels long."""
    direction = cube_directions(size)
    finest = size / 4  # a face is about 2 units across, a cycle of the noise two lattice cells
    height = fractal_noise(direction, 1.5, finest, 0.62, seed=1)
    relief = fractal_noise(direction, 4, finest, 0.8, seed=20)
    clouds = fractal_noise(direction * [1, 2, 1] + 5, 2, finest, 0.7, seed=40)
    latitude = np.abs(direction[..., 1])
    sea = _mix(np.array([0.02, 0.08, 0.25]), np.array([0.1, 0.35, 0.5]), np.clip(1 + 2 * height, 0, 1))
    green, desert = np.array([0.12, 0.3, 0.08]), np.array([0.75, 0.6, 0.35])
    land = _mix(desert, green, np.clip(0.4 + 1.5 * latitude + 0.6 * relief - 0.5, 0, 1))
    land = land * np.clip(1 + 0.45 * relief, 0.2, 1.6)[..., None]
    color = np.where((height > 0.05)[..., None], land, sea)
    color = _mix(color, np.array([0.92, 0.95, 1.0]), np.clip((latitude + 0.15 * relief - 0.8) * 25, 0, 1))
    color = _mix(color, np.array([1.0, 1.0, 1.0]), np.clip((clouds - 0.35) * 2.5, 0, 0.9))
    return torch.tensor(np.clip(color, 0, 1)[None], dtype=torch.float32)


def surroundings(size: int) -> Tensor:
    """(1, 6, size, size, 3): a sky with clouds and a low sun, hills, a tiled floor, and a row of lit windows."""
    direction = cube_directions(size)
    x, y, z = np.moveaxis(direction, -1, 0)
    clouds = fractal_noise(direction, 2, size / 4, 0.6, seed=60)
    sky = _mix(np.array([0.75, 0.82, 0.9]), np.array([0.15, 0.35, 0.75]), np.clip(y * 1.3, 0, 1))
    sky = _mix(sky, np.array([0.95, 0.95, 0.95]), np.clip((clouds + y - 0.2) * 1.5, 0, 0.9))
    sun = np.array([0.6, 0.45, 0.66])
    sky = _mix(sky, np.array([1.0, 0.9, 0.6]), np.clip((direction @ (sun / np.linalg.norm(sun)) - 0.93) * 18, 0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        tiles = (np.floor(2 * x / -y) + np.floor(2 * z / -y)) % 2
    floor = np.where((tiles > 0.5)[..., None], [0.7, 0.66, 0.6], [0.22, 0.12, 0.1])
    color = np.where((y < -0.25)[..., None], floor, sky)
    turn = np.arctan2(z, x)
    hill = 0.12 * np.sin(3 * turn) + 0.05 * np.sin(11 * turn)
    color = np.where(((y >= -0.25) & (y < hill))[..., None], np.array([0.15, 0.25, 0.12]), color)
    wall = (np.abs(turn + 1.2) < 0.7) & (y >= -0.25) & (y < 0.55)
    lit = (np.mod(turn * 9, 1) < 0.6) & (np.mod(y * 10, 1) < 0.6)
    windows = np.where(lit[..., None], [1.0, 0.85, 0.5], [0.2, 0.18, 0.22])
    color = np.where(wall[..., None], windows, color)
    return torch.tensor(np.clip(color, 0, 1)[None], dtype=torch.float32)


def unfolded(cube_map: Tensor) -> np.ndarray:
    """(2 S, 3 S, 3): the six faces of a cube map (1, 6, S, S, 3) in two rows, +x +y +z above -x -y -z."""
    faces = cube_map[0].detach().cpu().numpy()
    return np.concatenate([np.concatenate(list(faces[start::2]), 1) for start in (0, 1)])
