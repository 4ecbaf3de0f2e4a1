"""Makes FOLDER/scales.png, which opens the README: spheres at four scales, plain MIP maps, mipbake, and truth.

    python docs/make_picture.py FOLDER [--side 192] [--passes 4096] [--results FILE]

Prints the SNR of every sphere against the truth, and writes it to a file, from which the caption is made
(`python docs/remake.py --measure picture` does both). The views are those that `mipbake compare` measures; radiance is
shown as x / (1 + x), then sRGB.
"""

from __future__ import annotations

import pictures
from records.scripts import script

from mipbake.quality import environment
from mipbake.quality.metrics import snr_db

timing = script("benchmarks", "timing")


def main() -> None:
    options = timing.arguments(__doc__, "folder", side=192, passes=4096, results=None)
    names = (pictures.PLAIN, pictures.BAKED, pictures.REFERENCE)
    rows: dict[str, list[pictures.Cell]] = {name: [] for name in names}
    found = {}
    for scale, view in pictures.spheres(environment.studio(), options.side).items():
        frames, reference = pictures.render(view, options.passes)
        inside = reference.interior
        halves = reference.first[inside], reference.second[inside]
        snr = {name: snr_db(frame.image[inside], *halves) for name, frame in frames.items()}
        for name, frame in frames.items():
            rows[name].append(pictures.Cell(pictures.shown(frame.image)))
        rows[pictures.REFERENCE].append(pictures.Cell(pictures.shown(reference.image)))
        found[scale] = {
            "snr": snr,
            "passes": reference.passes,
            "noise": reference.standard_error / reference.candidate_error,
        }
        print(view.title, snr, flush=True)
    pictures.grid(list(found), rows, pictures.LETTERS).save(options.folder / "scales.png", optimize=True)
    timing.keep(
        {"set": pictures.SET.name, "side": options.side, "most": options.passes, "scales": found}, options.results
    )


if __name__ == "__main__":
    main()
