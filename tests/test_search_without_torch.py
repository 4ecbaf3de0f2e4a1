"""The methods that search need no torch: only a network among their ingredients may."""

from __future__ import annotations

import subprocess
import sys

import pytest

from mipbake.baking.search.methods import Auto, Optimum, Refine, Searching

SCRIPT = """
import sys

sys.modules["torch"] = None  # importing it is an error from here on

import numpy as np

from mipbake.quality.judging.probes import ProbeEffort
from mipbake.baking.search import methods
from mipbake.baking.search.texel_descent import DescentEffort

few = ProbeEffort(groups=2, points=4, samples=2, pictures=8, picture_samples=2)
one = DescentEffort(rounds=2, pairs=8, looks=few)
rng = np.random.default_rng(0)
normal = np.concatenate([0.3 * rng.standard_normal((16, 16, 2)), np.ones((16, 16, 1))], -1)
normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
stored = np.concatenate([rng.random((16, 16, 5)), normal], -1).astype(np.float32)
method = type("Plain", (getattr(methods, sys.argv[1]),), {"learned": False})
result = method(budget="best", effort=few, descent=one)(
    stored, "gltf", sys.argv[2], "gaussian", ("wrap", "wrap"), lambda _: None
)
assert any(level.refined for level in result.measured.levels)
print([name for name in sys.modules if name.split(".")[0] == "torch"])
"""


@pytest.mark.parametrize("target", ["gltf", "gltf-anisotropic"])
@pytest.mark.parametrize("method", [Auto, Refine, Optimum])
def test_a_search_without_a_network_imports_no_torch(method: type[Searching], target: str) -> None:
    """Its levels are optimised all the same."""
    command = [sys.executable, "-c", SCRIPT, method.__name__, target]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == "['torch']"
