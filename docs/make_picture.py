"""Makes docs/scales.png, which opens the README: spheres at four scales, plain MIP maps, mipbake, and reference.

    python docs/make_picture.py [--set FOLDER] [--side 192] [--passes 4096] [--figures FILE] [OUT]

Prints the SNR of every sphere against the reference, which also stands below it, and writes it to a file, from which
the caption is made (`python docs/remake.py --measure picture` does both). The views are those that `mipbake compare`
measures; radiance is shown as x / (1 + x), then sRGB.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pictures
from PIL import Image

from mipbake.quality import environment
from mipbake.quality.figures import SCALES
from mipbake.quality.metrics import snr_db

GAP, HEAD, NAME, FIGURE = 10, 44, 27, 21  # pixels: between spheres, and of the lines of words


Spheres = dict[str, dict[str, tuple[pictures.Picture, float]]]
"""Scale to name to the sphere and its SNR in dB, nan for the reference's."""


def figures(folder: Path, side: int, passes: int) -> tuple[Spheres, dict[str, Mapping[str, object]]]:
    """The spheres, and what was measured, by scale."""
    made: Spheres = {}
    found: dict[str, Mapping[str, object]] = {}
    for scale, view in pictures.spheres(folder, environment.studio(), side).items():
        frames, reference = pictures.render(folder, view, passes)
        inside = reference.interior
        halves = reference.first[inside], reference.second[inside]
        row = {
            name: (pictures.shown(frame.image), snr_db(frame.image[inside], *halves)) for name, frame in frames.items()
        }
        words = ", ".join(f"{name} {snr:.1f} dB" for name, (_, snr) in row.items())
        print(
            f"{view.title}: {words}; reference of {reference.passes} samples a pixel, "
            f"standard error {reference.standard_error:.2g} beside an error of {reference.candidate_error:.2g}",
            flush=True,
        )
        made[scale] = row | {pictures.REFERENCE: (pictures.shown(reference.image), float("nan"))}
        found[scale] = {
            "snr": {name: snr for name, (_, snr) in row.items()},
            "passes": reference.passes,
            "noise": reference.standard_error / reference.candidate_error,
        }
    return made, found


def texels(scale: str) -> str:
    """How much of the texture a pixel covers in the middle of a scale."""
    count = round(2 ** (sum(SCALES[scale]) / 2), 1)
    return "1 texel a pixel" if count == 1 else f"{count:.3g} texels a pixel"


def composed(made: Spheres, side: int) -> Image.Image:
    names = list(next(iter(made.values())))
    row = NAME + side + FIGURE
    width, height = len(made) * (side + GAP) + GAP, HEAD + len(names) * row - FIGURE + GAP
    image, pen = pictures.panel(width, height)
    for i, (scale, spheres) in enumerate(made.items()):
        left = GAP + i * (side + GAP)
        middle = left + side // 2
        pen.text((middle, 20), scale, pictures.BRIGHT, pictures.font(17), anchor="ms")
        pen.text((middle, 37), texels(scale), pictures.DIM, pictures.font(12), anchor="ms")
        for j, name in enumerate(names):
            picture, snr = spheres[name]
            top = HEAD + j * row + NAME
            image.paste(Image.fromarray(picture), (left, top))
            if np.isfinite(snr):
                best = snr == max(s for _, s in spheres.values() if np.isfinite(s))
                colour = pictures.GOOD if best else pictures.DIM
                pen.text((middle, top + side + 13), f"{snr:.1f} dB", colour, pictures.font(13), anchor="ms")
    for j, name in enumerate(names):
        baseline = HEAD + j * row + 19
        pen.text((GAP + 4, baseline), name, pictures.BRIGHT, pictures.font(15), anchor="ls")
        after = GAP + 4 + pen.textlength(name, pictures.font(15)) + 8
        pen.text((after, baseline), pictures.MEANING[name], pictures.DIM, pictures.font(12), anchor="ls")
    return image


def main() -> None:
    parser = argparse.ArgumentParser(description="the README's picture")
    parser.add_argument("out", type=Path, nargs="?", default=Path(__file__).parent / "scales.png")
    parser.add_argument("--set", type=Path, default=pictures.SET, help="a texture set")
    parser.add_argument("--side", type=int, default=192, help="pixels of a sphere's picture")
    parser.add_argument("--passes", type=int, default=4096, help="samples a pixel of the reference, at most")
    parser.add_argument("--figures", type=Path, help="a .json file of what was measured")
    options = parser.parse_args()
    made, found = figures(options.set, options.side, options.passes)
    composed(made, options.side).save(options.out, optimize=True)
    if options.figures:
        about = {"set": options.set.name, "side": options.side, "most": options.passes, "scales": found}
        options.figures.write_text(json.dumps(about), encoding="utf-8")


if __name__ == "__main__":
    main()
