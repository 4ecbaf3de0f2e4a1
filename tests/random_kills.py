"""A program for tests: bakes over an earlier result again and again, and kills each bake at a random moment.

It prints how the bakes ended, how often the result was which, and what was wrong.

    python random_kills.py FOLDER COUNT SEED
"""

import os
import random
import signal
import sys
import time
from collections import Counter
from pathlib import Path

import colour  # noqa: F401  what a bake loads: it need not be killed while it does
import OpenImageIO  # noqa: F401
import rich.table  # noqa: F401

from mipbake.cli.main import run

SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


def begun(folder, strength, format):
    """A bake in a child process. Until it has signals in hand, they wait."""
    child = os.fork()
    if child:
        return child
    for stream, flags in ((1, os.O_WRONLY), (2, os.O_WRONLY)):
        os.dup2(os.open(os.devnull, flags), stream)
    sys.argv = ["mipbake", "bake", str(folder / "set"), "-o", str(folder / "out"), "--method", "lean",
                "--strength", strength, "--format", format]  # fmt: skip
    code = 1
    try:
        run()
    except SystemExit as error:
        code = error.code
    finally:
        os._exit(code)


def ended(child):
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def content(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()} if folder.is_dir() else {}


def main(place, count, seed):
    rng, folder = random.Random(int(seed)), Path(place)
    result = folder / "out" / "set"
    wrong, codes, seen = [], Counter(), Counter()
    for format in ("exr", "png"):
        known, seconds = {}, 0.0
        for strength in ("0.5", "1"):
            start = time.monotonic()
            assert ended(begun(folder, strength, format)) == 0
            seconds = time.monotonic() - start
            known[strength] = content(result)
        for index in range(int(count) // 2):
            number = rng.choice(SIGNALS)
            before = set((folder / "out").iterdir())
            child = begun(folder, ("0.5", "1")[index % 2], format)
            time.sleep(rng.uniform(0, 1.1 * seconds))
            os.kill(child, number)
            code = ended(child)
            codes[code] += 1
            found = [strength for strength, files in known.items() if files == content(result)]
            seen[found[0] if found else "neither"] += 1
            # A bake that is stopped before it looks leaves what an earlier one, which was killed, left.
            beside = [path.name for path in set((folder / "out").iterdir()) - before]
            # The child has Python's own handling of SIGINT, or none of SIGTERM, until its handlers are set.
            allowed = {0, -number, 128 + number, 1}
            if not found or code not in allowed or (beside and number != signal.SIGKILL):
                wrong.append(f"{format}, {index}, {number.name}: exit code {code}, {found}, beside it {beside}")
        assert ended(begun(folder, "1", format)) == 0
        beside = [path.name for path in (folder / "out").iterdir() if path != result]
        if content(result) != known["1"] or beside:
            wrong.append(f"{format}, afterwards: beside it {beside}")
    print(f"exit codes {dict(codes)}; results {dict(seen)}")
    print("\n".join(wrong))


if __name__ == "__main__":
    main(*sys.argv[1:])
