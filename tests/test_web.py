"""The npm package bakes what the command line bakes, and what its transform writes is what engines load."""

from __future__ import annotations

import importlib
import json
import re
import shutil
import subprocess
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mipbake
from mipbake.baking.methods import METHODS
from mipbake.base.srgb import linear_to_srgb
from mipbake.base.version import __version__
from mipbake.cli.main import main
from mipbake.material.pixel_filter import FILTERS
from mipbake.source.gltf.document import Document, read_document
from mipbake.source.gltf.images import KTX2, source_of, stored_image
from mipbake.source.images import ktx2
from mipbake.source.images.gpu_format import GpuTexture

from .gltf_files import GltfFile, many_materials
from .input_files import bytes_of, encoded, height_field, write_set

ROOT = Path(__file__).parents[1]
WEB, ENGINES = ROOT / "web", ROOT / "benchmarks" / "engines"
COMMAND = WEB / "src" / "command.js"

Maps = Mapping[str, np.ndarray]

needs_the_core = [
    pytest.mark.independent,
    pytest.mark.skipif(
        not (WEB / "dist" / "bakes.wasm").is_file(), reason="the core as WebAssembly is missing: python web/build.py"
    ),
    pytest.mark.skipif(shutil.which("node") is None, reason="Node.js is not installed"),
]
pytestmark = needs_the_core
needs_packages = pytest.mark.skipif(
    not (WEB / "node_modules").is_dir(), reason="the npm packages are missing: npm ci --prefix web"
)

STEMS = {"baseColor": "base_color", "normal": "normal_gl", "occlusion": "ao"}
"""Maps of the package whose files have other names."""

NEARLY_ALL = 0.95
"""Of blocks: where two choices are nearly as good, rounding chooses."""

NEAR, OFF = 2e-5, 2e-4
"""What nearly all stored channels differ by at most, and what any does. The native core itself gives numbers that
differ by 1.3e-4 where an instruction set fuses multiplications with additions."""

DIRECTION, STRENGTH = slice(8, 10), 10


def smooth(rng: np.random.Generator, *shape: int) -> np.ndarray:
    values = rng.random(shape)
    for axis in (0, 1) * 2:
        values = (values + np.roll(values, 1, axis) + np.roll(values, -1, axis)) / 3
    return (values - values.min()) / np.ptp(values)


def material(height: int, width: int, *more: str) -> Maps:
    """A bumpy set of 8 bits; `more` are anisotropy, alpha, or maps that do not shade."""
    rng = np.random.default_rng([height, width, len(more)])
    base = [smooth(rng, height, width, 3), *([smooth(rng, height, width, 1) * 4 - 1.5] if "alpha" in more else [])]
    maps = {
        "baseColor": bytes_of(np.concatenate(base, -1)),
        "normal": encoded(height_field(height, width, steepness=0.4)),
        "roughness": bytes_of(0.08 + 0.4 * smooth(rng, height, width)),
        "metallic": bytes_of(smooth(rng, height, width) > 0.5),
    }
    if "anisotropy" in more:
        angle = 4 * np.pi * smooth(rng, height, width)
        lines = [np.cos(angle) / 2 + 0.5, np.sin(angle) / 2 + 0.5, 0.1 + 0.8 * smooth(rng, height, width)]
        maps["anisotropy"] = bytes_of(np.stack(lines, -1))
    for role, channels in (("occlusion", 1), ("emissive", 3)):
        if role in more:
            maps[role] = bytes_of(smooth(rng, height, width, channels))
    return maps


@dataclass(frozen=True)
class Baked:
    """What the package made."""

    folder: Path
    about: Mapping[str, Any]

    def image(self, found: Mapping[str, Any]) -> np.ndarray:
        return np.fromfile(self.folder / found["file"], found["dtype"]).reshape(found["shape"])

    @property
    def stored(self) -> list[np.ndarray]:
        return [self.image(each) for each in self.about["stored"]]

    def levels(self, name: str) -> list[np.ndarray]:
        return [self.image(each[name]) for each in self.about["levels"]]


def in_javascript(folder: Path, maps: Maps, textures: tuple[str, ...] = (), **options: Any) -> Baked:
    folder.mkdir(parents=True, exist_ok=True)
    described = {}
    for name, pixels in maps.items():
        pixels.tofile(folder / f"{name}.in")
        shape = [*pixels.shape, 1][:3]
        described[name] = {"file": f"{name}.in", "shape": shape, "dtype": str(pixels.dtype)}
    job = folder / "job.json"
    job.write_text(json.dumps({"maps": described, "options": options, "ktx2": textures}))
    subprocess.run(["node", ROOT / "tests" / "bake_in_node.mjs", job], check=True, timeout=120)
    return Baked(folder, json.loads((folder / "baked.json").read_text()))


