"""Makes docs/shimmer.webp: a slowly turning sphere, with plain MIP maps, mipbake's, and supersampled, in a loop.

    python docs/make_animation.py [--set FOLDER] [--side 236] [--frames 64] [--passes 256] [--figures FILE] [OUT]

The texture lies around the sphere a whole number of times and turns by one of its repeats, so the last frame runs into
the first. Prints each candidate's flicker (its mean squared change from frame to frame over the reference's) and SNR,
over all frames, and writes them to a file, from which the caption is made (`python docs/remake.py --measure animation`
does both). Radiance is shown as x / (1 + x), then sRGB.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import pictures
from PIL import Image

from mipbake.comparing.scenes import median_lod
from mipbake.quality import environment
from mipbake.quality.metrics import flicker_ratio, snr_db

GAP, HEAD = 6, 30  # pixels: between spheres, and of the line of words


def lamp_in_a_studio() -> environment.Lighting:
    """Most light from one lamp, the hardest case for shimmer, the rest from soft boxes."""
    lamp, boxes = environment.key(), environment.studio(16)
    radiance = np.concatenate([0.9 * lamp.radiance, 0.5 * boxes.radiance])
    return environment.directional("a lamp in a studio", np.concatenate([lamp.direction, boxes.direction]), radiance)


def main() -> None:
    parser = argparse.ArgumentParser(description="the README's animation")
    parser.add_argument("out", type=Path, nargs="?", default=Path(__file__).parent / "shimmer.webp")
    parser.add_argument("--set", type=Path, default=pictures.SET, help="a texture set")
    parser.add_argument("--side", type=int, default=236, help="pixels of a sphere's picture")
    parser.add_argument("--repeats", type=int, default=8, help="how often the texture lies around the sphere")
    parser.add_argument("--frames", type=int, default=64)
    parser.add_argument("--rate", type=float, default=20, help="frames a second")
    parser.add_argument("--passes", type=int, default=256, help="samples a pixel of the reference")
    parser.add_argument("--quality", type=float, default=80, help="of the lossy compression, up to 100")
    parser.add_argument("--figures", type=Path, help="a .json file of what was measured")
    options = parser.parse_args()

    at_rest = pictures.spheres(options.set, lamp_in_a_studio(), options.side)["near"]
    radiance: dict[str, list[np.ndarray]] = {pictures.PLAIN: [], pictures.BAKED: []}
    halves: list[np.ndarray] = []
    images = []
    for index in range(options.frames):
        view = pictures.turned(at_rest, options.repeats, index / options.frames)
        # All samples are always taken, at the same places in the pixels: a reference that stopped earlier in some
        # frames than in others would flicker by its noise.
        frames, reference = pictures.render(options.set, view, options.passes, resolved_share=0)
        for name, frame in frames.items():
            radiance[name].append(frame.image)
        halves.append(np.stack([reference.first, reference.second]))
        spheres = {name: pictures.shown(frame.image) for name, frame in frames.items()}
        images.append(composed(spheres | {pictures.REFERENCE: pictures.shown(reference.image)}, options.side))
        print(f"\rframe {index + 1} of {options.frames}", end="", flush=True)
    inside = reference.interior  # the outline stays where it is
    first, second = (np.stack(half)[:, inside] for half in zip(*halves, strict=True))
    texture_set, _ = pictures.load(options.set)
    lod = median_lod(view.mesh, view.camera, view.resolution, (texture_set.height, texture_set.width))
    print(f"\nmedian lod {lod:.2f}")
    found: dict[str, dict[str, float]] = {}
    for name, candidate in radiance.items():
        p = np.stack(candidate)[:, inside]
        found[name] = {"flicker": flicker_ratio(p, first, second), "snr": snr_db(p, first, second)}
        print(f"{name}: flicker {found[name]['flicker']:.2f}, SNR {found[name]['snr']:.1f} dB")
    if options.figures:
        about = {"set": options.set.name, "frames": options.frames, "passes": options.passes, "lod": lod}
        options.figures.write_text(json.dumps(about | {"methods": found}), encoding="utf-8")
    images[0].save(
        options.out,
        save_all=True,
        append_images=images[1:],
        duration=round(1000 / options.rate),
        loop=0,
        quality=options.quality,
        method=6,
    )
    print(f"{options.out}: {options.out.stat().st_size / 1e6:.2f} MB")


def composed(spheres: dict[str, pictures.Picture], side: int) -> Image.Image:
    image, pen = pictures.panel(len(spheres) * (side + GAP) - GAP, HEAD + side)
    for i, (name, picture) in enumerate(spheres.items()):
        left = i * (side + GAP)
        image.paste(Image.fromarray(picture), (left, HEAD))
        pen.text((left + side // 2, 22), name, pictures.BRIGHT, pictures.font(16), anchor="ms")
    return image


if __name__ == "__main__":
    main()
