"""A library that is baked, killed again and again, and gone on with.

    python benchmarks/library.py --results build/library.json [--count 200] [--broken 20] [--doubles 10] [--kills 10]

The library is generated: sets of several sizes and kinds, some broken, some of one name. It is baked once without an
interruption. Then it is baked by a command that is killed at random moments, with all its processes, until it ends.
Last it is baked on a Ray cluster of two machines, which are processes here, while processes that bake are killed one
after the other. What all left must be the same, byte for byte, and nothing may have been baked twice.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import subprocess
import tempfile
import threading
import time
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from library_sets import make_library
from timing import MIPBAKE, arguments, keep

SIGNALS = (signal.SIGKILL, signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


@dataclass(frozen=True)
class Pass:
    """One call of the command.

    Args:
        code: exit code; negative for a signal. seconds: of the wall clock.
        baked, unchanged, failed: entries of the log. twice: of those baked, how many an earlier pass had baked.
    """

    code: int
    seconds: float
    baked: int
    unchanged: int
    failed: int
    twice: int


@dataclass
class Baker:
    """Calls the command on one library, and remembers what it has baked."""

    library: Path
    out: Path
    log: Path
    where: tuple[str, ...]
    seen: set[str] = field(default_factory=set)

    def run(self, kill_after: float | None = None, number: int = signal.SIGKILL) -> Pass:
        """One call, which may be killed after some seconds."""
        self.log.unlink(missing_ok=True)
        options = ["-r", "-o", str(self.out), *self.where, "--method", "linear", "--json-log", str(self.log)]
        begun = time.monotonic()
        process = subprocess.Popen(
            [*MIPBAKE, "bake", str(self.library), *options, "--quiet"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        try:
            process.wait(kill_after)
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, number)
            process.wait()
        seconds = time.monotonic() - begun
        lines = self.log.read_text().splitlines(keepends=True) if self.log.exists() else []
        said = [json.loads(line) for line in lines if line.endswith("\n")]
        done = {f"{each['entry']} {each['out']}" for each in said if "files" in each}
        twice = len(done & self.seen)
        self.seen |= done
        unchanged = sum(each.get("unchanged", False) for each in said)
        failed = sum(not each["ok"] for each in said)
        return Pass(process.returncode, round(seconds, 2), len(done), unchanged, failed, twice)


def content(out: Path) -> dict[str, str]:
    """Hashes of all files of results, by their paths."""
    files = (path for path in sorted(out.rglob("*")) if path.is_file() and ".mipbake" not in path.parts)
    return {str(path.relative_to(out)): hashlib.sha256(path.read_bytes()).hexdigest() for path in files}


def differences(expected: dict[str, str], found: dict[str, str]) -> list[str]:
    """Files that are not the same in both."""
    return sorted(name for name in {*expected, *found} if expected.get(name) != found.get(name))


def on_cluster(library: Path, folder: Path, kills: int, seconds: float) -> tuple[Pass, int]:
    """A bake on two machines of one core each, and how many processes were killed meanwhile.

    Args:
        seconds: that a bake takes; processes are killed within them.
    """
    from ray.cluster_utils import Cluster

    node = {"num_cpus": 1, "object_store_memory": 200 << 20}
    machines = Cluster(initialize_head=True, head_node_args={**node, "include_dashboard": False})
    over, deaths = threading.Event(), 0

    def kill() -> None:
        nonlocal deaths
        rng = random.Random(2)
        while deaths < kills and not over.wait(rng.uniform(0.3, 1.0) * seconds / kills):
            if busy := at_work():
                os.kill(rng.choice(busy), signal.SIGKILL)
                deaths += 1

    killer = threading.Thread(target=kill)
    try:
        machines.add_node(**node)
        machines.wait_for_nodes()
        baker = Baker(library, folder / "cluster", folder / "cluster.jsonl", ("--cluster", machines.address))
        killer.start()
        return baker.run(), deaths
    finally:
        over.set()
        killer.join()
        machines.shutdown()


def at_work() -> list[int]:
    """Processes of clusters of this machine that bake now."""
    named = ((path, path.read_bytes()) for path in Path("/proc").glob("[0-9]*/cmdline") if path.exists())
    return [int(path.parent.name) for path, name in named if name.startswith(b"ray::followed")]


def measure(folder: Path, count: int, broken: int, doubles: int, kills: int, jobs: int) -> dict[str, Any]:
    """Bakes the library in all ways."""
    library = folder / "library"
    make_library(library, count, broken, doubles)
    then = time.time() - 60
    for path in library.rglob("*"):
        os.utime(path, (then, then))
    here = ("-j", str(jobs))
    calm = Baker(library, folder / "calm", folder / "calm.jsonl", here)
    whole = calm.run()
    again = calm.run()
    touched = next(library.rglob("normal.png"))
    data = touched.read_bytes()
    touched.write_bytes(data + b"\0")  # readers pass over what follows the end of an image
    one = calm.run()
    touched.write_bytes(data)
    os.utime(touched, (then, then))
    calm.run()

    rng = random.Random(1)
    killed = Baker(library, folder / "killed", folder / "killed.jsonl", here)
    passes = []
    for index in range(kills):
        share = whole.seconds / (kills + 1)
        passes.append(killed.run(rng.uniform(0.7, 1.6) * share + 1.0, SIGNALS[index % len(SIGNALS)]))
    passes.append(killed.run())
    expected, found = content(calm.out), content(killed.out)
    there, deaths = on_cluster(library, folder, kills, whole.seconds)
    differing = content(folder / "cluster")
    return {
        "count": count,
        "broken": broken,
        "doubles": doubles,
        "jobs": jobs,
        "whole": asdict(whole),
        "again": asdict(again),
        "one changed": asdict(one),
        "killed": [asdict(each) for each in passes],
        "baked twice": sum(each.twice for each in passes),
        "cluster": asdict(there),
        "cluster deaths": deaths,
        "files": len(expected),
        "same": expected == found,
        "same on cluster": expected == differing,
        "differ": [*differences(expected, found), *differences(expected, differing)][:20],
    }


def main() -> None:
    options = arguments(__doc__, results=None, count=200, broken=20, doubles=10, kills=10, jobs=2)
    signal.signal(signal.SIGINT, signal.default_int_handler)  # what shells begin behind their backs would ignore it
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), options.count, options.broken, options.doubles, options.kills, options.jobs)
    keep(found, options.results)


if __name__ == "__main__":
    main()