def natively(folder: Path, maps: Maps, load: Mapping[str, Any], method: str, **options: Any) -> mipbake.MipStack:
    write_set(folder, {f"{STEMS.get(name, name)}.png": pixels for name, pixels in maps.items()})
    return mipbake.bake(mipbake.load(folder, **load), method, **options)


def check_same(found: list[np.ndarray], wanted: list[np.ndarray]) -> None:
    assert [level.shape for level in found] == [level.shape for level in wanted]
    for level, (one, other) in enumerate(zip(found, wanted, strict=True)):
        off = np.abs(one - other)
        if one.shape[-1] > STRENGTH:
            # What is shaded is the square of the strength, and a direction counts by it.
            counts = other[..., STRENGTH] ** 2
            off[..., STRENGTH] = np.abs(one[..., STRENGTH] ** 2 - counts)
            off[..., DIRECTION] *= counts[..., None]
        assert off.max() <= OFF and (off > NEAR).mean() < 1e-3, (level, off.reshape(-1, off.shape[-1]).max(0))


CASES: Mapping[str, tuple[Maps, Mapping[str, Any], Mapping[str, Any], Mapping[str, Any]]] = {
    "gltf": (material(48, 96), {}, {}, {}),
    "clamped, odd sides": (
        material(61, 97),
        {"wrap": ["clamp", "wrap"], "filter": "box"},
        {"wrap": ("clamp", "wrap")},
        {"pixel_filter": "box"},
    ),
    "anisotropic": (material(64, 64, "anisotropy"), {}, {}, {}),
    "anisotropic of round": (material(40, 56), {"target": "gltf-anisotropic"}, {}, {"target": "gltf-anisotropic"}),
    "round of anisotropic": (material(32, 32, "anisotropy"), {"target": "gltf"}, {}, {"target": "gltf"}),
    "alpha": (material(64, 48, "alpha"), {"alphaCutoff": 0.5}, {"alpha_cutoff": 0.5}, {}),
}
"""Maps, options of the package, and those of `mipbake.load` and of `mipbake.bake` that mean the same."""


@pytest.mark.parametrize("method", ["neural", "linear", "lean"])
@pytest.mark.parametrize("case", CASES)
def test_levels_are_those_of_the_core(case: str, method: str, tmp_path: Path) -> None:
    maps, options, load, native = CASES[case]
    wanted = natively(tmp_path / "set", maps, load, method, **native)
    found = in_javascript(tmp_path / "js", maps, method=method, **options)
    assert (found.about["model"], found.about["weights"]) == (wanted.model, wanted.provenance.weights)
    check_same(found.stored, wanted.levels)
    for level, values in zip(found.levels("baseColor"), wanted.base_color, strict=True):
        assert np.abs(level[..., :3] - np.rint(linear_to_srgb(values.astype(np.float64)) * 255)).max() <= 1


@pytest.mark.parametrize("sampler", ["anisotropic", "accumulated, bias -1", "anisotropic 4x"])
def test_the_network_takes_the_sampler(sampler: str, tmp_path: Path) -> None:
    maps = material(32, 48)
    wanted = natively(tmp_path / "set", maps, {}, "neural", sampler=sampler)
    check_same(in_javascript(tmp_path / "js", maps, sampler=sampler).stored, wanted.levels)


@pytest.mark.parametrize(
    ("maps", "options"),
    [
        (material(48, 96), {}),
        (material(61, 97), {"wrap": ["clamp", "wrap"], "filter": "mitchell"}),
        (material(61, 97), {"wrap": ["wrap", "clamp"], "target": "gltf-anisotropic"}),
        (material(200, 24, "anisotropy"), {"sampler": "anisotropic"}),
        (material(5, 16), {}),
        (material(2, 3), {}),
    ],
)
def test_levels_do_not_depend_on_the_number_of_workers(maps: Maps, options: dict[str, Any], tmp_path: Path) -> None:
    alone, *shared = (in_javascript(tmp_path / str(n), maps, threads=n, **options) for n in (1, 2, 7))
    for baked in shared:
        assert all(np.array_equal(*both) for both in zip(baked.stored, alone.stored, strict=True))


def test_sixteen_bits_and_smaller_maps(tmp_path: Path) -> None:
    maps = dict(material(64, 32))
    maps["roughness"] = (maps["roughness"][::2, ::2].astype(np.uint16) * 257) + 100
    wanted = natively(tmp_path / "set", maps, {}, "lean")
    found = in_javascript(tmp_path / "js", maps, method="lean")
    check_same(found.stored, wanted.levels)
    assert found.levels("roughness")[0].dtype == np.uint16
    for level, values in zip(found.levels("roughness"), wanted.roughness, strict=True):
        assert np.abs(level - np.rint(values.astype(np.float64) * 65535)).max() <= 1


