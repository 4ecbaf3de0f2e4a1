"""Cached references: they are bit for bit as without a cache, by content, even beside broken folders and files."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.comparing.meshes import cache, shapes, supersampling
from mipbake.comparing.meshes.camera import orbit
from mipbake.comparing.meshes.mesh_render import Reference
from mipbake.quality.environment import directional

from .mesh_renders import candidate, reference


def scene() -> dict[str, Any]:
    level = np.random.default_rng(0).uniform(0.1, 0.9, (16, 16, 8)).astype(np.float32)
    level[..., 7] = 1
    return {
        "mesh": shapes.sphere(12),
        "camera": orbit(2.6, 30, 20),
        "lighting": directional("one", [[0.3, 1, 0.2]], [[2.0, 1.8, 1.5]]),
        "stored": level,
        "model": "gltf",
        "wrap": ("wrap", "wrap"),
        "resolution": (24, 20),
    }


def render(cache: Path | None, passes: int, **change: Any) -> Reference:
    """Renders exactly that many passes, except for passes beyond them from a cache."""
    arguments = {"pixel_filter": "mitchell", "seed": 0, "progress": lambda _share: None} | scene() | change
    frame = candidate(**{name: arguments[name] for name in scene() if name != "stored"}, levels=[arguments["stored"]])
    return reference(**arguments, candidates=[frame], resolved_share=1e-9, min_passes=passes, max_passes=passes,
                     cache=cache)  # fmt: skip


def same(a: Reference, b: Reference) -> bool:
    arrays = all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("first", "second", "interior"))
    return arrays and (a.passes, a.standard_error, a.candidate_error) == (b.passes, b.standard_error, b.candidate_error)


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.exists() else []


def test_a_cached_render_equals_an_uncached_one_and_a_continued_one_that_at_once(tmp_path, monkeypatch):
    folder = tmp_path / "not" / "there"
    short, at_once = render(None, 32), render(None, 128)
    for passes, expected in ((32, short), (32, short), (128, at_once), (32, at_once)):  # passes that are there count
        assert same(render(folder, passes), expected)
    assert len(files(folder)) == 1

    def spoilt(self: Any, half: int, step: int) -> Any:
        raise AssertionError(f"a pass is rendered again: {step}")

    monkeypatch.setattr(supersampling.Supersampling, "_sample", spoilt)
    assert same(render(folder, 128), at_once)


def test_a_render_that_is_stopped_is_resumed_from_its_last_check(tmp_path: Path) -> None:
    arguments = scene()
    frame = candidate(**{k: v for k, v in arguments.items() if k != "stored"}, levels=[arguments["stored"]])
    common = {"pixel_filter": "gaussian", "seed": 0, "candidates": [frame], "resolved_share": 1e-9, "cache": tmp_path}
    shares: list[float] = []

    def stop(share: float) -> None:
        shares.append(share)
        if share > 20 / 64:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reference(**arguments, **common, min_passes=8, max_passes=64, progress=stop)
    assert shares == sorted(shares)
    assert reference(**arguments, **common, min_passes=4, max_passes=4).passes == 16
    got = reference(**arguments, **common, min_passes=64, max_passes=64)
    assert same(got, reference(**arguments, **common | {"cache": None}, min_passes=64, max_passes=64))


def test_every_ingredient_has_a_key_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    base = scene()
    mesh, camera, lighting, stored = (base[name] for name in ("mesh", "camera", "lighting", "stored"))

    def nudged(array: Any) -> Any:
        other = array.copy()
        other.reshape(-1)[5] += 1e-6 if other.dtype.kind == "f" else 1
        return other

    swapped = mesh.triangles.copy()
    swapped[[0, 1]] = swapped[[1, 0]]
    changes: list[dict[str, Any]] = [
        {},
        *({"mesh": replace(mesh, **{n: nudged(getattr(mesh, n))})} for n in ("positions", "normals", "uv", "tangents")),
        {"mesh": replace(mesh, triangles=swapped)},
        {"camera": replace(camera, looks_at=(0.0, 0.0, 1e-9))},
        {"camera": replace(camera, near=0.06)},
        {"lighting": replace(lighting, direction=-lighting.direction)},
        {"lighting": replace(lighting, radiance=lighting.radiance + 1e-9)},
        {"stored": nudged(stored)},
        {"stored": stored[:, :8]},
        {"model": "ggx", "stored": np.concatenate([stored, stored[..., :3]], -1)},
        {"model": "gltf-anisotropic", "stored": np.concatenate([stored, stored[..., :3]], -1)},
        {"wrap": ("wrap", "clamp")},
        {"wrap": ("clamp", "wrap")},
        {"resolution": (20, 24)},
        {"pixel_filter": "box"},
        {"seed": 1},
    ]
    for count, change in enumerate(changes, 1):
        render(tmp_path, 4, **change)
        assert len(files(tmp_path)) == count, change
    # What decides nothing: names, and how arrays lie in memory.
    other = {
        "mesh": replace(mesh, name="other", uv=np.asfortranarray(mesh.uv)),
        "lighting": replace(lighting, name="other"),
        "stored": stored.astype(np.float64),
        "wrap": ["wrap", "wrap"],
    }
    render(tmp_path, 4, **other)
    assert len(files(tmp_path)) == len(changes)
    for name, value in (("FORMAT", -1), ("__version__", "other")):
        monkeypatch.setattr(supersampling, name, value)
        render(tmp_path, 4)
    assert len(files(tmp_path)) == len(changes) + 2


def test_broken_and_foreign_files_are_ignored_and_replaced(tmp_path: Path) -> None:
    expected = render(tmp_path, 8)
    (path,) = files(tmp_path)
    good = path.read_bytes()
    with np.load(path) as archive:
        state = dict(archive)
    foreign: list[dict[str, Any]] = [
        {"sums": state["sums"]},
        state | {"sums": state["sums"][:, :, :5]},
        state | {"seen": state["seen"].astype(np.float32)},
        state | {"done": np.array(0)},
        state | {"shifts": state["shifts"] + 0.1},
        state | {"sums": np.full_like(state["sums"], np.nan)},
        {"sums": np.array([{}], object)},
    ]
    flipped = bytearray(good)
    flipped[len(good) // 3] ^= 255
    spoilt = [b"", b"no archive", good[: len(good) // 2], good[:-40], bytes(flipped)]
    for arrays in foreign:
        np.savez(tmp_path / "foreign.npz", **arrays)
        spoilt.append((tmp_path / "foreign.npz").read_bytes())
    for index, content in enumerate(spoilt):
        path.write_bytes(content)
        assert same(render(tmp_path, 8), expected), index
        assert path.stat().st_size == len(good), index
    path.unlink()
    path.mkdir()  # neither to be read nor to be replaced
    assert same(render(tmp_path, 8), expected)
    assert not list(tmp_path.glob("*.part"))
    (tmp_path / "file").write_text("in the way")
    assert same(render(tmp_path / "file" / "folder", 8), expected)


def test_the_longest_unused_files_are_removed_beyond_the_limit(tmp_path: Path) -> None:
    mine = tmp_path / "mine.npz"
    mine.write_bytes(bytes(5000))
    abandoned, current = tmp_path / "x.mipbake.part", tmp_path / "y.mipbake.part"
    abandoned.write_bytes(b"half")
    current.write_bytes(b"half")
    os.utime(abandoned, (1, 1))
    data = {"data": np.arange(1000, dtype=np.uint8)}
    for index, key in enumerate("abc"):
        cache.save(tmp_path, key, data, limit=4000)
        os.utime(tmp_path / f"{key}.mipbake.npz", (100 + index, 100 + index))
    assert not abandoned.exists() and current.exists() and mine.exists()
    kept = cache.load(tmp_path, "a")  # and is now the one last used
    assert kept is not None and np.array_equal(kept["data"], data["data"])
    cache.save(tmp_path, "d", data, limit=4000)
    assert {key for key in "abcd" if cache.load(tmp_path, key) is not None} == {"a", "c", "d"}
    cache.save(tmp_path, "e", data, limit=999)
    assert cache.load(tmp_path, "e") is None and mine.exists()
    assert cache.load(tmp_path / "none", "key") is None and not (tmp_path / "none").exists()


def test_the_default_folder_is_the_platforms(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert cache.default_folder() == tmp_path / "mipbake"
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "home")
    for ignored in ("", "relative/folder"):
        monkeypatch.setenv("XDG_CACHE_HOME", ignored)
        assert cache.default_folder() == tmp_path / "home" / ".cache" / "mipbake"
    monkeypatch.setattr("sys.platform", "darwin")
    assert cache.default_folder() == tmp_path / "home" / "Library" / "Caches" / "mipbake"
    monkeypatch.setattr("sys.platform", "win32")
    monkeypatch.setenv("LOCALAPPDATA", str(tmp_path / "local"))
    assert cache.default_folder() == tmp_path / "local" / "mipbake" / "Cache"
    monkeypatch.delenv("LOCALAPPDATA")
    assert cache.default_folder() == tmp_path / "home" / "AppData" / "Local" / "mipbake" / "Cache"
    assert not files(tmp_path)
