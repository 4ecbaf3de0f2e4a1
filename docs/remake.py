"""Pages that are made from records, and the measuring of records.

    python docs/remake.py                                     makes all pages, and lists the records
    python docs/remake.py --measure picture beckmann          measures these records, then makes the pages
    python docs/remake.py --measure all --materials FOLDER    measures every record, as a release does

FOLDER holds real texture sets, one in each subfolder. `records/known.py` says how each record is measured. A
measurement that was stopped goes on where it was.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from records.known import KNOWN, MATERIALS
from records.making import renewed
from records.measuring import measure
from records.record import ROOT, load


def listed(name: str) -> str:
    """A line about a record."""
    record, about = load(name), f"{name:22} {KNOWN[name].about}"
    if record is None:
        return f"{about}; nobody has measured it yet"
    return f"{about}; measured {record.measured.on} in {record.measured.seconds:.0f} s of one processor"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--measure", nargs="+", metavar="NAME", default=[], help="records to measure, or all")
    parser.add_argument("--materials", type=Path, help="a folder with one real texture set in each subfolder")
    options = parser.parse_args()
    names = list(KNOWN) if options.measure == ["all"] else options.measure
    unknown = [name for name in names if name not in KNOWN]
    if unknown:
        parser.error(f"no record is called {', '.join(unknown)}: expected all, {', '.join(KNOWN)}")
    if not options.materials and any(MATERIALS in KNOWN[name].command for name in names):
        parser.error("these records are measured on real texture sets: name their folder with --materials")
    for name in names:
        measure(name, KNOWN[name], options.materials).save()
    print(*map(listed, KNOWN), sep="\n")
    for path, content in renewed().items():
        if content is None:
            path.unlink()
        else:
            path.write_bytes(content)
        print(f"{path.relative_to(ROOT)} was {'removed' if content is None else 'made again'}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
