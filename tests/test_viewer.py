"""The interactive view: its pages. test_viewer_browser.py opens them."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.comparing.viewer import DEFAULT_LIGHTS, LightSet, Source, viewer_fragment, viewer_page
from mipbake.material import MODELS
from mipbake.stack.stack import MipStack

from .viewer_scenes import PROVENANCE, material, scene_of, stack_of, texels_of


@pytest.mark.parametrize("model", MODELS)
def test_every_stored_channel_of_every_level_is_on_the_page(model: str) -> None:
    stack = stack_of(material(model), model)
    packed = scene_of(viewer_fragment({"a": stack}, half=True))["stacks"][0]
    maps = [texels_of(packed, index) for index in range(len(packed["maps"]))]
    held = [np.concatenate(parts, -1) for parts in zip(*maps, strict=True)]
    for level, values in zip(stack.levels, held, strict=True):
        for channel in range(MODELS[model].channels):
            wanted = level[..., channel].astype(np.float16).astype(np.float32)
            assert any(np.array_equal(wanted, values[..., slot]) for slot in range(values.shape[-1])), channel


def test_eight_bits_are_those_of_8_bit_files() -> None:
    stored = np.array([[[0.5, 0.0, 1.0, 1.0, 0.2, 0.0, 0.6, 0.8]]], np.float32)
    packed = scene_of(viewer_fragment({"a": MipStack("a", "gltf", [stored], {}, ("wrap", "wrap"), PROVENANCE)}))[
        "stacks"
    ][0]
    assert not packed["half"] and [m["srgb"] for m in packed["maps"]] == [True, False]
    assert (255 * texels_of(packed, 0)[0]).round().tolist() == [[[188, 0, 255, 255]]]  # sRGB of 0.5 is 0.7354
    assert (255 * texels_of(packed, 1)[0]).round().tolist() == [[[128, 204, 230, 51]]]


def test_logarithms_are_half_floats_whatever_is_asked_for() -> None:
    assert scene_of(viewer_fragment({"a": stack_of(material("ggx"), "ggx")}))["stacks"][0]["half"]


def test_a_page_is_self_contained_and_escapes_what_it_is_given() -> None:
    page = viewer_page("a < b & </script>", {"</script><b>": stack_of(material("gltf", 4, 4), "gltf")})
    assert "<title>a &lt; b &amp; &lt;/script&gt;</title>" in page
    assert not re.search(r"https?://|<link|src=|@import|url\(", page)
    assert page.count("</script>") == 2 and page.count("<script") == 2
    assert scene_of(page)["stacks"][0]["name"] == "</script><b>"


def test_pages_of_the_same_stacks_are_the_same() -> None:
    stack = stack_of(material("gltf", 8, 8), "gltf")
    assert viewer_page("t", {"a": stack}) == viewer_page("t", {"a": stack})


def test_default_lights_are_unit_directions() -> None:
    for lights in DEFAULT_LIGHTS:
        np.testing.assert_allclose(np.linalg.norm(lights.directions, axis=-1), 1, atol=1e-12)
        assert lights.directions.shape == lights.radiance.shape


UP = np.array([[0.0, 1.0, 0.0]])


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"stacks": {}}, "no stack"),
        ({"lights": []}, "no light set"),
        ({"lights": [LightSet("many", np.repeat(UP, 65, 0), np.ones((65, 3)))]}, "K from 1 to 64"),
        ({"lights": [LightSet("grey", UP, np.ones((1, 1)))]}, "'grey' has directions"),
        ({"lights": [LightSet("long", 2 * UP, np.ones((1, 3)))]}, "'long' is expected to have unit directions"),
        ({"lights": [LightSet("dark", UP, -np.ones((1, 3)))]}, "'dark' is expected to have unit directions"),
        ({"source": Source(np.zeros((4, 4, 7), np.float32), "gltf")}, r"source is \(4, 4, 7\): expected \(H, W, 8\)"),
        ({"source": Source(np.full((4, 4, 8), np.nan, np.float32), "gltf")}, "finite numbers"),
        ({"source": Source(np.zeros((4, 4, 8), np.float32), "phong")}, "unknown material model 'phong'"),
        ({"pixel_filter": "sinc"}, "unknown pixel filter 'sinc'"),
    ],
)
def test_what_does_not_fit_is_said_in_a_sentence(arguments: dict[str, Any], sentence: str) -> None:
    stacks = {"a": stack_of(material("gltf", 4, 4), "gltf")}
    with pytest.raises(UsageError, match=sentence):
        viewer_fragment(**{"stacks": stacks, **arguments})


@pytest.mark.skipif(shutil.which("node") is None, reason="node is not installed")
def test_scripts_parse() -> None:
    folder = Path(sys.modules["mipbake.comparing.viewer"].__file__ or "").parent
    for script in sorted(folder.glob("*.js")):
        subprocess.run(["node", "--check", str(script)], check=True)
