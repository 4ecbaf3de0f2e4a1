"""Baking with moment networks in the native core: what torch says, whatever the size, the threads and the processor."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from mipbake import _native
from mipbake.material import convert
from mipbake.material.aim import SAMPLERS, Sampler
from mipbake.material.pixel_filter import FILTERS, Wrap, level_sizes
from mipbake.models.level_filter import Lookup
from mipbake.models.moment_baker import MomentBaker
from mipbake.models.moment_config import MADE, MomentConfig
from mipbake.models.moment_inference import bake_levels
from mipbake.models.moment_network import MomentNetwork
from mipbake.models.registry import list_weights, load_baker, load_network

from .baked_levels import off
from .moment_cases import ANISOTROPIC, TORUS, bumpy, config_of, of_model, trained_like

torch.set_num_threads(1)

RELEASED = [info for info in list_weights() if isinstance(info.network, MomentConfig)]


def baker_of(network: MomentNetwork) -> MomentBaker:
    tensors = {name: each.numpy() for name, each in network.state_dict().items()}
    return MomentBaker.of(network.config, (), tensors)


@pytest.mark.long
@pytest.mark.parametrize("made", MADE)
@pytest.mark.parametrize(
    ("height", "width", "wrap"),
    [(40, 25, ("clamp", "wrap")), (16, 1, TORUS), (33, 130, ("wrap", "clamp")), (1, 1, TORUS), (3, 7, TORUS)],
)
@pytest.mark.parametrize("pixel_filter", ["gaussian", "box", "mitchell"])
def test_torch_says_the_same(made: str, height: int, width: int, wrap: Wrap, pixel_filter: str) -> None:
    network = trained_like(config_of(made))
    stored = of_model(network.config.encoders[0], height, width)
    ours = baker_of(network).levels(stored, Lookup(pixel_filter), wrap)
    theirs = bake_levels(network, stored, Lookup(pixel_filter), wrap)
    assert [level.shape[:2] for level in ours] == level_sizes(height, width)
    difference = off(made, ours, theirs)
    # White noise in float32, through a network whose weights are drawn at random: rounding is amplified. Where lobes
    # are lines, a texel beside a cut may be taken for another side of it.
    assert np.quantile(difference, 0.999) < 3e-3
    assert np.quantile(difference, 0.99) < 1e-4


@pytest.mark.long
@pytest.mark.parametrize("info", RELEASED, ids=lambda info: info.name)
@pytest.mark.parametrize("sampler", [*SAMPLERS.values(), Sampler(4, -1.0, 8)])
@pytest.mark.parametrize("pixel_filter", list(FILTERS))
def test_released_weights_bake_what_torch_bakes(info, sampler: Sampler, pixel_filter: str) -> None:  # type: ignore[no-untyped-def]
    (read,), (made,) = info.network.encoders, info.network.decoders
    stored = of_model(read, 48, 40) if read != "gltf" else bumpy(48, 40)
    lookup = Lookup(pixel_filter, info.network.told(sampler))
    theirs = bake_levels(load_network(info), stored, lookup, ("clamp", "wrap"))
    baker = load_baker(info)
    assert isinstance(baker, MomentBaker)
    difference = off(made, baker.levels(stored, lookup, ("clamp", "wrap")), theirs)
    assert difference.max() < 3e-3
    assert np.quantile(difference, 0.99) < 1e-4


def test_rounding_is_no_greater_than_torchs() -> None:
    """Of a network in float64, both are as far off."""
    network, stored = trained_like(), bumpy(16, 16)
    ours = baker_of(network).levels(stored, Lookup("gaussian"), TORUS)
    theirs = network(torch.from_numpy(stored)[None], "gltf", "gaussian")["gltf"]
    exact = network.double()(torch.from_numpy(stored).double()[None], "gltf", "gaussian")["gltf"]
    own, other = (
        np.sqrt(np.mean([np.square(a - e[0].numpy()).mean() for a, e in zip(some, exact[:4], strict=False)]))
        for some in (ours[:4], [each[0].numpy() for each in theirs[:4]])
    )
    assert own < 3 * other


@pytest.mark.parametrize("config", [config_of("gltf"), ANISOTROPIC], ids=["round", "anisotropic"])
def test_threads_do_not_show(config: MomentConfig) -> None:
    baker, stored = baker_of(trained_like(config)), bumpy(70, 300)
    before, found = _native.num_threads(), []
    try:
        for threads in (1, 2, 5):
            _native.set_num_threads(threads)
            found.append(baker.levels(stored, Lookup("gaussian"), ("clamp", "wrap")))
    finally:
        _native.set_num_threads(before)
    for others in found[1:]:
        for level, other in zip(found[0], others, strict=True):
            np.testing.assert_array_equal(level, other)


SCRIPT = """
import sys
import numpy as np
sys.modules["torch"] = None  # importing it fails
from mipbake import Sampler, _native
from mipbake.models.level_filter import Lookup
from mipbake.models.registry import find_weights, load_baker
stored = np.load(sys.argv[1])
levels = load_baker(find_weights("mipbake-3")).levels(stored, Lookup("gaussian", Sampler()), ("wrap", "clamp"))
np.savez(sys.argv[2], *levels)
print(_native.isa())
"""


@pytest.mark.parametrize("isa", ["baseline", "avx2", "avx512"])
def test_every_instruction_set_bakes_alike_and_without_torch(isa: str, tmp_path: Path) -> None:
    stored = bumpy(37, 101)
    np.save(tmp_path / "stored.npy", stored)
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, tmp_path / "stored.npy", tmp_path / "levels.npz"],
        env={**os.environ, "MIPBAKE_ISA": isa},
        capture_output=True,
        text=True,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    if run.stdout.strip() != isa:
        pytest.skip(f"this processor or build has no {isa}")
    (info,) = (info for info in RELEASED if info.name == "mipbake-3")
    here = bake_levels(load_network(info), stored, Lookup("gaussian", Sampler()), ("wrap", "clamp"))
    with np.load(tmp_path / "levels.npz") as found:
        difference = off("gltf", [found[name] for name in found.files], here)
    assert difference.max() < 3e-3
    assert np.quantile(difference, 0.99) < 1e-4


def test_a_source_in_another_model_is_converted() -> None:
    (info,) = (info for info in RELEASED if info.name == "mipbake-3-ggx")
    stored = bumpy(12, 20)
    ours = load_baker(info).bake(stored, "gltf", "ggx", "gaussian", TORUS, lambda _: None, Sampler())
    theirs = load_baker(info).bake(
        convert(stored, "gltf", "ggx"), "ggx", "ggx", "gaussian", TORUS, lambda _: None, Sampler()
    )
    for level, other in zip(ours, theirs, strict=True):
        np.testing.assert_array_equal(level, other)


@pytest.mark.parametrize("broken", ["missing", "wide", "samplers"])
def test_tensors_that_do_not_fit_are_found_before_a_bake(broken: str) -> None:
    (info,) = (info for info in RELEASED if info.name == "mipbake-3")
    baker = load_baker(info)
    assert isinstance(baker, MomentBaker)
    tensors = dict(baker.tensors)
    if broken == "missing":
        del tensors["decoder.1.bias"]
    else:
        name = {"wide": "decoder.2.weight", "samplers": "told"}[broken]
        tensors[name] = tensors[name][..., :-1] if broken == "wide" else tensors[name][:1]
    with pytest.raises((KeyError, ValueError)):
        MomentBaker.of(baker.config, (), tensors)
