"""`python -m tests.fuzz`: damaged files through every reader, until the time is over; see docs/testing.md."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from .campaign import CORPUS, Result, run, work


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description="Damages files and has every reader read them. Exits 1 if any broke."
    )
    names = sorted(path.name for path in CORPUS.iterdir())
    parser.add_argument("--seconds", type=float, default=60, help="how long, starting included (default: 60)")
    parser.add_argument("--seed", type=int, default=0, help="decides all inputs (default: 0)")
    parser.add_argument("--reader", action="append", choices=names, help="these readers alone; repeat for more")
    parser.add_argument("--save", type=Path, default=Path("fuzz-found"), help="where inputs go that broke a reader")
    parser.add_argument("--worker", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args()
    readers = options.reader or names
    if options.worker is not None:
        work(options.seed, readers, options.worker)
    result = run(options.seed, readers, None, options.seconds)
    print(summary(result))
    for defect in result.defects:
        folder = options.save / f"{options.seed}-{defect.number}-{defect.case.reader}"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / defect.case.file.name).write_bytes(defect.case.data)
        (folder / "what.txt").write_text(f"{defect.case.reader}/{defect.case.file}: {defect.what}\n", encoding="utf-8")
    return 1 if result.defects else 0


def summary(result: Result) -> str:
    """Counts, and every kind of defect once with how often it came."""
    kinds: dict[tuple[str, str], list[int]] = {}
    for defect in result.defects:
        kinds.setdefault((defect.case.reader, defect.what.split(": ")[0]), []).append(defect.number)
    first = {defect.number: defect for defect in result.defects}
    return "\n".join(
        [
            f"{result.inputs.total()} inputs: " + ", ".join(f"{n} {k}" for k, n in sorted(result.inputs.items())),
            "answers: " + ", ".join(f"{n} {answer}" for answer, n in result.answers.most_common()),
            f"{len(result.defects)} defects of {len(kinds)} kinds",
            *(
                f"  {reader}, {len(numbers)} times, first input {numbers[0]} ({first[numbers[0]].case.file}): "
                f"{first[numbers[0]].what}"
                for (reader, _), numbers in sorted(kinds.items())
            ),
        ]
    )


if __name__ == "__main__":
    sys.exit(main())
