"""What files cost: figures that NumPy confirms, texels that follow the material, warnings that help."""

from __future__ import annotations

import json
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
from mipbake.quality.metrics import PAIR_SETS
from mipbake.source.texture_set import TextureSet
from mipbake.stack.compression import chosen, cost
from mipbake.stack.containers import FORMATS, format_named
from mipbake.stack.costs import COVERAGE_LIMIT, LIMIT, Cost, Coverage
from mipbake.stack.manifest import read_output
from mipbake.stack.output import GLB_TEXELS, Output
from mipbake.stack.presets import PRESETS
from mipbake.stack.stack import MipStack

from .command_line import bumps, write_set
from .gltf_files import GltfFile
from .input_files import height_field
from .stacks import smooth
from .test_presets import run

LADDER = ["bc", "rgba8", "rgba16f"]


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
@pytest.mark.parametrize("fmt", ["png:8", "png:16", "ktx2:bc", "ktx2:rgba8", "dds:rgba16f", "tx:8", "exr:half"])
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


@pytest.mark.long
@pytest.mark.parametrize(("fmt", "bits"), [("png:8", 8), ("png:16", 16), ("ktx2:rgba8", 8)])
def test_psnr_of_rounding(tmp_path, fmt: str, bits: int) -> None:
    """Errors that are even between -1/2 and 1/2 step have a mean square of a twelfth of a step's."""
    found = written(plaster(), tmp_path / "s", Output(fmt))
    step = 1 / (2**bits - 1)
    assert found.psnr["roughness"] == pytest.approx(-10 * np.log10(step**2 / 12), abs=0.5)


@pytest.mark.long
def test_floats_cost_nothing(tmp_path) -> None:
    for made in (plaster(), mirror()):
        found = written(made, tmp_path / made[0].name, Output("exr:float"))
        assert set(found.loss) == set(PAIR_SETS)
        assert max(abs(loss) for loss in found.loss.values()) < 0.005
        assert not found.warnings()
        assert set(found.texels.values()) == {"float"}


def test_fewer_levels_are_measured_as_they_are(tmp_path) -> None:
    found = written(plaster(), tmp_path / "s", Output("tx:float"), levels=2)
    assert abs(found.worst) < 0.005


def test_smooth_materials_lose_more(tmp_path) -> None:
    """Eight bits hide in plaster, and show in a mirror."""
    rough = written(plaster(), tmp_path / "a", Output("png:8"))
    glossy = written(mirror(), tmp_path / "b", Output("png:8"))
    assert rough.worst < LIMIT < glossy.worst
    assert not rough.warnings()
    assert "png:8 costs" in "".join(glossy.warnings())


@pytest.mark.long
@pytest.mark.parametrize("container", ["ktx2", "dds"])
def test_better_texels_are_chosen_for_smooth_materials(container: str) -> None:
    ranks = {}
    for texture_set, stack in (plaster(), mirror()):
        output = chosen(texture_set, stack, Output(container))
        names = {file.layout.name for file in stack.files(output)}
        assert set(output.texels) <= names
        assert set(output.texels.values()) <= set(LADDER[1:])  # never worse than half floats, never the default
        ranks[texture_set.name] = sum(LADDER.index(texels) for texels in output.texels.values())
        for file in stack.files(output):
            assert file.container.texels == output.texels.get(file.layout.name, "bc")
    assert ranks["plaster"] < ranks["mirror"]
    assert chosen(*mirror(), Output(container)).texels["normal"] == "rgba16f"


@pytest.mark.long
def test_what_is_chosen_costs_less_than_the_limit(tmp_path) -> None:
    """Alone, every file is measured; together they may err by half of it more."""
    for made in (plaster(), mirror()):
        output = chosen(*made, Output("dds"))
        assert written(made, tmp_path / made[0].name, output).worst < 1.5 * LIMIT
    blocks = written(mirror(), tmp_path / "blocks", Output("dds:bc"))
    assert blocks.worst > LIMIT


