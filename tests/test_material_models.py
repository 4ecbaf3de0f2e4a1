"""The descriptions of material models: every field of every model is filled, and every reader takes every model.

What is computed with them is tested beside what computes it.
"""

from __future__ import annotations

import ast
import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from mipbake.baking.methods import METHODS
from mipbake.baking.search import texel_coordinates
from mipbake.comparing.cautions import limits
from mipbake.comparing.viewer import texel_bytes, viewer_fragment
from mipbake.material import FACTS, MODELS, Kind, MaterialModel, convert, directions, losses, regularise
from mipbake.models import parameters
from mipbake.models.latent_config import LatentConfig
from mipbake.shading import models, reference
from mipbake.source.layout import ENCODINGS, LAYOUTS

from .stacks import gltf_level
from .viewer_scenes import scene_of, stack_of

PAIRS = list(itertools.product(MODELS, MODELS))
ROOT = Path(__file__).resolve().parent.parent


def texels(model: str) -> np.ndarray:
    """(16, 16, C) float32: a bumpy anisotropic material, as the model holds it."""
    given = convert(gltf_level((16, 16), anisotropic=True), "gltf-anisotropic", model)
    return regularise(given, model).astype(np.float32)


# ---- kinds


def test_every_kind_has_its_facts() -> None:
    assert set(FACTS) == set(Kind)
    for facts in FACTS.values():
        assert facts.channels >= facts.coordinates >= 1 and facts.step > 0
        assert facts.limits[0] < facts.limits[1] and facts.range[0] < facts.range[1]
        assert facts.encoding in ENCODINGS
        assert facts.unit_axis is None or 0 <= facts.unit_axis < facts.channels
        assert not facts.as_stored or facts.channels == facts.coordinates


@pytest.mark.parametrize("kind", Kind)
def test_every_kind_has_coordinates(kind: Kind) -> None:
    facts = FACTS[kind]
    stored = torch.full((4, facts.channels), 0.3)
    if facts.unit_axis is not None:
        stored = torch.nn.functional.normalize(stored, dim=-1)
    coordinates = parameters.to_coordinates(stored, kind)
    assert coordinates.shape == (4, facts.coordinates)
    assert (coordinates is stored) == facts.as_stored
    back = parameters.of_coordinates(coordinates, kind, 1e-6)
    assert torch.allclose(back, stored, atol=1e-6)
    low, high = facts.range
    assert ((coordinates >= low) & (coordinates <= high)).all()


# ---- descriptions


def test_every_model_is_known_to_the_core_and_has_its_plain_twin() -> None:
    assert list(MODELS) == [model.name for model in MODELS.values()]
    assert models() == {name: model.channels for name, model in MODELS.items()}
    assert set(reference.MODELS) == set(MODELS)


@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_lengths_agree(model: MaterialModel) -> None:
    channels = list(range(model.channels))

    def held(slices: Any) -> list[int]:
        return [i for group in slices for i in range(group.start, group.stop)]

    assert held(model.maps.values()) == channels
    assert held(part.channels for part in model.parts) == channels
    assert held(part.coordinates for part in model.parts) == list(range(model.coordinates))
    assert held(part.parameters for part in model.parts) == list(range(model.parameters))
    assert len(model.limits) == model.channels
    assert model.normal.stop - model.normal.start in (2, 3)
    assert [each for maps in model.files.values() for each in maps] == list(model.stored)
    assert held(layout.channels for layout in LAYOUTS[model.name]) == channels
    for layout in LAYOUTS[model.name]:
        assert len(layout.encodings) == len(layout.meanings) == layout.channels.stop - layout.channels.start
        assert len(layout.alone.channels) <= 4


# ---- readers of descriptions


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_every_pair_converts(source: str, target: str) -> None:
    stored = texels(source)
    found = convert(stored, source, target)
    assert found.shape == (16, 16, MODELS[target].channels) and found.dtype == np.float32
    assert found == pytest.approx(regularise(found, target), abs=1e-4)
    back = convert(found, target, source)
    if not losses(source, target).blind and not any(losses(target, source)[:4]):
        assert back == pytest.approx(stored, abs=2e-3)


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_losses_are_said_and_steer_networks(source: str, target: str) -> None:
    lost = losses(source, target)
    assert len(limits(source, target, True)) == 1 + lost.anisotropy + lost.lobe + (
        lost.diffuse and MODELS[source].coated
    )
    one = LatentConfig(encoders=(target,), decoders=(target,))
    assert one.read_as(source) == target
    assert one.reads(source) == (not lost.blind)
    assert all(one.made_from(each) == target for each in one.targets)