def test_maps_that_do_not_shade_are_averaged_and_alpha_keeps_its_coverage(tmp_path: Path) -> None:
    maps = material(60, 44, "alpha", "occlusion", "emissive")
    wanted = natively(tmp_path / "set", maps, {"alpha_cutoff": 0.4}, "linear")
    found = in_javascript(tmp_path / "js", maps, method="linear", alphaCutoff=0.4)
    assert set(wanted.extra) == {"occlusion", "emissive", "opacity"}
    for name, role in (("occlusion", "occlusion"), ("emissive", "emissive"), ("baseColor", "opacity")):
        for level, values in zip(found.levels(name), wanted.extra[role], strict=True):
            given = values.astype(np.float64)
            stored = np.floor((linear_to_srgb(given) if role == "emissive" else given) * 255 + 0.5)
            assert np.array_equal(level[..., 3:] if role == "opacity" else level, stored)


def test_textures_are_those_of_the_tool(tmp_path: Path) -> None:
    maps = material(64, 36, "alpha")
    names = {"baseColor": "base_color", "normal": "normal", "roughness": "roughness"}
    in_javascript(tmp_path / "js", maps, tuple(names), method="linear")
    stack = natively(tmp_path / "set", maps, {}, "linear")
    stack.save(tmp_path / "py", "ktx2:uastc")
    for name, stem in names.items():
        files = tmp_path / "js" / f"{name}.ktx2", tmp_path / "py" / f"{STEMS.get(name, stem)}.ktx2"
        one, other = (ktx2.decoded(file.read_bytes(), name) for file in files)
        assert (one.format, one.width, one.height, len(one.levels)) == (other.format, 36, 64, 7)
        assert same_blocks([one], [other]) > NEARLY_ALL


def same_blocks(ones: Iterable[GpuTexture], others: Iterable[GpuTexture]) -> float:
    """The share of blocks that are the same in all levels of textures."""
    same = []
    for one, other in zip(ones, others, strict=True):
        assert one.format == other.format
        for mine, theirs in zip(one.levels, other.levels, strict=True):
            same.append(np.frombuffer(mine, "V16") == np.frombuffer(theirs, "V16"))
    return float(np.concatenate(same).mean())


# ---- glTF


def plain_glb(folder: Path) -> Path:
    """Many materials, without what no decoder is at hand for."""
    made: GltfFile = many_materials()
    for mesh in made.json["meshes"]:
        for primitive in mesh["primitives"]:
            primitive.pop("extensions", None)
    for each in made.json["materials"]:
        each.get("extensions", {}).pop("EXT_example", None)
    for name in ("KHR_draco_mesh_compression", "EXT_example"):
        made.json["extensionsUsed"].remove(name)
    folder.mkdir(parents=True, exist_ok=True)
    return made.write(folder / "scene")


def command(*arguments: object) -> subprocess.CompletedProcess[str]:
    given = ["node", str(COMMAND), *map(str, arguments)]
    return subprocess.run(given, capture_output=True, text=True, timeout=120, check=False)


def textures_of(document: Document) -> dict[tuple[int, str], bytes]:
    """The KTX 2 files of a document by material and slot."""
    found = {}

    def walk(index: int, node: dict[str, Any]) -> None:
        for key, value in node.items():
            if isinstance(value, dict) and "index" in value:
                data, kind = stored_image(document, source_of(document, value["index"], key))
                if kind is KTX2:
                    found[index, key] = data
            elif isinstance(value, dict):
                walk(index, value)

    for index, each in enumerate(document.all("materials")):
        walk(index, each)
    return found


@needs_packages
def test_the_command_writes_what_the_python_tool_writes(tmp_path: Path) -> None:
    source, out = plain_glb(tmp_path / "in"), tmp_path / "out.glb"
    said = command(source, out)
    assert said.returncode == 0, said.stderr
    assert re.fullmatch(r"\S+out\.glb: 9 of 14 materials baked, .* in, .* out, .* s\n", said.stdout), said.stdout
    assert main(["bake", str(source), "-o", str(tmp_path / "py"), "--method", "neural"]) == 0
    made, wanted = (read_document(path) for path in (out, tmp_path / "py" / "scene.glb"))
    found, expected = textures_of(made), textures_of(wanted)
    # The Python tool also converts materials in specular and glossiness.
    names = [each.get("name") for each in wanted.all("materials")]
    expected = {key: data for key, data in expected.items() if names[key[0]] != "Glossy"}
    assert found.keys() == expected.keys() and len(found) > 20
    both = ([ktx2.decoded(each[key], str(key)) for key in found] for each in (found, expected))
    assert same_blocks(*both) > NEARLY_ALL
    for one, other, name in zip(made.all("materials"), wanted.all("materials"), names, strict=True):
        if name == "Glossy":
            continue
        of = [each.get("pbrMetallicRoughness", {}) for each in (one, other)]
        assert of[0].get("roughnessFactor", 1) == pytest.approx(of[1].get("roughnessFactor", 1), abs=2e-6)
        assert of[0].get("metallicFactor", 1) == of[1].get("metallicFactor", 1)
        scales = [each.get("normalTexture", {}).get("scale", 1) for each in (one, other)]
        assert scales[0] == pytest.approx(scales[1], abs=2e-6)