@pytest.mark.parametrize("name", ["unity", "babylon"])
def test_presets_and_texels_that_are_named_are_left_alone(name: str) -> None:
    (output,) = PRESETS[name].outputs
    assert chosen(*mirror(), output) is output


@pytest.mark.parametrize("fmt", ["png", "exr", "tx:8", "ktx2:bc", "dds:bc1"])
def test_other_formats_are_left_alone(fmt: str) -> None:
    output = Output(fmt)
    assert chosen(*mirror(), output) is output


@pytest.mark.long
def test_names_of_files_lead_to_their_texels() -> None:
    """They do so even where a preset renames files."""
    (preset,) = PRESETS["unreal"].outputs
    output = chosen(*mirror(), Output("dds", "orm", preset.normals, preset.naming, preset.names))
    plain = chosen(*mirror(), Output("dds", "orm", preset.normals))
    texels = [file.container.texels for file in mirror()[1].files(output)]
    assert [file.layout.name for file in mirror()[1].files(output)] == ["T_mirror_BC", "T_mirror_ORM", "T_mirror_N"]
    assert texels == [file.container.texels for file in mirror()[1].files(plain)] and texels[2] == "rgba16f"


def test_presets_whose_engine_takes_finer_texels_get_them_where_blocks_show() -> None:
    (output,) = PRESETS["three"].outputs
    texels = {f.layout.name: f.container.texels for f in mirror()[1].files(chosen(*mirror(), output))}
    assert texels["mirror_normal"] == "rgba16f" and texels["mirror_baseColor"] == "uastc"


ORDER = ["bc1", "uastc", "bc", "8", "rgba8", "16", "half", "rgba16f", "float"]
NAMES = [f"{name}:{texels}" for name, kinds in FORMATS.items() for texels in kinds if texels != "float"]


@pytest.mark.parametrize("fmt", [*NAMES, "glb", "glb:rgba8"])
def test_warnings_name_formats_that_exist_and_are_better(fmt: str) -> None:
    (said,) = Cost(fmt, {}, {"near-mirror": 1.26, "hemisphere": -0.2}, {}).warnings()
    assert "\n" not in said
    assert said.startswith(f"{fmt} costs 1.3 dB (near the mirror) of the shaded result's SNR, which is more than 0.3: ")
    assert ("the glTF standard allows no other texels" in said) == (fmt == "glb")
    (advice,) = re.findall(r"--format (\S+)", said)
    assert advice != fmt
    if advice.startswith("glb:"):
        assert advice.partition(":")[2] in GLB_TEXELS[1:] and fmt == "glb"
        return
    better = format_named(advice)
    if not fmt.startswith("glb") and format_named(fmt).name == better.name:
        assert ORDER.index(better.texels) > ORDER.index(fmt.split(":")[1])


@pytest.mark.parametrize("name", PRESETS)
def test_what_is_advised_for_a_preset_is_known_of_its_engine(name: str) -> None:
    preset = PRESETS[name]
    for output in preset.outputs:
        changed = Coverage(1, 0.17, 0.138, output.container.texels, False)
        cost = Cost(output.format, {}, {"near-mirror": 0.1, "hemisphere": 1.0}, {}, changed)
        loss, coverage = cost.warnings(preset)
        assert f"{output.format} costs 1.0 dB (over the hemisphere)" in loss
        assert preset.no_finer in loss and preset.no_finer in coverage
        # Renderers read what OpenImageIO does, and presets with finer texels have chosen some.
        assert preset.no_finer or output.finer or output.container.texels in ("half", "16")
        assert not (preset.no_finer and output.finer)


@pytest.mark.long
def test_a_preset_has_no_say_where_the_user_chose(tmp_path) -> None:
    polished = np.full((16, 16), 26, np.uint8)
    folder = write_set(tmp_path / "metal", roughness=polished)
    for options, wanted in (([], "Unity is not known"), (["--format", "dds:bc1"], "use --format dds:bc where")):
        arguments = ["-o", tmp_path / "out", "--method", "linear", "--preset", "unity", *options]
        code, said = run("bake", folder, *arguments)
        assert code == 0 and wanted in said