@pytest.mark.parametrize("name", MODELS)
def test_what_a_model_stores_of_a_tensor_gives_the_tensor(name: str) -> None:
    model, stored = MODELS[name], texels(name).astype(np.float64)
    tensor = model.roughness_tensor(stored)
    assert tensor.shape[-1] == (3 if model.anisotropic else 1)
    again = stored.copy()
    for kind, channels in model.of_tensor(tensor).items():
        (group,) = model.of(kind)
        again[..., group] = channels
    assert model.roughness_tensor(again) == pytest.approx(tensor, rel=1e-5, abs=1e-9)
    round_lobe = {kind: channels.shape[-1] for kind, channels in model.of_tensor(np.full((4, 1), 0.01)).items()}
    assert round_lobe == {kind: FACTS[kind].channels for kind in round_lobe}
    assert np.linalg.norm(model.unit_normals(stored), axis=-1) == pytest.approx(1, abs=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_coordinates_of_every_model(name: str) -> None:
    """Their units, their limits, and derivatives of each by itself."""
    stored = texels(name).astype(float)
    coordinates = texel_coordinates.to_coordinates(stored, name)
    assert coordinates.shape[-1] == MODELS[name].coordinates
    at = texel_coordinates.to_stored(coordinates, name)
    assert np.allclose(at, stored, atol=1e-3)
    assert (texel_coordinates.units(coordinates, name) > 0).all()
    low, high = texel_coordinates.limits(coordinates, name)
    assert ((coordinates >= low) & (coordinates <= high)).all()
    by_channel = np.random.default_rng(0).standard_normal(stored.shape)
    for group in MODELS[name].of(Kind.DIRECTION):
        by_channel[..., group] = 0  # vectors that are made unit have other derivatives
    wanted = texel_coordinates.stored_adjoint(coordinates, by_channel, name)
    found = texel_coordinates.without_heights(by_channel, at, name) * texel_coordinates.per_coordinate(
        coordinates, name
    )
    inside = [i for part in MODELS[name].parts if part.kind is not Kind.LOG_TENSOR for i in _range(part.coordinates)]
    assert np.allclose(found[..., inside], wanted[..., inside], rtol=1e-6, atol=1e-9)


def _range(part: slice) -> range:
    return range(part.start, part.stop)


@pytest.mark.parametrize(("source", "target"), PAIRS)
def test_every_closed_form_takes_every_pair(source: str, target: str) -> None:
    for method in ("lean", "toksvig", "linear"):
        levels = METHODS[method](texels(source), source, target, "box", ("wrap", "clamp"), lambda _: None).levels
        assert [level.shape for level in levels] == [(1 << n, 1 << n, MODELS[target].channels) for n in (4, 3, 2, 1, 0)]
        low, high = np.array(MODELS[target].limits).T
        assert all(((level >= low) & (level <= high)).all() for level in levels)


@pytest.mark.parametrize("name", MODELS)
def test_signs_agree_where_a_model_has_lines(name: str) -> None:
    levels = stack_of(texels(name), name).levels
    given, wrap = [torch.from_numpy(level[None]) for level in levels], ("wrap", "wrap")
    assert (directions.agreeing(levels, name, wrap) is levels) == (MODELS[name].lines is None)
    assert (parameters.agreeing(given, name, wrap) is given) == (MODELS[name].lines is None)
    assert directions.led(levels, name)[0] is levels[0]


@pytest.mark.parametrize("name", MODELS)
def test_the_view_shows_every_model(name: str) -> None:
    fragment = viewer_fragment({"a": stack_of(texels(name), name)})
    packed = scene_of(fragment)["images"][0]
    assert texel_bytes(name) == len(packed["srgb"]) * (8 if packed["half"] else 4)
    for textures, srgb in zip(MODELS[name].view.textures, packed["srgb"], strict=True):
        assert srgb == any(group.start == textures[0] for group in MODELS[name].of(Kind.REFLECTANCE))
    assert f'"{name}": ' in fragment and "const SURFACE_OF_MODEL" in fragment


# ---- nobody asks for the name of a model

BY_NAME = {
    "mipbake/fitting/gl.py": (1, "names of shaders, of which one shades as glTF says"),
    "mipbake/source/intake.py": (1, "kinds of inputs, of which one is a glTF document"),
    "mipbake/source/inputs.py": (2, "kinds of inputs, of which one is a glTF document"),
    "mipbake/stack/presets.py": (1, "what engines read is a fact about engines"),
    "mipbake/shading/reference.py": (4, "the list of plain twins; a test compares it with the list of models"),
    "mipbake/baking/search/pixel_samples.py": (1, "PLAIN, which steers the search whatever the target is"),
    "training/captured.py": (1, "MODEL, of the sets that are made there"),
    "training/procedural.py": (1, "MODEL, of the sets that are made there"),
}
"""File to the number of names in it, and why they stand there."""


def names_of_models(source: str) -> list[int]:
    """Lines that hold the name of a model. What a parameter or a field is unless it is given may be a name."""
    tree = ast.parse(source)
    given: set[ast.AST] = set()
    for node in ast.walk(tree):
        defaults: list[ast.AST | None] = []
        if isinstance(node, ast.arguments):
            defaults = [*node.defaults, *node.kw_defaults]
        elif isinstance(node, ast.ClassDef):
            defaults = [each.value for each in node.body if isinstance(each, ast.AnnAssign)]
        given.update(leaf for each in defaults if each for leaf in ast.walk(each))
    named = (node for node in ast.walk(tree) if isinstance(node, ast.Constant) and node.value in MODELS)
    return sorted(node.lineno for node in named if node not in given)


@pytest.mark.long
def test_no_code_asks_for_a_model_by_its_name() -> None:
    """A fork by name, or a table by names, treats the next model as another one. Descriptions know what to ask for."""
    found = {}
    for room in ("mipbake", "models", "training", "cli"):
        for path in sorted((ROOT / room).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if not name.startswith("mipbake/material/") and (lines := names_of_models(path.read_text("utf-8"))):
                found[name] = lines
    assert {name: len(lines) for name, lines in found.items()} == {n: count for n, (count, _) in BY_NAME.items()}, found
