"""What errors of texels count: against the change of what is shaded, over pairs drawn where lobes are bright."""

from __future__ import annotations

import numpy as np
import pytest

from mipbake.material.gltf import error_weights
from mipbake.quality.metrics.pairs import PAIR_SETS, cosine_directions
from mipbake.shading import shade

STEP = 2e-3
TEXELS = {
    "polished metal": [0.8, 0.7, 0.6, 1.0, 0.2, 0.0, 0.0, 1.0],
    "rough metal": [0.8, 0.7, 0.6, 1.0, 0.7, 0.1, 0.0, 0.995],
    "varnish": [0.3, 0.2, 0.1, 0.0, 0.25, 0.0, 0.1, 0.995],
}


def energy(texel: np.ndarray, changed: np.ndarray) -> float:
    """Mean square change of the radiance over near-mirror pairs."""
    rng = np.random.default_rng(0)
    view = cosine_directions(rng, 20000)
    light = PAIR_SETS["near-mirror"](rng, view)
    view, light = view.astype(np.float32)[:, None], light.astype(np.float32)[:, None]
    before, after = (shade("gltf", each[None, None], light, view) for each in (texel, changed))
    return float(np.mean(np.square((after - before) / STEP)))


@pytest.mark.parametrize("name", TEXELS)
def test_weights_rank_channels_as_shading_does(name: str) -> None:
    """Within a factor of eight of what finite differences say: weights choose blocks and need no more."""
    texel = np.array(TEXELS[name], np.float32)
    weights = error_weights(texel)[0]
    found = {}
    for channel, label in ((0, "base colour"), (4, "roughness"), (5, "normal")):
        changed = texel.copy()
        changed[channel] += STEP if label != "base colour" else -STEP
        if label == "normal":
            changed[5:] /= np.linalg.norm(changed[5:])
        found[label] = float(weights[channel]) / energy(texel, changed)
    middle = np.sqrt(max(found.values()) * min(found.values()))
    assert max(found.values()) < 8 * middle, found


def test_gloss_counts_more_the_narrower_its_lobe() -> None:
    rough = np.array([0.1, 0.3, 0.9])
    texels = np.array([[0.5, 0.5, 0.5, 1.0, r, 0.0, 0.0, 1.0] for r in rough], np.float32)
    weights = error_weights(texels)[0]
    assert (np.diff(weights[:, 4]) < 0).all() and (np.diff(weights[:, 5]) < 0).all()