@needs_packages
@pytest.mark.long
def test_engines_load_what_the_command_writes(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("playwright.sync_api", reason="playwright is not installed (the extra `checks`)")
    if not (ENGINES / "node_modules").is_dir():
        pytest.skip("the npm packages are not installed (npm ci --prefix benchmarks/engines)")
    if not any(shutil.which(name) for name in ("chromium", "chromium-browser", "google-chrome")):
        pytest.skip("Chromium is not installed")
    out = tmp_path / "out.glb"
    assert command(plain_glb(tmp_path), out).returncode == 0
    monkeypatch.syspath_prepend(ENGINES)
    monkeypatch.setattr(sys, "argv", ["gltf_proof.py", str(out)])
    assert importlib.import_module("gltf_proof").main() == 0


@needs_packages
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["in.glb"], "expected an input and an output file"),
        (["missing.glb", "out.glb"], "missing.glb cannot be read"),
        (["in.glb", "no/out.glb"], "no is no folder"),
        (["in.glb", "out.zip"], "does not end in .glb"),
        (["notes.glb", "out.glb"], "notes.glb cannot be read"),
        (["in.glb", "out.glb", "--method", "magic"], 'unknown method "magic": expected neural, linear, lean'),
        (["in.glb", "out.glb", "--sampler", "cubic"], 'unknown sampler "cubic"'),
        (["in.glb", "out.glb", "--threads", "two"], "threads is NaN: expected a whole number of at least 1"),
        (["in.glb", "out.glb", "--sizes", "3"], "Unknown option '--sizes'"),
        (["bare.glb", "out.glb"], "bare.glb has no material to bake"),
        (["torn.glb", "out.glb"], "cannot be decoded"),
        (["in.glb", "./in.glb"], "is the input"),
        (["draco.glb", "out.glb"], "geometry that is compressed (KHR_draco_mesh_compression)"),
    ],
)
def test_errors_are_one_sentence_and_nothing_is_written(arguments, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    plain_glb(tmp_path).rename("in.glb")
    Path("notes.glb").write_text("nothing but words")
    bare = GltfFile()
    bare.material("Grey")
    bare.squares()
    bare.json["meshes"][0]["primitives"][0].pop("extensions")
    bare.json["extensionsUsed"] = []
    bare.write(Path("bare"))
    torn = GltfFile()
    torn.texture(torn.image(b"\x89PNG\r\n\x1a\n" + bytes(40), "torn"))
    torn.material("Torn", normalTexture={"index": 0})
    torn.write(Path("torn"))
    many_materials().write(Path("draco"))
    before = sorted(Path().iterdir())
    said = command(*arguments)
    assert said.returncode == 2 and says in said.stderr
    assert said.stderr.startswith("mipbake: ") and said.stderr.count("\n") == 1
    assert not said.stdout and sorted(Path().iterdir()) == before


# ---- the package


def test_the_tests_of_the_package_pass() -> None:
    ran = subprocess.run(["node", "--test", "test/"], cwd=WEB, capture_output=True, text=True, timeout=300, check=False)
    assert ran.returncode == 0, ran.stdout[-4000:]


@needs_packages
def test_types_fit() -> None:
    ran = subprocess.run(
        ["node", "node_modules/typescript/bin/tsc", "-p", "."], cwd=WEB, capture_output=True, text=True, check=False
    )
    assert ran.returncode == 0, ran.stdout


def test_versions_and_methods_are_those_of_the_tool() -> None:
    package = json.loads((WEB / "package.json").read_text())
    assert package["version"] == __version__
    assert f"'{__version__}'" in (WEB / "src" / "version.js").read_text()
    known = subprocess.run(
        ["node", "-e", "import('./src/index.js').then((m) => console.log(JSON.stringify([m.METHODS, m.FILTERS])))"],
        cwd=WEB, capture_output=True, text=True, check=True,
    )  # fmt: skip
    methods, filters = json.loads(known.stdout)
    assert set(methods) <= set(METHODS) and filters == list(FILTERS)