@pytest.mark.parametrize("loss", [LIMIT, 0.0, -1.0])
def test_no_warning_below_the_limit(loss: float) -> None:
    assert not Cost("png:8", {}, {"near-mirror": loss, "hemisphere": -2.0}, {}).warnings()


@pytest.mark.long
def test_the_command_line_prints_costs(tmp_path) -> None:
    folder = write_set(tmp_path / "metal")
    code, said = run("bake", folder, "-o", tmp_path / "out", "--method", "linear", "--format", "png,dds,exr:float")
    assert code == 0
    lines = said.splitlines()
    decibel = r"(?:[+-](?!0\.00)\d+\.\d\d|0\.00) dB"
    for name in ("png:8", "dds:", "exr:float"):
        (first,) = (i for i, line in enumerate(lines) if line.startswith(name) and "costs" in line)
        losses = rf"near-mirror {decibel}, hemisphere {decibel}"
        figures = rf"{name}.* costs in SNR of the shaded result: {losses}; PSNR of the files:"
        assert re.fullmatch(figures, lines[first])
        files = lines[first + 1 : first + 5]
        assert [line.split()[0] for line in files] == ["base_color", "normal", "roughness", "metallic"]
        assert all(re.fullmatch(r"  \w+ +(\d+\.\d dB|exact)  \w+", line) for line in files)
        assert len({re.search(r"(dB|exact)  ", line).end() for line in files}) == 1  # aligned
    assert "exr:float costs in SNR of the shaded result: near-mirror 0.00 dB, hemisphere 0.00 dB" in said
    code, said = run("bake", folder, "-o", tmp_path / "out", "--method", "linear", "--format", "png,dds", "--json")
    (result,) = json.loads(said)["results"]
    assert [each["format"].split(":")[0] for each in result["costs"]] == ["png", "dds"]
    assert set(result["costs"][0]["loss"]) == set(PAIR_SETS)


@pytest.mark.long
def test_long_phases_move_as_they_go(tmp_path) -> None:
    """Choosing texels, encoding a GLB and measuring: by every file and every level of detail, never back."""
    told: dict[str, list[float]] = {}

    class Heard(Listener):
        @contextmanager
        def timings(self, label: str) -> Iterator[Timings]:
            yield Timings(lambda phase, share: told.setdefault(phase, []).append(share))

    options = mipbake.BakeOptions(method="linear", format="ktx2,dds,png,glb")
    bake_sources(write_set(tmp_path / "metal"), tmp_path / "out", options, listener=Heard())
    for phase in ("texels", "encode", "write", "check"):
        assert told[phase] == sorted(told[phase]) and told[phase][-1] == 1, phase
        assert len(set(told[phase])) > 5, phase


@pytest.mark.long
@pytest.mark.parametrize(
    ("fmt", "packing"), [("dds:bc", "orm"), ("ktx2:uastc", "orm"), ("dds:bc", "separate"), ("png:8", "orm")]
)
def test_coverage_is_measured_in_the_files(tmp_path, fmt: str, packing: str) -> None:
    """The largest change of any level of at least 8 x 8 texels; smaller ones have more, which is not told."""
    found = written(leaves(), tmp_path / "s", Output(fmt, packing))
    baked, back = leaves()[1].extra["opacity"], mipbake.open_stack(tmp_path / "s").extra["opacity"]
    shares = [((a >= 0.5).mean(), (b >= 0.5).mean()) for a, b in zip(baked, back, strict=True)]
    changes = [abs(a - b) for a, b in shares[:4]]
    assert found.coverage is not None
    assert found.coverage.change == max(changes)
    assert (found.coverage.baked, found.coverage.written) == shares[found.coverage.level]
    assert found.coverage.alone == (packing == "separate")
    beside_colours = fmt != "png:8" and packing == "orm"
    assert (found.coverage.change > COVERAGE_LIMIT) == beside_colours
    assert any("coverage" in said for said in found.warnings()) == beside_colours


