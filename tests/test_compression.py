"""What files cost: figures that NumPy confirms, blocks that follow the material, warnings that help."""

from __future__ import annotations

import math
import re
import tracemalloc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import mipbake
from mipbake.baking import Listener, bake_sources
from mipbake.base.timings import Timings
from mipbake.source.images.blocks import from_blocks
from mipbake.source.texture_set import TextureSet
from mipbake.stack.compression import cost
from mipbake.stack.containers import FORMATS, format_named
from mipbake.stack.costs import COVERAGE_LIMIT, LIMIT, Cost, Coverage
from mipbake.stack.map_files import quantised_levels
from mipbake.stack.output import GLB_TEXELS, Output
from mipbake.stack.stack import MipStack

from .command_line import bumps, write_set
from .input_files import height_field
from .stacks import read_output, smooth


@cache
def mirror() -> tuple[TextureSet, MipStack]:
    """Nearly a mirror, with slopes of a few codes of 8 bits."""
    normal = height_field(32, 32, steepness=0.01)
    texture_set = TextureSet.from_arrays("mirror", normal=normal, roughness=0.06, base_color=0.7, metallic=1.0)
    return texture_set, mipbake.bake(texture_set, "vmf")


@cache
def plaster() -> tuple[TextureSet, MipStack]:
    """Rough, and rough to look at."""
    rng = np.random.default_rng(0)
    texture_set = TextureSet.from_arrays(
        "plaster",
        normal=height_field(32, 32, steepness=0.6),
        roughness=rng.uniform(0.7, 1, (32, 32)),
        base_color=smooth((32, 32), 3),
        occlusion=smooth((32, 32), 1, 2),
    )
    return texture_set, mipbake.bake(texture_set, "vmf")


@cache
def leaves() -> tuple[TextureSet, MipStack]:
    """Thin crossing strokes of noisy colours, tested against a cutoff."""
    v, u = np.mgrid[:64, :64]
    mask = ((u + 2 * v) % 13 < 2) ^ ((3 * u - v) % 17 < 1)
    texture_set = TextureSet.from_arrays(
        "leaves",
        normal=height_field(64, 64),
        roughness=0.8,
        base_color=np.random.default_rng(4).uniform(0, 1, (64, 64, 3)),
        opacity=mask.astype(float),
    )
    texture_set = replace(texture_set, alpha_cutoff=0.5)
    return texture_set, mipbake.bake(texture_set, "linear")


def written(made: tuple[TextureSet, MipStack], folder, output: Output, levels: int | None = None) -> Cost:
    texture_set, stack = made
    stack.save(folder, [output], levels=levels)
    return cost(texture_set, stack, output, read_output(folder, 0))


def encoded(stack: MipStack, name: str, srgb: bool) -> list[np.ndarray]:
    """File values of a map of its own."""
    levels = next(chain for layout, chain in stack.maps() if layout.name == name)
    if name == "normal":
        return [(level.astype(float) + 1) / 2 for level in levels]
    values = [level.astype(float) for level in levels]
    if not srgb or name != "base_color":
        return values
    return [np.where(v <= 0.0031308, 12.92 * v, 1.055 * np.maximum(v, 1e-9) ** (1 / 2.4) - 0.055) for v in values]


@pytest.mark.long
@pytest.mark.parametrize("fmt", ["png:8", "ktx2:bc", "exr:half"])
def test_psnr_is_what_numpy_says(tmp_path, fmt: str) -> None:
    """PSNR is taken of file values between 0 and 1, over all texels of all levels together."""
    _, stack = plaster()
    found = written(plaster(), tmp_path / "s", Output(fmt))
    assert set(found.psnr) == {"base_color", "metallic", "roughness", "normal", "occlusion"}
    back = mipbake.open_stack(tmp_path / "s")
    srgb = fmt.split(":")[1] in ("8", "16", "bc", "rgba8")
    for name, psnr in found.psnr.items():
        pairs = zip(encoded(back, name, srgb), encoded(stack, name, srgb), strict=True)
        error = np.concatenate([(a - b).ravel() for a, b in pairs])
        mean = np.mean(np.square(error))
        assert psnr == (math.inf if mean == 0 else pytest.approx(-10 * np.log10(mean), abs=0.02)), name
    assert found.psnr["metallic"] == math.inf  # it is 0 everywhere


