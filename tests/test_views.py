"""Blocks of pages say what the records hold: films, fits, libraries, engines, files of GLB."""

from __future__ import annotations

import importlib
import itertools
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from .result_records import row

ROOT = Path(__file__).resolve().parent.parent
SCENES, SAMPLERS = ("floor", "wall", "sphere"), ("trilinear", "anisotropic", "accumulated", "accumulated, bias -1")
LOOKS = {"auto": 9.6, "neural": 9.4, "linear (box)": 9.0, "lean (gaussian)": 9.3, "godot (gaussian)": 8.0}
"""JOD of every film of made-up sets."""

Block = Callable[[str, Mapping[str, Any]], str]
Change = Callable[[str, Mapping[str, Any]], Mapping[str, Any]]
"""Method and film to figures that are other than usual."""


class Records(dict[str, Any]):
    def record(self, name: str) -> Any:
        return SimpleNamespace(data=self[name], measured=SimpleNamespace(on="2026-01-02", machine="a machine"))


@pytest.fixture
def block(monkeypatch: pytest.MonkeyPatch) -> Block:
    """The text of a block, made of the data of its record."""
    monkeypatch.syspath_prepend(ROOT / "docs")
    views = importlib.import_module("records.views").VIEWS
    return lambda name, data: str(views[name](Records({name.partition("/")[0]: data})))


def films(change: Change = lambda _method, _film: {}) -> dict[str, Any]:
    """What docs/remake.py keeps of films of two made-up sets, whose measures rank as JOD does."""

    def figures(method: str, where: Mapping[str, Any]) -> dict[str, Any]:
        jod = LOOKS[method]
        usual = {"jod-37": jod, "flip": (10 - jod) / 10, "visible": (10 - jod) / 5, "snr": 10 + jod, "sparkle": 0.001,
                 "snr-displayed": 12 + jod, "flicker": 1.1}  # fmt: skip
        return usual | dict(change(method, where))

    return {
        "effort": {"height": 160, "frames": 16, "passes": 256},
        "sets": {
            name: {
                "lighting": lighting,
                "roughness": roughness,
                "slope": 0.2,
                "network": "some-weights",
                "films": [
                    {
                        "scene": f"film-{scene}", "sampler": sampler, "converged": scene != "wall",
                        "figures": {m: figures(m, {"set": name, "scene": scene, "sampler": sampler}) for m in LOOKS},
                    }
                    for sampler, scene in itertools.product(SAMPLERS, SCENES)
                ],
            }
            for name, lighting, roughness in (("a", "studio", 0.3), ("b", "sky", 0.9))
        },
    }  # fmt: skip


def worse(method: str, where: Mapping[str, Any]) -> Mapping[str, Any]:
    """auto is far behind in one film, and so is the network, which shimmers and sparkles on all floors."""
    changed: dict[str, Any] = {}
    if method in ("auto", "neural") and (where["set"], where["scene"], where["sampler"]) == ("b", "wall", "trilinear"):
        changed["jod-37"] = 8.5
    if method == "neural" and where["scene"] == "floor":
        changed |= {"flicker": 1.3, "sparkle": 0.002}
    return changed


def test_what_the_readme_says_of_films(block: Block) -> None:
    text = block("films/where", films(worse))  # 11 films gain 0.6 and one loses 0.5
    assert "12 films of 2 sets that mipbake never saw, and 12 with temporal" in " ".join(text.split())
    assert row(text, "all films") == "| all films | +0.51 | 92% | 8% |"
    assert row(text, "matte bumps (roughness from 0.8)") == "| matte bumps (roughness from 0.8) | +0.42 | 83% | 17% |"
    assert row(text, "glossy bumps (roughness below 0.5)").endswith(" | +0.60 | 100% | 0% |")
    assert "flat surfaces" not in text  # nothing was filmed
    assert row(text, "floors").endswith(" | +0.60 | 100% | 0% |")
    assert row(text, "walls and spheres, one or two texels a pixel").endswith(" | +0.46 | 88% | 12% |")
    assert "Lights matter little: +0.42 to +0.60." in " ".join(text.split())
    assert row(text, "anisotropic lookups").endswith(" | +0.60 | 100% | 0% |")
    assert row(text, "temporal antialiasing, MIP bias -1").endswith(" | +0.60 | 100% | 0% |")