@pytest.mark.long
def test_only_a_tested_opacity_has_coverage(tmp_path) -> None:
    texture_set, stack = leaves()
    blended = replace(texture_set, alpha_cutoff=None), stack
    assert written(blended, tmp_path / "a", Output("png:8")).coverage is None
    assert written(plaster(), tmp_path / "b", Output("png:8")).coverage is None


@pytest.mark.parametrize("alone", [False, True])
@pytest.mark.parametrize("fmt", [*NAMES, "glb"])
def test_warnings_of_coverage_name_what_is_better(fmt: str, alone: bool) -> None:
    texels = fmt.partition(":")[2] or "uastc"
    small, large = (Coverage(1, 0.17, share, texels, alone) for share in (0.151, 0.138))
    none = {"near-mirror": 0.0, "hemisphere": 0.0}
    assert not Cost(fmt, {}, none, {}, small).warnings()
    (said,) = Cost(fmt, {}, none, {}, large).warnings()
    assert f"{fmt} changes the coverage of the opacity at level 1: 17.0 % as baked, 13.8 % in the files" in said
    (advice,) = re.findall(r"--format ([^\s,]+)", said)
    assert format_named(advice).texels != texels and "bc" not in advice
    blocks = texels in ("bc", "bc1", "uastc")
    assert ("--packing separate" in said) == (blocks and not alone and fmt != "glb")


@pytest.mark.long
@pytest.mark.parametrize("mode", ["files", "square", "document"])
def test_the_command_line_tells_coverage(tmp_path, mode: str) -> None:
    """The coverage of files, of a GLB of one square, and of a document whose material is masked is printed."""
    texture_set, _ = leaves()
    opacity, colour = (np.rint(255 * texture_set.maps[role].pixels) for role in ("opacity", "base_color"))
    leaf = np.dstack([colour, opacity]).astype(np.uint8)
    folder = write_set(tmp_path / "leaf", base_color=leaf, normal=bumps(64, 64)["normal"], roughness=None)
    if mode == "document":
        document = GltfFile()
        names = ("base_color", "normal")
        colours, normals = (document.texture(document.image((folder / f"{n}.png").read_bytes(), n)) for n in names)
        pbr = {"baseColorTexture": {"index": colours}}
        document.material("m", pbrMetallicRoughness=pbr, normalTexture={"index": normals}, alphaMode="MASK")
        document.squares()
        source, options = document.write(tmp_path / "leaf_document"), ["--format", "glb"]
    else:
        options = ["--map", "roughness=0.8", "--alpha-cutoff", "0.5"]
        source, options = folder, [*options, "--format", "dds:bc" if mode == "files" else "glb"]
    name = "dds:bc" if mode == "files" else "glb"
    code, said = run("bake", source, "-o", tmp_path / "out", "--method", "linear", *options)
    share = r"\d+\.\d %"
    line = f"coverage of the opacity at level \\d: {share} as baked, {share} in the files"
    assert code == 0 and re.search(rf"^{name} costs.*(\n  .*)*\n  {line}$", said, re.M)
    assert re.search(rf"^warning: {name} changes the {line}, by more than 2 points: (use|a glTF file) ", said, re.M)


@pytest.mark.long
@pytest.mark.parametrize("texels", [("bc", "rgba8"), ("rgba8", "bc"), ("rgba8", "rgba16f"), ("rgba16f", "rgba8")])
def test_what_an_output_is_called_is_no_matter_of_chance(tmp_path, texels) -> None:
    """Files of two kinds of texels, as many of each."""
    names = ("base_color", "metallic", "roughness", "normal")
    output = Output("ktx2", "separate", texels=dict(zip(names, 2 * texels, strict=True)))
    assert written(plaster(), tmp_path / "out", output).format == f"ktx2:{texels[0]}"


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