def test_smooth_materials_lose_more(tmp_path) -> None:
    """Eight bits hide in plaster, and show in a mirror."""
    rough = written(plaster(), tmp_path / "a", Output("png:8"))
    glossy = written(mirror(), tmp_path / "b", Output("png:8"))
    assert rough.worst < LIMIT < glossy.worst
    assert not rough.warnings()
    assert "files of png:8 lose visibly" in "".join(glossy.warnings())


def test_blocks_spend_their_bits_where_it_shows(tmp_path) -> None:
    """Of texels that share blocks, the glossy ones keep more of their roughness than they would by themselves."""
    rng = np.random.default_rng(1)
    glossy = rng.random((64, 64)) < 0.5
    roughness = np.where(glossy, rng.uniform(0.1, 0.2, (64, 64)), rng.uniform(0.6, 1.0, (64, 64)))
    texture_set = TextureSet.from_arrays(
        "spots", normal=height_field(64, 64), roughness=roughness, metallic=rng.random((64, 64)), base_color=0.7
    )
    stack = mipbake.bake(texture_set, "linear", pixel_filter="box")
    (orm,) = (file for file in stack.files(Output("dds:bc", "orm")) if "roughness" in str(file.layout.channels))
    stack.save(tmp_path / "weighed", [Output("dds:bc", "orm")])
    weighed = next(f for f in read_output(tmp_path / "weighed", 0) if f.layout.name == orm.layout.name).levels[0]
    (blind, *_) = from_blocks(orm.container.texture(orm.layout, quantised_levels(orm), ""))
    place = [channel.map for channel in orm.layout.channels].index("roughness")
    errors = [np.square(each[..., place] - orm.levels[0][..., place])[glossy].mean() for each in (weighed, blind)]
    assert errors[0] < 0.8 * errors[1], errors


@pytest.mark.parametrize("fmt", ["ktx2", "dds", "glb"])
def test_nothing_costlier_is_taken_silently(tmp_path, fmt: str) -> None:
    """A mirror of 8 bits costs much. It gets the texels that were asked for, and advice with what better ones take."""
    source = write_set(tmp_path / "mirror", **{**bumps(64, 64), "roughness": np.full((64, 64), 20, np.uint8)})
    (result,) = bake_sources(source, tmp_path / "out", mipbake.BakeOptions(method="linear", format=fmt))
    (cost,) = result.costs
    assert not any("8G8" in texels or "16" in texels for texels in cost.texels.values())
    if cost.worst > LIMIT:
        (said,) = (line for line in result.warnings if " lose visibly" in line)
        assert re.search(r"--format \S+ \(\d+\.\d in place of \d+\.\d MB on the card\)", said)


ORDER = ["bc1", "uastc", "bc", "8", "rgba8", "16", "half", "rgba16f", "float"]
NAMES = [f"{name}:{texels}" for name, kinds in FORMATS.items() for texels in kinds if texels != "float"]


@pytest.mark.parametrize("fmt", [*NAMES, "glb", "glb:rgba8"])
def test_warnings_name_formats_that_exist_and_are_better(fmt: str) -> None:
    assert not Cost(fmt, {}, {"near-mirror": LIMIT, "hemisphere": -2.0}, {}).warnings()
    (said,) = Cost(fmt, {}, {"near-mirror": 1.26, "hemisphere": -0.2}, {}).warnings()
    assert "\n" not in said
    assert said.startswith(f"files of {fmt} lose visibly: ")
    assert ("the glTF standard allows no other texels" in said) == (fmt == "glb")
    (advice,) = re.findall(r"--format (\S+)", said)
    assert advice != fmt
    if advice.startswith("glb:"):
        assert advice.partition(":")[2] in GLB_TEXELS[1:] and fmt == "glb"
        return
    better = format_named(advice)
    if not fmt.startswith("glb") and format_named(fmt).name == better.name:
        assert ORDER.index(better.texels) > ORDER.index(fmt.split(":")[1])