def test_films_by_scene_and_beside_linear(block: Block) -> None:
    text = block("films/jod", films(worse))
    assert row(text, "auto").startswith("| auto | **9.60** | 9.05 | **9.60** |")
    assert row(text, "linear (box)").count("9.00") == 7 and "**9.30**" in row(text, "lean (gaussian)")
    text = block("films/beside-linear", films(worse))
    assert row(text, "auto: all") == "| auto: all | 12 | +0.51 | -0.50 | +0.60 | 92% | 92% |"
    assert row(text, "auto: accumulated, bias -1").startswith("| auto: accumulated, bias -1 | 6 | +0.60 |")
    # 0.1 behind the best closed form is near it, and more is not.
    for jod, near in ((9.2, "100%"), (9.19, "0%")):
        data = films(lambda method, _, jod=jod: {"jod-37": jod} if method == "auto" else {})
        assert row(block("films/beside-linear", data), "auto: all").endswith(f" {near} |")


def test_flicker_sparkle_and_ranks(block: Block) -> None:
    def changed(method: str, where: Mapping[str, Any]) -> Mapping[str, Any]:
        if where["scene"] == "sphere":
            return {"flicker": None}  # nothing moves enough
        if method == "godot (gaussian)":
            return {"flicker": 0.7, "sparkle": 0.00125}
        return worse(method, where)

    text = block("films/steady", films(changed))
    assert row(text, "auto") == "| auto | 100% | 0% | 0% | 1.10 | 100% |"
    assert row(text, "neural") == "| neural | 50% | 0% | 50% | 1.20 | 67% |"
    assert row(text, "godot (gaussian)") == "| godot (gaussian) | 0% | 100% | 0% | 0.70 | 100% |"
    text = block("films/ranks", films(lambda method, _: {"flip": 0.0} if method == "godot (gaussian)" else {}))
    assert row(text, "`visible`, what judges and training minimise").endswith("| 1.000 | 100% |")
    assert row(text, "FLIP") == "| FLIP | 0.000 | 60% |"  # the worst looks best to it
    assert "240 pairs of methods" in text


def fitted(scales: Mapping[str, Mapping[str, float]], seconds: float) -> dict[str, Any]:
    """A set whose stacks have these SNR in dB at each scale: sums are of one view, signal, error, noise."""
    sums = {
        scale: {name: [1.0, 10 ** (-snr / 10), 0.0] for name, snr in found.items()} for scale, found in scales.items()
    }
    return {
        "scales": {scale: [{"sums": {"snr": each, "snr-displayed": each}}] for scale, each in sums.items()},
        "seconds": {"preparing": seconds, "steps": 2 * seconds, "rounds": 1.0},
    }


def test_fits(block: Block) -> None:
    others = {"linear": 10.0, "lean": 12.0, "auto": 11.0}
    first = fitted({"near": others | {"fitted": 12.04}, "far": others | {"fitted": 13.0}}, 10)
    second = fitted({"near": others | {"fitted": 11.6}, "far": others | {"fitted": 12.2}}, 20)
    data = {"renderers": {"gl": {"a": first, "b": second}}}
    text = " ".join(block("fit/words", data).split())
    assert (
        "In linear radiance: In `gl`, the fitted stack is ahead of the best of the other three at 2 of 4 scales of "
        "sets, equal to it at 1, and behind it at 1; the difference is +0.2 dB in the mean, and -0.4 dB at worst."
        in text
    )
    assert block("fit/means", data).splitlines()[-1] == "| gl | fitted | 11.8 / 11.8 | 12.6 / 12.6 |"
    assert block("fit/cost", data).splitlines()[-1] == "| gl | 15 s | 30 s | 1 s |"
    assert block("fit/pictures", data).splitlines()[0] == "![a in gl](fit-gl-a.png)"
