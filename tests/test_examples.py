"""The example sets are what their generator makes, and they are what they claim to be."""

import importlib
import importlib.util
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

import mipbake
from mipbake import shading
from mipbake.baking.methods import METHODS
from mipbake.quality.metrics import PAIR_SETS

EXAMPLES = Path(__file__).parents[1] / "examples"
_SPEC = importlib.util.spec_from_file_location("examples_generate", EXAMPLES / "generate.py")
generate = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(generate)


def read(path):
    return OpenImageIO.ImageBuf(str(path)).get_pixels("uint8").astype(int)


@pytest.mark.parametrize("name", generate.SETS)
def test_committed_files_are_what_the_generator_makes(name):
    made = generate.make(name)
    assert sorted(p.stem for p in (EXAMPLES / name).glob("*.png")) == sorted(made)
    assert sum(p.stat().st_size for p in (EXAMPLES / name).iterdir()) < 1_000_000
    for file, pixels in made.items():
        stored = read(EXAMPLES / name / f"{file}.png")
        # One step of 255: the last bit of sine and exponential differs between machines.
        assert np.abs(stored - pixels.reshape(stored.shape)).max() <= 1


@pytest.mark.parametrize("name", generate.SETS)
def test_sets_tile(name):
    """Texels across the seam differ like neighbours, not like strangers."""
    for file, pixels in generate.make(name, 128, 128).items():
        image = pixels.astype(float).reshape(128, 128, -1)
        for axis in (0, 1):
            steps = np.abs(image - np.roll(image, 1, axis)).mean(axis=(1 - axis, 2))
            assert steps[0] <= 1.3 * max(steps[1:].max(), 0.1), (file, axis)


@pytest.mark.parametrize("name", generate.SETS)
@pytest.mark.parametrize("size", [(32, 48), (7, 5), (1, 16)])
def test_any_size(name, size):
    for pixels in generate.make(name, *size).values():
        assert pixels.shape[:2] == size and pixels.dtype == np.uint8


def test_a_set_is_the_same_material_at_any_size():
    large = generate.make("hammered_copper", 256, 256)["roughness"].astype(float)
    small = generate.make("hammered_copper", 128, 128)["roughness"].astype(float)
    averaged = large.reshape(128, 2, 128, 2).mean((1, 3))
    assert np.corrcoef(averaged.ravel(), small.ravel())[0, 1] > 0.95


@pytest.mark.parametrize("name", generate.SETS)
def test_load_understands_the_sets(name):
    texture_set = mipbake.load(EXAMPLES / name)
    assert texture_set.convention.name == "opengl" and texture_set.convention.decided_by == "pixels"
    assert texture_set.anisotropic == (name == "brushed_steel")
    assert (texture_set.width, texture_set.height) == (256, 256) and not texture_set.warnings
    normal = texture_set.maps["normal"].pixels
    # Bumps: averaged over 8 x 8 texels, normals of the shiny parts are clearly shorter than one.
    length = np.linalg.norm(normal.reshape(32, 8, 32, 8, 3).mean((1, 3)), axis=-1)
    assert np.mean(1 - length) > 0.002


def test_write_makes_the_files(tmp_path):
    files = generate.write("glazed_tiles", tmp_path / "new" / "set", 16, 24)
    assert {p.name for p in files} == {p.name for p in (tmp_path / "new" / "set").iterdir()}
    np.testing.assert_array_equal(read(files[1]), generate.make("glazed_tiles", 16, 24)["normal"])


