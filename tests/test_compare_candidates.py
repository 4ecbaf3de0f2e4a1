"""What is compared: names, both forms of closed forms, levels in memory or in files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import mipbake
from mipbake import OutputError, TextureSet, UsageError
from mipbake.baking.methods import METHODS
from mipbake.baking.pipeline import Recipe
from mipbake.comparing.candidates import (
    bake_all,
    check_options,
    chosen,
    closed_forms,
    default_names,
    label,
    mismatch,
)
from mipbake.comparing.cautions import limits, made_for_others
from mipbake.material.aim import ANISOTROPIC, Sampler
from mipbake.quality.figures import Method
from mipbake.quality.samplers import render_sampler
from mipbake.quality.texture_space import MeasureEffort, measure

from .no_default_weights import hide_defaults


def noisy(height: int = 32, width: int = 32, seed: int = 0) -> TextureSet:
    rng = np.random.default_rng(seed)
    normal = np.concatenate([0.3 * rng.standard_normal((height, width, 2)), np.ones((height, width, 1))], -1)
    return TextureSet.from_arrays("noisy", normal=normal, roughness=rng.uniform(0.2, 0.6, (height, width)))


def test_names_stand_for_forms_with_the_box_and_with_the_pixel_filter() -> None:
    forms = closed_forms("gaussian")
    assert {("linear", "box"), ("linear", "gaussian"), ("unreal", "box"), ("lean", "gaussian")} <= set(forms)
    assert len(forms) == 2 * sum(method.averages for method in METHODS.values()) == 2 * len(closed_forms("box"))
    assert label("neural", "gaussian") == "neural"
    assert chosen(["neural", "lean"], "tent") == {
        "neural": ("neural", "tent"), "lean (box)": ("lean", "box"), "lean (tent)": ("lean", "tent"),
    }  # fmt: skip
    assert list(chosen(["lean (mitchell)", "lean"], "box")) == ["lean (mitchell)", "lean (box)"]
    for name in ("polish", "lean (polish)", "neural (box)", "lean(box)", ""):
        with pytest.raises(UsageError, match=r"(expected one of |Methods: ).*linear.*'lean \(box\)'"):
            chosen(["linear", name], "gaussian")


def test_neural_is_left_out_where_it_has_no_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    names, notes = default_names("gltf", "gltf", "gaussian")
    assert names[:2] == ("auto", "neural")
    assert default_names("gltf", "gltf", "gaussian", opened=True)[0] == names[1:]
    assert notes == ()
    hide_defaults(monkeypatch)
    names, notes = default_names("gltf", "beckmann", "mitchell")
    assert "neural" not in names
    assert "linear (mitchell)" in names
    assert "left out: no trained weights" in notes[0]


def test_levels_in_files_measure_like_levels_in_memory(tmp_path: Path) -> None:
    texture_set = noisy(1024, 64)
    names = ["linear", "lean (box)"]
    reported: list[float] = []
    figures = []
    for limit in (1 << 30, 0):
        with bake_all(
            texture_set, Recipe(target="gltf"), names, lambda _, share: reported.append(share), limit, tmp_path
        ) as candidates:
            assert [each.name for each in candidates] == ["linear (box)", "linear (gaussian)", "lean (box)"]
            assert isinstance(candidates[0].levels[0], np.memmap) == (limit == 0)
            assert any(tmp_path.iterdir()) == (limit == 0)
            expected = mipbake.bake(texture_set, "linear", "gltf", "gaussian").levels
            assert all(np.array_equal(a, b) for a, b in zip(candidates[1].levels, expected, strict=True))
            assert all(each.method.seconds and each.method.seconds > 0 for each in candidates)
            figures.append(
                measure(
                    texture_set.filtered("gaussian"), candidates, (0, 2), (), MeasureEffort(points=64, samples=4)
                ).curve
            )
    assert figures[0] == figures[1]
    assert not any(tmp_path.iterdir())
    assert max(reported) == 1.0
    assert reported.count(1.0) == 2


def test_stacks_are_made_for_a_sampler_and_on_a_device_by_methods_that_take_one() -> None:
    names = ["neural", "linear (box)"]
    with bake_all(noisy(), Recipe(target="gltf", sampler=ANISOTROPIC, device="cpu"), names) as candidates:
        assert [each.method.sampler for each in candidates] == [ANISOTROPIC, None]
    with (
        pytest.raises(UsageError, match="unknown device 'gpu'"),
        bake_all(noisy(), Recipe(target="gltf", device="gpu"), ["neural"]),
    ):
        pass


def test_an_aim_and_a_device_that_nothing_takes_are_refused() -> None:
    check_options(["linear", "auto"], Recipe(aim=1.0, device="cpu"))
    check_options(["linear"], Recipe())
    with pytest.raises(UsageError, match=r"no method that is baked takes an aim: .* one of auto, refine"):
        check_options(["linear", "neural"], Recipe(aim=1.0))
    with pytest.raises(UsageError, match=r"no method that is baked takes a device: .* one of auto, neural, refine"):
        check_options(["linear", "optimum"], Recipe(device="cpu"))
    with pytest.raises(UsageError, match="expected a number from 0"):
        check_options(["auto"], Recipe(aim=-1.0))
    with pytest.raises(UsageError, match="unknown device 'gpu'"):
        check_options(["auto"], Recipe(device="gpu"))


def test_stacks_for_another_sampler_are_named() -> None:
    methods = [
        Method("baked", "auto", "gaussian", "gltf", sampler=ANISOTROPIC),
        Method("neural", "neural", "gaussian", "gltf", sampler=Sampler(bias=-1.0)),
        Method("linear (box)", "linear", "box", "gltf"),
    ]
    for sampler in ("trilinear", "stochastic"):
        first, second = made_for_others(methods, render_sampler(sampler))
        assert first.startswith("baked was made for the sampler anisotropic, and stacks were looked up with")
        assert f"the sampler {sampler}: with --sampler anisotropic the" in first
        assert "neural was made" in second and "--sampler 'trilinear, bias -1' the" in second
    (said,) = made_for_others(methods, ANISOTROPIC)
    assert said.startswith("neural was made for the sampler trilinear, bias -1,")


def test_temporary_files_are_removed_when_a_comparison_fails_and_need_a_folder(tmp_path: Path) -> None:
    with (
        pytest.raises(RuntimeError, match="elsewhere"),
        bake_all(noisy(512, 256), Recipe(), ["linear"], memory_limit=0, folder=tmp_path),
    ):
        assert any(tmp_path.iterdir())
        raise RuntimeError("elsewhere")
    assert not any(tmp_path.iterdir())
    with (
        pytest.raises(OutputError, match=r"cannot write temporary files in .*none: No such file"),
        bake_all(noisy(), Recipe(), ["linear"], memory_limit=0, folder=tmp_path / "none"),
    ):
        pass


def test_a_stack_of_another_set_is_said() -> None:
    stack = mipbake.bake(noisy(), "linear")
    assert mismatch(stack, noisy()) is None
    assert "source hashes differ" in str(mismatch(stack, noisy(seed=1)))
    assert "it measures 32 x 32, and the set measures 64 x 16" in str(mismatch(stack, noisy(16, 64)))


def test_a_report_says_what_figures_leave_out() -> None:
    (plain,), (opened_one,) = limits("gltf", "gltf", False), limits("gltf", "gltf", True)
    assert "32-bit floats, not in the 8 bits" in plain and opened_one.startswith("baked was measured as its files")
    assert len(limits("gltf-anisotropic", "gltf-anisotropic", False)) == 1
    assert "diffuse term of gltf" in limits("gltf", "ggx", False)[1]
    assert "long tails of GGX" in limits("gltf", "beckmann", False)[2]
    assert "isotropic" in limits("gltf-anisotropic", "gltf", False)[1]
