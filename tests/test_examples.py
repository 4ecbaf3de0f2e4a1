"""The example sets are what their generator makes, and they are what they claim to be."""

import importlib.util
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

import mipbake

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
