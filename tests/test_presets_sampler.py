"""Presets know the sampler of their engine, and stacks that were made for another one are told."""

from __future__ import annotations

import warnings
from dataclasses import replace
from pathlib import Path

import pytest

import mipbake
from mipbake.material.aim import SAMPLERS
from mipbake.stack.presets import PRESETS

from . import packed_sets
from .test_presets import run


@pytest.mark.parametrize("name", PRESETS)
def test_a_stack_for_another_sampler_is_told(name: str, tmp_path: Path) -> None:
    """Stacks for one sampler are saved for an engine that has the other one; closed forms are for both."""
    plain = mipbake.bake(mipbake.load(packed_sets.orm(tmp_path / "wood")), method="linear", target="gltf")
    for made_for in (*SAMPLERS.values(), None):
        stack = replace(plain, provenance=replace(plain.provenance, sampler=made_for))
        with warnings.catch_warnings(record=True) as told:
            warnings.simplefilter("always")
            stack.save(tmp_path / str(made_for), "png", preset=name)
        said = [str(each.message) for each in told if "sampler" in str(each.message)]
        assert len(said) == (made_for not in (None, PRESETS[name].sampler))
        assert all(f"with the sampler {PRESETS[name].sampler}, this stack was made for {made_for}" in s for s in said)


def test_the_command_line_tells_it_too(tmp_path: Path) -> None:
    source = packed_sets.orm(tmp_path / "wood")
    for sampler, told in (("trilinear", True), ("anisotropic", False)):
        code, said = run(
            "bake", source, "-o", tmp_path / sampler, "--method", "neural", "--preset", "unity", "--sampler", sampler
        )
        assert code in (0, 1)  # 1 where a set of so few texels has levels that do not fit together
        assert ("this stack was made for trilinear" in " ".join(said.split())) == told
