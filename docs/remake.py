"""Records of what was measured, and the pages that are made from them.

    python docs/remake.py                                          says what each record is, and makes all pages
    python docs/remake.py --check                                  writes nothing; fails where something is stale
    python docs/remake.py picture beckmann                         measures these records again, then makes the pages
    python docs/remake.py results-whole --materials FOLDER         the same on real sets, one in each subfolder
    python docs/remake.py --confirm results-whole --materials ...  measures a sample of them with the code of today

`records/known.py` lists the records, and `records/record.py` says when a record is current. A run that was stopped goes
on where it was.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from datetime import date
from pathlib import Path

from records import pages
from records.code import ROOT, hashes
from records.known import KNOWN, MATERIALS
from records.making import renewed
from records.measuring import confirm, measure, spent
from records.record import FOLDER, Record, load, state

_AGAIN = "measure it again (python docs/remake.py {name})"
_SAMPLE = ", or a sample of it (--confirm {name})"


def told(name: str, record: Record | None) -> tuple[str, str]:
    """State of a record, and a line about it."""
    known = KNOWN[name]
    now = hashes(known.entry) if known.entry else {}
    found, changed = state(record, now)
    line = f"{name:22} {found:10} {known.about}"
    if record is not None:
        line += f"; measured {record.measured.on} in {spent(record.measured.seconds)} of one processor"
    if record is not None and record.confirmed:
        line += f"; {record.confirmed.sample} agreed on {record.confirmed.on}"
    if changed:
        line += f"; changed since: {', '.join(changed[:6])}" + (f" and {len(changed) - 6} more" if changed[6:] else "")
    return found, line


def faults() -> list[str]:
    """Sentences on what is not as it shall be: stale records, pages out of step, figures that are not listed."""
    found = []
    missing = [name for name in KNOWN if load(name) is None]
    for name in KNOWN:
        record = load(name)
        if record is not None and told(name, record)[0] == "stale":
            hint = _AGAIN + (_SAMPLE if KNOWN[name].sample else "")
            found.append(f"{told(name, record)[1]}: {hint.format(name=name)}")
    found += [
        f"{path.stem} is a record that no list knows"
        for path in FOLDER.glob("*.json")
        if path.stem not in {*KNOWN, pages.LIST.stem}
    ]
    found += [f"{path.relative_to(ROOT)} is out of step with its record: python docs/remake.py" for path in renewed()]
    listed = pages.unrecorded()
    found += [
        f"{name} has no record: measure it, or list it in {pages.LIST.name}"
        for name in missing
        if name not in listed.records
    ]
    found += [
        f"{page} has figures that come from no record: {', '.join(figures)}. Put them into a block that is made from a "
        f"record, or, where nobody of this project measured them, list them in {pages.LIST.name} as given"
        for page, figures in pages.unlisted(listed)
    ]
    if pages.shrunk(listed, missing) != listed:
        found.append(f"{pages.LIST.name} lists what is recorded or gone by now: python docs/remake.py")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("names", nargs="*", metavar="NAME", help="records to measure; without any, none is measured")
    parser.add_argument("--materials", type=Path, help="a folder with one real texture set in each subfolder")
    parser.add_argument(
        "--confirm", action="store_true", help="measure a sample, and keep the records that agree with it"
    )
    parser.add_argument(
        "--given", nargs="+", default=[], metavar="PAGE", help="nobody measured the new figures of these"
    )
    parser.add_argument("--check", action="store_true", help="write nothing; exit code 1 where something is stale")
    options = parser.parse_args()
    unknown = [name for name in options.names if name not in KNOWN]
    if unknown:
        parser.error(f"no record is called {', '.join(unknown)}: expected {', '.join(KNOWN)}")
    if not options.materials and any(MATERIALS in KNOWN[name].command for name in options.names):
        parser.error("these records are measured on real texture sets: name their folder with --materials")
    disagreed = [name for name in options.names if not renew(name, options.materials, options.confirm)]
    for name in KNOWN:
        print(told(name, load(name))[1])
    if options.check:
        found = faults()
        print(*(f"stale: {each}" for each in found), sep="\n")
        return 1 if found else 0
    make_pages(options.given)
    if disagreed:
        print(f"error: {', '.join(disagreed)} cannot be kept: measure them again", file=sys.stderr)
    return 1 if disagreed else 0


def renew(name: str, materials: Path | None, sample: bool) -> bool:
    """Measures a record again, or a sample of it; whether it may be printed now."""
    known, today = KNOWN[name], date.today().isoformat()
    if not sample:
        measure(name, known, materials, today).save()
        return True
    record = load(name)
    if record is None or not known.sample or materials is None:
        print(f"{name} has no record, or none that a sample confirms", file=sys.stderr)
        return False
    stamped, lines = confirm(record, known, materials, today)
    print(*lines, sep="\n", flush=True)
    if stamped is not None:
        stamped.save()
    return stamped is not None


def make_pages(given: Sequence[str]) -> None:
    """Writes what is out of step with the records, and shortens the list of what is unrecorded."""
    for path, content in renewed().items():
        if content is None:
            path.unlink()
        else:
            path.write_bytes(content)
        print(f"{path.relative_to(ROOT)} was {'removed' if content is None else 'made again'}")
    missing = [name for name in KNOWN if load(name) is None]
    pages.save(pages.grown(pages.shrunk(pages.unrecorded(), missing), given))
    print(f"unrecorded: {', '.join(missing) or 'nothing'}")


if __name__ == "__main__":
    sys.exit(main())