def test_a_pixel_of_the_knurled_plate_has_four_lobes():
    """Away from the disc the shading of a pyramid, over half vectors, has four peaks and a valley between them."""
    stored = mipbake.load(EXAMPLES / "knurled_plate").material("gltf")[:68]  # four periods, above the disc
    tilt = np.linspace(-0.35, 0.35, 29)
    half = np.stack([*np.meshgrid(tilt, tilt, indexing="ij"), np.ones((29, 29))], -1).reshape(-1, 3)
    half = (half / np.linalg.norm(half, axis=-1, keepdims=True)).astype(np.float32)
    seen = shading.shade("gltf", stored.reshape(-1, 8), half, half).mean((1, 2)).reshape(29, 29)
    inner = seen[1:-1, 1:-1]
    neighbours = [np.roll(seen, (i, j), (0, 1))[1:-1, 1:-1] for i in (-1, 0, 1) for j in (-1, 0, 1) if i or j]
    peaks = np.argwhere((inner > np.max(neighbours, 0)) & (inner > 0.5 * inner.max())) + 1
    assert len(peaks) == 4
    assert np.linalg.norm(tilt[peaks], axis=-1) == pytest.approx(0.25, abs=0.05)
    assert seen[14, 14] < 0.25 * seen.max()


def test_every_method_fails_on_the_knurled_plate():
    texture_set = mipbake.load(EXAMPLES / "knurled_plate")
    forms = [(name, None) for name in METHODS if METHODS[name].averages]  # the stronger of their two kernels
    stack = mipbake.bake(texture_set, "neural")
    lods = (3.0, 7.0)
    measured = mipbake.validate(texture_set, stack, lods, points=128, samples=16, baselines=forms)
    assert len(measured.methods) == 1 + len(forms)
    for lod in lods:
        assert max(measured.snr(m, p, lod) for m in measured.methods for p in PAIR_SETS) < 13
        assert max(measured.snr(m, "hemisphere", lod) for m in measured.methods) < 9


@pytest.fixture
def showcase(monkeypatch):
    monkeypatch.syspath_prepend(EXAMPLES)
    return importlib.import_module("showcase")


# Root mean square of slopes, and share of texels whose roughness is below 0.25: at least so much at 192 x 192, a size
# that leaves the finest marks and stones out.
SHOWN = {
    "wet_asphalt": (0.1, 0.99), "embossed_steel": (0.2, 0.9), "brushed_aluminium": (0.01, 0.9),
    "black_tiles": (0.09, 0.5), "pebbled_leather": (0.18, 0.3), "sparkling_snow": (0.15, 0.02), "ocean": (0.12, 0.9),
}  # fmt: skip


@pytest.mark.parametrize("name", SHOWN)
def test_sets_of_the_showcase_tile_and_are_glossy_and_bumpy(showcase, name):
    assert set(showcase.SHOWCASE) == set(SHOWN)
    maps = showcase.SHOWCASE[name](192, 192)
    assert sorted(maps) == ["base_color", "metallic", "normal", "roughness"]
    for file, image in maps.items():
        assert image.shape[:2] == (192, 192) and image.min() >= 0 and image.max() <= 1
        for axis in (0, 1):
            steps = np.abs(image - np.roll(image, 1, axis)).reshape(192, 192, -1).mean(axis=(1 - axis, 2))
            assert steps[0] <= 1.5 * max(steps[1:].max(), 1e-3), (file, axis)
    normal = 2 * maps["normal"] - 1
    slope, glossy = SHOWN[name]
    assert np.sqrt(np.square(normal[..., :2] / normal[..., 2:]).sum(-1).mean()) > slope
    assert (maps["roughness"] < 0.25).mean() > glossy and maps["roughness"].min() >= 0.045
    assert set(np.unique(maps["metallic"])) == {1.0 if name in ("embossed_steel", "brushed_aluminium") else 0.0}


def test_the_showcase_is_written_by_one_command(showcase, monkeypatch, tmp_path):
    monkeypatch.setattr("sys.argv", ["showcase.py", str(tmp_path), "--size", "32", "--only", "ocean"])
    showcase.main()
    texture_set = mipbake.load(tmp_path / "ocean")
    assert (texture_set.width, texture_set.height) == (32, 32) and not texture_set.anisotropic


@pytest.mark.parametrize("size", ["0", "-8", "many"])
def test_a_set_without_texels_is_refused(showcase, monkeypatch, tmp_path, capsys, size):
    monkeypatch.setattr("sys.argv", ["showcase.py", str(tmp_path), "--size", size])
    with pytest.raises(SystemExit):
        showcase.main()
    assert f"argument --size: expected a whole number above 0, got {size!r}" in capsys.readouterr().err
