"""The npm package beside the native core on one thread: bytes, processor time, how far their levels are apart, and what
two workers change of the time that passes.

python benchmarks/web.py [--size 1024] [--rounds 3] [--results FILE]     after python web/build.py
"""

from __future__ import annotations

import gzip
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from timing import ROOT, arguments, keep

import mipbake
from mipbake import _native

WEB = ROOT / "web"
sys.path += [str(ROOT / "examples"), str(WEB)]
import generate  # noqa: E402
from page_build import imported  # noqa: E402

_NODE = """
import { readFileSync, writeFileSync } from 'node:fs';
import { bake } from '%(package)s';
const size = %(size)d, maps = {};
for (const [role, channels] of [['base_color', 3], ['normal', 3], ['roughness', 1], ['metallic', 1]]) {
    const data = new Uint8Array(readFileSync(`${process.argv[1]}/${role}`));
    maps[role === 'base_color' ? 'baseColor' : role] = { data, width: size, height: size, channels };
}
const started = performance.now(), before = process.cpuUsage();
const stack = await bake(maps, { threads: %(threads)d });
const { user, system } = process.cpuUsage(before), wall = performance.now() - started;
const levels = stack.stored.map(({ data }) => Buffer.from(data.buffer, data.byteOffset, data.byteLength));
writeFileSync(`${process.argv[1]}/levels`, Buffer.concat(levels));
console.log((user + system) / 1e6, wall / 1e3);
"""


def main() -> None:
    """Measures, in turns."""
    options = arguments(__doc__, size=1024, rounds=3, results=None)
    _native.set_num_threads(1)
    seconds: dict[str, list[float]] = {"node": [], "native": []}
    walls: dict[int, list[float]] = {1: [], 2: []}
    with tempfile.TemporaryDirectory() as scratch:
        maps = generate.make("lacquered_leather", options.size, options.size)
        generate.store(maps, Path(scratch) / "leather")
        texture_set = mipbake.load(Path(scratch) / "leather")
        for role, pixels in maps.items():
            (Path(scratch) / role).write_bytes(pixels.tobytes())
        for _ in range(options.rounds):
            before = time.process_time()
            stack = mipbake.bake(texture_set, "neural")
            seconds["native"].append(time.process_time() - before)
            for threads, wall in walls.items():
                processor, passed = _in_node(scratch, options.size, threads)
                wall.append(passed)
                seconds["node"] += [processor] if threads == 1 else []
        theirs = np.fromfile(Path(scratch) / "levels", np.float32)
    ours = np.concatenate([level.ravel() for level in stack.levels])
    found = {
        "bytes": {
            "core": _packed(WEB / "dist" / "bakes.wasm"),
            "core without SIMD": _packed(WEB / "dist" / "bakes-scalar.wasm"),
            "weights": _packed(WEB / "dist" / "mipbake-3.safetensors"),
            "script": sum(_packed(path) for path in imported(WEB / "src" / "index.js")),
        },
        "size": options.size,
        "seconds": {name: float(np.median(each)) for name, each in seconds.items()},
        "two workers": float(np.median(walls[2]) / np.median(walls[1])),
        "largest difference": float(np.abs(ours - theirs).max()),
    }
    keep(found, options.results)


def _in_node(scratch: str, size: int, threads: int) -> tuple[float, float]:
    """Seconds of processor time of a bake, and seconds that pass."""
    script = _NODE % {"package": (WEB / "src" / "index.js").as_uri(), "size": size, "threads": threads}
    ran = subprocess.run(
        ["node", "--input-type=module", "-e", script, scratch], check=True, capture_output=True, text=True
    )
    processor, passed = map(float, ran.stdout.split())
    return processor, passed


def _packed(path: Path) -> int:
    """Bytes of a file after gzip."""
    return len(gzip.compress(path.read_bytes(), 9))


if __name__ == "__main__":
    main()
