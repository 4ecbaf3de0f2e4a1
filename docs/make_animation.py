"""Makes FOLDER/shimmer.webp: a slowly turning sphere, with plain MIP maps, mipbake's, and supersampled, in a loop.

    python docs/make_animation.py FOLDER [--side 236] [--frames 64] [--passes 256] [--results FILE]

The texture lies around the sphere a whole number of times and turns by one of its repeats, so the last frame runs into
the first. Prints each candidate's flicker (its mean squared change from frame to frame over the reference's) and SNR,
over all frames, and writes them to a file, from which the caption is made (`python docs/remake.py --measure animation`
does both). Radiance is shown as x / (1 + x), then sRGB.
"""

from __future__ import annotations

import numpy as np
import pictures
from records.scripts import script

from mipbake.comparing.scenes import median_lod
from mipbake.quality import environment
from mipbake.quality.metrics import flicker_ratio, snr_db

timing = script("benchmarks", "timing")

REPEATS = 8  # times that the texture lies around the sphere


def lamp_in_a_studio() -> environment.Lighting:
    """Most light from one lamp, the hardest case for shimmer, the rest from soft boxes."""
    lamp, boxes = environment.key(), environment.studio(16)
    radiance = np.concatenate([0.9 * lamp.radiance, 0.5 * boxes.radiance])
    return environment.directional("a lamp in a studio", np.concatenate([lamp.direction, boxes.direction]), radiance)


def main() -> None:
    options = timing.arguments(__doc__, "folder", side=236, frames=64, passes=256, results=None)
    at_rest = pictures.spheres(lamp_in_a_studio(), options.side)["near"]
    radiance: dict[str, list[np.ndarray]] = {pictures.PLAIN: [], pictures.BAKED: []}
    halves: list[np.ndarray] = []
    images = []
    for index in range(options.frames):
        view = pictures.turned(at_rest, REPEATS, index / options.frames)
        # All samples are always taken, at the same places in the pixels: a reference that stopped earlier in some
        # frames than in others would flicker by its noise.
        frames, reference = pictures.render(view, options.passes, resolved_share=0)
        for name, frame in frames.items():
            radiance[name].append(frame.image)
        halves.append(np.stack([reference.first, reference.second]))
        row = [pictures.Cell(pictures.shown(each.image)) for each in (*frames.values(), reference)]
        images.append(pictures.grid([*frames, pictures.REFERENCE], {"": row}, pictures.LETTERS))
        print(f"\rframe {index + 1} of {options.frames}", end="", flush=True)
    inside = reference.interior  # the outline stays where it is
    first, second = (np.stack(half)[:, inside] for half in zip(*halves, strict=True))
    texture_set, _ = pictures.load()
    lod = median_lod(view.mesh, view.camera, view.resolution, (texture_set.height, texture_set.width))
    print(f"\nmedian lod {lod:.2f}")
    found: dict[str, dict[str, float]] = {}
    for name, candidate in radiance.items():
        p = np.stack(candidate)[:, inside]
        found[name] = {"flicker": flicker_ratio(p, first, second), "snr": snr_db(p, first, second)}
        print(f"{name}: flicker {found[name]['flicker']:.2f}, SNR {found[name]['snr']:.1f} dB")
    about = {"set": pictures.SET.name, "frames": options.frames, "passes": options.passes, "lod": lod}
    timing.keep(about | {"methods": found}, options.results)
    images[0].save(
        options.folder / "shimmer.webp",
        save_all=True,
        append_images=images[1:],
        duration=50,
        loop=0,
        quality=70,
        method=6,
    )


if __name__ == "__main__":
    main()
