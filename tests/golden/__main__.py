"""`python -m tests.golden`: what is not as it was recorded; with --renew, records what is."""

from __future__ import annotations

import argparse
import sys

from . import record


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.golden", description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of the names of results (default: all results)")
    parser.add_argument("--renew", action="store_true", help="record all results; say why in the commit")
    options = parser.parse_args()
    if options.renew:
        record.write({name: record.made(make) for name, make in record.everything().items()})
        return 0
    place, wanted = record.read()
    same = place == record.machine()
    print("every bit is compared" if same else f"means are compared: bits are those of {place}")
    different = []
    for name, make in record.everything().items():
        if not all(part in name for part in options.names):
            continue
        if name not in wanted or wanted[name].differs(record.made(make), same):
            different.append(name)
            print(name, "differs" if name in wanted else "is not in the record", flush=True)
    return 1 if different else 0


if __name__ == "__main__":
    sys.exit(main())
