"""A program for tests: writes a stack in every format where there is no room, and prints what was wrong.

    python full_disk_steps.py FOLDER limit|disk

With `limit`, no file may have more than so many bytes, which is tried from none to all but one; with `disk`, FOLDER is
on a small disk, which is filled so far that so many bytes are left.
"""

import contextlib
import gc
import os
import resource
import sys
import time
from pathlib import Path

import numpy as np

from mipbake.base.errors import OutputError
from mipbake.base.publish import replaced_file
from mipbake.material.pixel_filter import level_sizes
from mipbake.stack.containers import FORMATS
from mipbake.stack.stack import MipStack, Provenance

SIZE = (96, 160)
PATIENCE = 60  # seconds; it takes one, but the machine may have other work


def noise_stack(size=SIZE):
    rng = np.random.default_rng(0)
    levels = [rng.random((*each, 8), np.float32) for each in level_sizes(*size)]
    for level in levels:
        level[..., 5:] /= np.linalg.norm(level[..., 5:], axis=-1, keepdims=True)
    return MipStack("noise", "gltf", levels, {}, ("wrap", "wrap"), Provenance("linear", "box"))


@contextlib.contextmanager
def room(folder, how, size):
    """No more room than that."""
    if how == "limit":
        _, most = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, most))
        try:
            yield
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (most, most))
        return
    filler = folder / "filler"
    gc.collect()  # what failed before may hold files open
    free = os.statvfs(folder).f_bavail * os.statvfs(folder).f_frsize
    filler.write_bytes(bytes(max(0, free - size)))
    try:
        yield
    finally:
        filler.unlink()


def main(place, how):
    folder = Path(place)
    stack = noise_stack()
    writers = {f"{name}:{texels}": (lambda path, fmt=f"{name}:{texels}": stack.save(path, fmt))
               for name, kinds in FORMATS.items() for texels in kinds}  # fmt: skip
    writers["a file"] = lambda path: replaced_file(path, bytes(1 << 17))
    expected = "a limit of the session" if how == "limit" else "the disk is full"
    for name, write in writers.items():
        target = folder / "target"
        write(target)
        files = [target] if target.is_file() else list(target.iterdir())
        sizes = [path.stat().st_size for path in files]
        whole = max(sizes) if how == "limit" else sum(-(-size // 4096) * 4096 for size in sizes)
        for path in files:
            path.unlink()
        if target.is_dir():
            target.rmdir()
        for share in (0.0, 0.01, 0.1, 0.3, 0.6, 0.9, 1.0):
            start = time.monotonic()
            with room(folder, how, int(share * (whole - 1))):
                try:
                    write(target)
                    said = "success"
                except OutputError as error:
                    said = str(error)
                left = sorted(path.name for path in folder.iterdir() if path.name != "filler")
            seconds = time.monotonic() - start
            if expected not in said or left or seconds > PATIENCE:
                print(f"{name}, {share:.0%} of {whole} bytes: {said}; left {left}; {seconds:.1f} s")
    print(f"{len(writers)} writers")


if __name__ == "__main__":
    main(*sys.argv[1:])
