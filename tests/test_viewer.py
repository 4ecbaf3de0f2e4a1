"""The interactive view: its pages. test_viewer_browser.py opens them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.comparing.viewer import viewer_fragment
from mipbake.material import MODELS
from mipbake.material.filtered_source import FilteredSource
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


def test_a_fragment_is_self_contained_and_escapes_what_it_is_given() -> None:
    fragment = viewer_fragment({"</script><b>": stack_of(material("gltf", 4, 4), "gltf")})
    assert not re.search(r"https?://|<link|src=|@import|url\(", fragment)
    assert fragment.count("</script>") == 2 and fragment.count("<script") == 2
    assert scene_of(fragment)["stacks"][0]["name"] == "</script><b>"


def test_what_does_not_fit_is_said_in_a_sentence() -> None:
    stacks = {"a": stack_of(material("gltf", 4, 4), "gltf")}
    for arguments, sentence in (
        (({},), "no stack"),
        ((stacks, FilteredSource(np.zeros((4, 4, 8), np.float32), "phong", ("wrap", "wrap"), "box")), "model 'phong'"),
        ((stacks, FilteredSource(np.zeros((4, 4, 8), np.float32), "gltf", ("wrap", "wrap"), "sinc")), "filter 'sinc'"),
    ):
        with pytest.raises(UsageError, match=sentence):
            viewer_fragment(*arguments)
