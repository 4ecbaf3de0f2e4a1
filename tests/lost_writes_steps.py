"""A program for tests: writes a stack in every format; which of its writes fail is for strace to say.

    python lost_writes_steps.py FOLDER

The first call leaves in FOLDER what is right. A later one prints what was written otherwise, and was not refused.
"""

import contextlib
import os
import shutil
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from mipbake import open_stack
from mipbake.base.errors import OutputError
from mipbake.source.images.oiio_levels import image_info
from mipbake.stack.containers import FORMATS
from tests.full_disk_steps import noise_stack


def content(path):
    """Bytes of all files; of TIFF what readers see, because a directory that cannot be written is written elsewhere."""
    files = [path] if path.is_file() else sorted(path.iterdir())
    seen = [replace(image_info(each), path="", bytes=0) for each in files if each.suffix == ".tx"]
    return [seen, [level.tobytes() for level in open_stack(path).levels]] if seen else [f.read_bytes() for f in files]


def say(text):
    while text:
        with contextlib.suppress(OSError):  # these writes may fail, too
            text = text[os.write(1, text) :]


def main(place):
    folder = Path(place)
    first = not any(folder.iterdir())
    stack = noise_stack((8, 8))  # few writes a file
    writers = {f"{name}:{texels}": (lambda path, fmt=f"{name}:{texels}": stack.save(path, fmt))
               for name, kinds in FORMATS.items() for texels in kinds}  # fmt: skip
    writers["glb"] = lambda path: stack.save(path, "glb")
    refused = 0
    for name, write in writers.items():
        right = folder / name.replace(":", " ")
        if first:
            write(right)
            continue
        target = folder / "target"
        try:
            with ThreadPoolExecutor(1) as alone:  # strace counts the writes of each thread
                alone.submit(write, target).result()
            if content(target) != content(right):
                say(f"{name} was written, and differs\n".encode())
        except OutputError:
            refused += 1
            if target.exists():
                say(f"{name} was refused, and is there\n".encode())
        if target.is_dir():
            shutil.rmtree(target)
        target.unlink(missing_ok=True)
    say(f"{refused} of {len(writers)} refused\n".encode())


if __name__ == "__main__":
    main(*sys.argv[1:])
