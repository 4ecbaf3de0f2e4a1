"""Cached references: they are bit for bit as without a cache, by content, even beside broken folders and files."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.comparing.meshes import cache, shapes
from mipbake.comparing.meshes.camera import orbit
from mipbake.comparing.meshes.mesh_render import Cache, Reference
from mipbake.quality.environment import directional

from .mesh_renders import candidate, reference

ARRAYS = {"a": np.arange(6.0).reshape(2, 3), "b": np.array(3)}


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


def render(
    cache: Path | Cache | None, passes: int, seed: int = 0, pixel_filter: str = "mitchell", **change: Any
) -> Reference:
    """Renders exactly that many passes, except for passes beyond them from a cache."""
    arguments = scene() | change
    stored = arguments["stored"]
    frame = candidate(**{k: v for k, v in arguments.items() if k != "stored"}, levels=[stored])
    cache = Cache(cache) if isinstance(cache, Path) else cache
    return reference(**arguments, pixel_filter=pixel_filter, seed=seed, candidates=[frame], resolved_share=1e-9,
                     min_passes=passes, max_passes=passes, cache=cache)  # fmt: skip


def same(a: Reference, b: Reference) -> bool:
    return (
        np.array_equal(a.first, b.first)
        and np.array_equal(a.second, b.second)
        and np.array_equal(a.interior, b.interior)
        and (a.passes, a.standard_error, a.candidate_error) == (b.passes, b.standard_error, b.candidate_error)
    )


def files(folder: Path) -> list[Path]:
    return sorted(folder.iterdir()) if folder.exists() else []


def test_a_cached_render_equals_an_uncached_one_and_a_continued_one_that_at_once(tmp_path: Path) -> None:
    folder = tmp_path / "not" / "there"
    short, at_once = render(None, 32), render(None, 128)
    assert same(render(folder, 32), short)
    again = render(folder, 32)
    assert same(again, short) and again.resumed == 32 and again.cache_note == ""
    continued = render(folder, 128)
    assert same(continued, at_once) and continued.resumed == 32
    # Passes that are there count, also where fewer would do.
    ready = render(folder, 32)
    assert same(ready, at_once) and ready.resumed == ready.passes == 128
    assert len(files(folder)) == 1


def test_other_candidates_of_the_same_view_continue_the_same_reference(tmp_path: Path) -> None:
    arguments = scene()
    stored = arguments.pop("stored")
    frame = candidate(**arguments, levels=[stored])
    common = {**arguments, "stored": stored, "pixel_filter": "gaussian", "seed": 0, "min_passes": 4}
    common["cache"] = Cache(tmp_path)
    far = reference(**common, candidates=[frame], resolved_share=0.5)
    assert far.converged and far.resumed == 0
    unchanged = files(tmp_path)[0].read_bytes()
    used = reference(**common, candidates=[replace(frame, image=frame.image * 2)], resolved_share=0.5)
    assert used.converged and used.resumed == used.passes == far.passes and np.array_equal(used.image, far.image)
    assert files(tmp_path)[0].read_bytes() == unchanged
    close = replace(frame, image=far.image + (frame.image - far.image) / 4)
    nearer = reference(**common, candidates=[close, frame], resolved_share=0.5)
    assert nearer.converged and nearer.passes > nearer.resumed == far.passes
    assert len(files(tmp_path)) == 1


def test_every_ingredient_has_a_key_of_its_own(tmp_path: Path) -> None:
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
        {"camera": replace(camera, field_of_view=40.5)},
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
    ]  # fmt: skip
    for count, change in enumerate(changes, 1):
        assert render(tmp_path, 4, **change).resumed == 0
        assert len(files(tmp_path)) == count, change
    for other_program in (Cache(tmp_path, format=-1), Cache(tmp_path, version=mipbake.__version__ + ".other")):
        assert render(other_program, 4).resumed == 0
    assert len(files(tmp_path)) == len(changes) + 2
    # What decides nothing: names, and how arrays lie in memory.
    other = {
        "mesh": replace(mesh, name="other", uv=np.asfortranarray(mesh.uv)),
        "lighting": replace(lighting, name="other"),
        "stored": stored.astype(np.float64),
        "wrap": ["wrap", "wrap"],
    }
    assert render(tmp_path, 4, **other).resumed == 4


def test_broken_and_foreign_files_are_ignored_and_replaced(tmp_path: Path) -> None:
    expected = render(tmp_path, 8)
    (path,) = files(tmp_path)
    good = path.read_bytes()
    with np.load(path) as archive:
        state = dict(archive)
    foreign = [
        {},
        {"sums": state["sums"]},
        state | {"sums": state["sums"][:, :5]},
        state | {"seen": state["seen"].astype(np.float32)},
        state | {"done": np.array([4])},
        state | {"done": np.array(0)},
        state | {"shifts": state["shifts"] + 0.1},
        state | {"sums": np.full_like(state["sums"], np.nan)},
    ]
    flipped = bytearray(good)
    flipped[len(good) // 3] ^= 255
    spoilt = [b"", b"no archive", good[: len(good) // 2], good[:-40], bytes(flipped)]
    for arrays in foreign:
        np.savez(tmp_path / "foreign.npz", **arrays)
        spoilt.append((tmp_path / "foreign.npz").read_bytes())
    np.save(tmp_path / "foreign.npy", state["sums"])
    spoilt.append((tmp_path / "foreign.npy").read_bytes())
    np.savez(tmp_path / "foreign.npz", sums=np.array([{}], object))
    spoilt.append((tmp_path / "foreign.npz").read_bytes())
    for index, content in enumerate(spoilt):
        path.write_bytes(content)
        got = render(tmp_path, 8)
        assert same(got, expected) and got.resumed == 0 and got.cache_note == "", index
        assert render(tmp_path, 8).resumed == 8, index
    path.unlink()
    path.mkdir()  # neither to be read nor to be replaced
    got = render(tmp_path, 8)
    assert same(got, expected) and got.resumed == 0 and "nothing is cached" in got.cache_note
    assert not list(tmp_path.glob("*.part"))


def test_a_folder_that_cannot_be_written_is_said_to_be_so(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    got = render(tmp_path / "file" / "folder", 8)
    assert same(got, render(None, 8))
    assert got.cache_note.startswith(f"nothing is cached: folder {tmp_path / 'file' / 'folder'} cannot be written (")


def test_a_render_that_is_stopped_is_resumed_from_its_last_save(tmp_path: Path) -> None:
    arguments = scene()
    frame = candidate(**{k: v for k, v in arguments.items() if k != "stored"}, levels=[arguments["stored"]])
    common = {"pixel_filter": "gaussian", "seed": 0, "candidates": [frame], "resolved_share": 1e-9, "heard_every": 0}
    common["cache"] = Cache(tmp_path, saved_every=0)

    def stop(passes: int, ratio: float) -> None:
        if passes > 16:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reference(**arguments, **common, min_passes=8, max_passes=64, progress=stop)
    got = reference(**arguments, **common, min_passes=64, max_passes=64)
    assert got.resumed == 16
    assert np.array_equal(got.image, reference(**arguments, **common | {"cache": None}, min_passes=64,
                                               max_passes=64).image)  # fmt: skip


def test_the_longest_unused_files_are_removed_beyond_the_limit(tmp_path: Path) -> None:
    mine = tmp_path / "mine.npz"
    mine.write_bytes(bytes(5000))
    abandoned, current = tmp_path / "x.mipbake.part", tmp_path / "y.mipbake.part"
    abandoned.write_bytes(b"half")
    current.write_bytes(b"half")
    os.utime(abandoned, (1, 1))
    data = {"data": np.zeros(1000, np.uint8)}
    for index, key in enumerate("abc"):
        assert cache.save(tmp_path, key, data, limit=4000) == ""
        os.utime(tmp_path / f"{key}.mipbake.npz", (100 + index, 100 + index))
    assert not abandoned.exists() and current.exists() and mine.exists()
    assert cache.load(tmp_path, "a") is not None  # and is now the one last used
    assert cache.save(tmp_path, "d", data, limit=4000) == ""
    kept = {key: cache.load(tmp_path, key) is not None for key in "abcd"}
    assert kept == {"a": True, "b": False, "c": True, "d": True}
    assert "more than the 999" in cache.save(tmp_path, "e", data, limit=999)
    assert cache.load(tmp_path, "e") is None and mine.exists()


def test_what_is_saved_is_loaded_and_what_is_not_there_is_none(tmp_path: Path) -> None:
    assert cache.load(tmp_path / "none", "key") is None and not (tmp_path / "none").exists()
    assert cache.save(tmp_path, "key", ARRAYS) == ""
    loaded = cache.load(tmp_path, "key")
    assert loaded is not None and loaded.keys() == ARRAYS.keys()
    assert all(np.array_equal(loaded[name], ARRAYS[name]) for name in ARRAYS)


def test_keys_of_contents() -> None:
    a = np.arange(4, dtype=np.int32)
    values: list[Any] = [
        a, a.astype(np.int64), a.view(np.float32), a.reshape(2, 2), a[:0], a[:0].reshape(0, 2), a.astype(">i4"),
        1, 1.0, "1", True, (1,), (1, 1), ((1, 1),), ("ab", "c"), ("a", "bc"), "", (),
    ]  # fmt: skip
    assert len({cache.content_key(value=value) for value in values}) == len(values)
    assert cache.content_key(a=1, b=2) == cache.content_key(b=2, a=1) != cache.content_key(a=2, b=1)
    assert cache.content_key(a=np.asfortranarray(a.reshape(2, 2))) == cache.content_key(a=a.reshape(2, 2))
    with pytest.raises(TypeError, match="no content key of dict"):
        cache.content_key(a={})


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
