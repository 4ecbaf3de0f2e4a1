"""Time of a bake's network in the native core, beside a product of matrices.

    python benchmarks/network.py [--size N] [--rounds N] [--torch]

Operations are counted from the weights: two for each weight and each texel that it is used for, in all levels. The
moments, the statistics, the corrections and the filters come on top of that and are not counted. The product is of
matrices in NumPy's library, with as many threads. It is no peak: that library may be made for an older processor.
`--torch` also bakes the same tiles in torch, which is the twin.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from timing import cpu_name, measure

from mipbake import _native
from mipbake.material.pixel_filter import level_sizes
from mipbake.models.level_filter import Lookup
from mipbake.models.moment_baker import MomentBaker
from mipbake.models.registry import find_weights, load_baker, load_network

_WEIGHTS = "mipbake-3"
_SIDE = 1536  # of the matrices that are multiplied


def stored_of(size: int) -> NDArray[np.float32]:
    """(size, size, 8) stored channels of `gltf`: bumps of two sizes, and spots of metal."""
    v, u = np.meshgrid(*(np.arange(size, dtype=np.float32) * (2 * np.pi / 64),) * 2, indexing="ij")
    x, y = 0.4 * np.sin(3 * u) * np.cos(v), 0.3 * np.sin(5 * v + u)
    length = np.sqrt(1 + x * x + y * y)
    metal = (np.sin(u) * np.sin(2 * v) > 0).astype(np.float32)
    rough = 0.4 + 0.3 * np.sin(u + 2 * v)
    colours = [0.5 + 0.4 * np.sin(u + each) for each in (0, 1, 2)]
    return np.stack([*colours, metal, rough, x / length, y / length, 1 / length], -1).astype(np.float32)


def operations(baker: MomentBaker, size: int) -> float:
    """Operations of the layers of a bake of size x size texels."""
    weights = {"encoder": 0, "decoder": 0}
    for name, tensor in baker.tensors.items():
        if name.endswith("weight"):
            weights["encoder" if name.startswith(("encoder", "project")) else "decoder"] += tensor.size
    texels = sum(height * width for height, width in level_sizes(size, size))
    return 2.0 * (weights["encoder"] * size * size + weights["decoder"] * texels)


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description="Times the network of a bake.")
    parser.add_argument("--size", type=int, default=1024, help="texels a side")
    parser.add_argument("--rounds", type=int, default=5, help="times that each is measured")
    parser.add_argument("--torch", action="store_true", help="also bake in torch")
    options = parser.parse_args()
    info = find_weights(_WEIGHTS)
    baker, stored = load_baker(info), stored_of(options.size)
    assert isinstance(baker, MomentBaker)
    lookup = Lookup("gaussian", "trilinear")
    left, right = (np.random.default_rng(i).random((_SIDE, _SIDE), np.float32) for i in (0, 1))
    candidates: dict[str, Callable[[], object]] = {
        "native": lambda: baker.levels(stored, lookup, ("wrap", "wrap")),
        "product": lambda: left @ right,
    }
    if options.torch:
        from mipbake.models.moment_inference import bake_levels

        network = load_network(info)
        candidates["torch"] = lambda: bake_levels(network, stored, lookup, ("wrap", "wrap"))
    found = measure(candidates, options.rounds)
    count, texels = operations(baker, options.size), options.size**2
    rate, product = count / found["native"].median / 1e9, 2 * _SIDE**3 / found["product"].median / 1e9
    print(f"{cpu_name()}; {_native.num_threads()} threads, {_native.isa()}; {options.size} x {options.size} texels")
    print(f"{count / 1e9:.1f} GFLOP in the layers; NumPy's product of matrices {product:.0f} GFLOP/s")
    print(f"native: {found['native'].text(texels)} a texel; {rate:.0f} GFLOP/s, {rate / product:.2f} times the product")
    if options.torch:
        ratio = found["torch"].median / found["native"].median
        print(f"torch: {found['torch'].text(texels)} a texel; {ratio:.1f} times the native time")


if __name__ == "__main__":
    main()
