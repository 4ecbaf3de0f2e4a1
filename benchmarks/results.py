"""Measures methods on every texture set of a folder, a JSON file a set.

    python benchmarks/results.py SETS_FOLDER RESULTS_FOLDER

`python docs/remake.py --measure results-whole --materials SETS_FOLDER` runs it and keeps what it measured as a record;
docs/results.md and other pages are made from the record.

Every sub-folder of SETS_FOLDER is one texture set. Five kinds of measurements, each in a folder of its own:

    whole        all methods, isotropic glTF target: SNR, flicker, renders of spheres, time and memory of every bake
    crop         the middle of every set, where the per-material optimum can be had
    directional  the anisotropic target beside the isotropic one, on sets with directional bumps, generated ones too
    models       the material models ggx and beckmann with the networks that were trained for them
    correlated   generated materials whose channels depend on each other, and twins where they do not

Sets whose file says that it was measured with the same methods, weights and settings are left alone, so a run that was
stopped goes on, and new weights are measured. New code is not noticed: it wants a new RESULTS_FOLDER. A set that fails
is named at the end, and the others are measured.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import resource
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from timing import effort_of, expect, holds, keep, number, parser_of

if TYPE_CHECKING:
    from results_measure import Asked, Plan, ResultsEffort


def narrow(threads: int) -> None:
    """Keeps this process, and those that it starts, to so many processors."""
    os.environ["MIPBAKE_THREADS"] = os.environ["OMP_NUM_THREADS"] = str(threads)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[-threads:])


def processor_seconds() -> float:
    """Processor time of this process and of the processes that it has started and seen end."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def folders_and_threads() -> argparse.ArgumentParser:
    """A parser of the arguments that are known before anything is imported that counts processors."""
    return parser_of(__doc__, "sets", "results", threads=1)


def main() -> int:
    parser = folders_and_threads()
    options, _ = parser.parse_known_args()
    narrow(options.threads)

    from mipnet_network import register  # libraries count processors when they are imported
    from results_measure import KINDS, measured

    register()
    return run(parser, KINDS, measured)


def run(
    parser: argparse.ArgumentParser,
    kinds: Mapping[str, Callable[[Asked], Sequence[Plan]]],
    measured: Callable[[Plan, ResultsEffort], dict[str, Any]],
) -> int:
    """Measures what the arguments of the program ask for; 1 where something failed.

    Args:
        parser: knows the folders and the threads.
        kinds: name to the plans of a kind of measurement. measured: the figures of a plan.
    """
    from results_measure import Asked, ResultsEffort
    from results_sets import folder_sets

    parser.add_argument("--kinds", nargs="+", choices=kinds, default=list(kinds), help="of measurements")
    parser.add_argument(
        "--methods", nargs="+", default=["neural", "auto"],
        help="beside the closed forms: names of methods, neural:WEIGHTS, or with a budget, refine@2m",
    )  # fmt: skip
    parser.add_argument("--weights", type=Path, nargs="+", default=[], help="folders of more weights")
    parser.add_argument("--without", nargs="+", default=[], metavar="WEIGHTS", help="networks that are not measured")
    parser.add_argument("--only", nargs="+", default=[], help="names of sets")
    for field in dataclasses.fields(ResultsEffort):
        parser.add_argument(f"--{field.name.replace('_', '-')}", type=number(int), default=field.default)
    options = parser.parse_args()
    effort, sets = effort_of(ResultsEffort, options), folder_sets(options.sets)
    expect("set", options.only, sets)
    sets = {name: load for name, load in sets.items() if not options.only or name in options.only}
    asked = Asked(sets, options.methods, options.weights, effort)
    failed = []
    for kind in options.kinds:
        folder = options.results / kind
        folder.mkdir(parents=True, exist_ok=True)
        for every in kinds[kind](asked):
            plan = dataclasses.replace(every, methods=[m for m in every.methods if m.weights not in options.without])
            file = folder / f"{plan.name}.json"
            key = {"methods": [spec.key() for spec in plan.methods], "effort": dataclasses.asdict(effort)}
            if holds(file, "key", key):
                continue
            start, used = time.perf_counter(), processor_seconds()
            try:
                found = measured(plan, effort)
            except Exception as error:  # a set that fails must not take a night's others with it
                failed.append(f"{kind} {plan.name}: {error}")
                print(failed[-1], flush=True)
                continue
            used = processor_seconds() - used
            keep(found | {"key": key, "threads": options.threads, "processor_seconds": used}, file)
            print(f"{kind} {plan.name}: {time.perf_counter() - start:.0f} s, of processors {used:.0f} s", flush=True)
    if failed:
        print("these failed:", *failed, sep="\n", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
