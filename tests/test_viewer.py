"""The interactive view: its pages. test_viewer_browser.py opens them."""

from __future__ import annotations

import re

import numpy as np
import pytest

from mipbake.base.errors import UsageError
from mipbake.comparing.viewer import TRUTH, viewer_fragment
from mipbake.material import MODELS
from mipbake.material.filtered_source import FilteredSource
from mipbake.stack.stack import MipStack

from .viewer_scenes import PROVENANCE, material, scene_of, stack_of, texels_of


@pytest.mark.parametrize("model", MODELS)
def test_every_stored_channel_of_every_level_is_on_the_page(model: str) -> None:
    stack = stack_of(material(model, 12, 16), model)
    (textures,) = texels_of(scene_of(viewer_fragment({"a": stack}, half=True)))
    for level, held in zip(stack.levels, textures, strict=True):
        values = np.concatenate(held, -1)
        for channel in range(MODELS[model].channels):
            wanted = level[..., channel].astype(np.float16).astype(np.float32)
            assert any(np.array_equal(wanted, values[..., slot]) for slot in range(values.shape[-1])), channel


def test_eight_bits_are_those_of_8_bit_files() -> None:
    stored = np.array([[[0.5, 0.0, 1.0, 1.0, 0.2, 0.0, 0.6, 0.8]]], np.float32)
    scene = scene_of(viewer_fragment({"a": MipStack("a", "gltf", [stored], {}, ("wrap", "wrap"), PROVENANCE)}))
    assert not scene["images"][0]["half"] and scene["images"][0]["srgb"] == [True, False]
    (((colours, others),),) = texels_of(scene)
    assert (255 * colours).round().tolist() == [[[188, 0, 255, 255]]]  # sRGB of 0.5 is 0.7354
    assert (255 * others).round().tolist() == [[[128, 204, 230, 51]]]


@pytest.mark.parametrize("size", [(16, 16), (6, 10)])  # halved exactly, and not
def test_stacks_that_are_alike_are_packed_by_their_difference_and_unpacked_exactly(size: tuple[int, int]) -> None:
    level = material("gltf", *size)
    stacks = {name: stack_of((level * scale).astype(np.float32), "gltf") for name, scale in (("a", 1.0), ("b", 0.9))}
    stacks["c"] = stack_of(material("ggx", *size), "ggx")
    source = FilteredSource(level, "gltf", ("wrap", "wrap"), "gaussian")
    scene = scene_of(viewer_fragment(stacks, source))
    held = texels_of(scene)
    assert [image["name"] for image in scene["images"]] == [TRUTH, "a", "b", "c"] and scene["source"]
    assert all(np.array_equal(*both) for both in zip(held[0][0], held[1][0], strict=True))
    for name, found in zip("ab", held[1:3], strict=True):
        alone = texels_of(scene_of(viewer_fragment({name: stacks[name]})))[0]
        for here, there in zip(found, alone, strict=True):
            assert all(np.array_equal(*both) for both in zip(here, there, strict=True))


def test_logarithms_are_half_floats_whatever_is_asked_for() -> None:
    assert scene_of(viewer_fragment({"a": stack_of(material("ggx"), "ggx")}))["images"][0]["half"]


def test_a_fragment_is_self_contained_and_escapes_what_it_is_given() -> None:
    fragment = viewer_fragment({"</script><b>": stack_of(material("gltf", 4, 4), "gltf")})
    assert not re.search(r"https?://|<link|src=|@import|url\(", fragment)
    assert fragment.count("</script>") == 2 and fragment.count("<script") == 2
    assert scene_of(fragment)["images"][0]["name"] == "</script><b>"


def test_what_does_not_fit_is_said_in_a_sentence() -> None:
    stacks = {"a": stack_of(material("gltf", 4, 4), "gltf")}
    for arguments, sentence in (
        ((stacks, FilteredSource(np.zeros((4, 4, 8), np.float32), "phong", ("wrap", "wrap"), "box")), "model 'phong'"),
        ((stacks, FilteredSource(np.zeros((4, 4, 8), np.float32), "gltf", ("wrap", "wrap"), "sinc")), "filter 'sinc'"),
    ):
        with pytest.raises(UsageError, match=sentence):
            viewer_fragment(*arguments)