@pytest.mark.long
def test_long_phases_move_as_they_go(tmp_path) -> None:
    """Encoding a GLB and measuring: by every file and every level of detail, never back."""
    told: dict[str, list[float]] = {}

    class Heard(Listener):
        @contextmanager
        def timings(self, label: str) -> Iterator[Timings]:
            yield Timings(lambda phase, share: told.setdefault(phase, []).append(share))

    options = mipbake.BakeOptions(method="linear", format="ktx2,dds,png,glb")
    bake_sources(write_set(tmp_path / "metal"), tmp_path / "out", options, listener=Heard())
    for phase, files in (("encode", 3), ("write", 8), ("check", 6)):
        assert told[phase] == sorted(told[phase]) and told[phase][-1] == 1, phase
        assert len(set(told[phase])) >= files, phase


@pytest.mark.long
@pytest.mark.parametrize(("fmt", "packing"), [("ktx2:uastc", "orm"), ("dds:bc", "separate"), ("png:8", "orm")])
def test_coverage_is_measured_in_the_files(tmp_path, fmt: str, packing: str) -> None:
    """The largest change of any level of at least 8 x 8 texels; smaller ones have more, which is not told."""
    found = written(leaves(), tmp_path / "s", Output(fmt, packing))
    baked, back = leaves()[1].extra["opacity"], mipbake.open_stack(tmp_path / "s").extra["opacity"]
    shares = [((a >= 0.5).mean(), (b >= 0.5).mean()) for a, b in zip(baked, back, strict=True)]
    changes = [abs(a - b) for a, b in shares[:4]]
    assert found.coverage.change == max(changes)
    assert (found.coverage.baked, found.coverage.written) == shares[found.coverage.level]
    assert found.coverage.alone == (packing == "separate")
    beside_colours = fmt != "png:8" and packing == "orm"
    assert (found.coverage.change > COVERAGE_LIMIT) == beside_colours
    assert any("coverage" in said for said in found.warnings()) == beside_colours


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("fmt", [*NAMES, "glb"])
def test_warnings_of_coverage_name_what_is_better(fmt: str, alone: bool) -> None:
    texels = fmt.partition(":")[2] or "uastc"
    small, large = (Coverage(1, 0.17, share, texels, alone) for share in (0.151, 0.138))
    none = {"near-mirror": 0.0, "hemisphere": 0.0}
    assert not Cost(fmt, {}, none, {}, coverage=small).warnings()
    (said,) = Cost(fmt, {}, none, {}, coverage=large).warnings()
    assert f"{fmt} changes the coverage of the opacity at level 1: 17.0 % as baked, 13.8 % in the files" in said
    (advice,) = re.findall(r"--format ([^\s,]+)", said)
    assert format_named(advice).texels != texels and "bc" not in advice
    blocks = texels in ("bc", "bc1", "uastc")
    assert ("--packing separate" in said) == (blocks and not alone and fmt != "glb")


@pytest.mark.long
def test_memory(tmp_path) -> None:
    """Files are read back, and measured, in little more than what they and the stack take."""
    texture_set = TextureSet.from_arrays(
        "plain", normal=height_field(1024, 1024), roughness=0.5, base_color=smooth((1024, 1024), 3)
    )
    stack = mipbake.bake(texture_set, "linear")
    stack.save(tmp_path / "out", "exr")
    size = sum(level.nbytes for level in stack.levels)
    tracemalloc.start()
    files = read_output(tmp_path / "out", 0)
    assert tracemalloc.get_traced_memory()[1] < 1.4 * size
    tracemalloc.reset_peak()
    cost(texture_set, stack, Output("exr"), files)
    assert tracemalloc.get_traced_memory()[1] < 3.4 * size  # the files, and about as much again twice
    tracemalloc.stop()
