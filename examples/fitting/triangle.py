"""One triangle, red, green and blue at its corners: rasterised, its colours interpolated, and saved as tri.png.

nvdiffrast's documentation calls this sample the first step: where its picture is right, the installation works.

    python examples/fitting/triangle.py --cuda                writes tri.png into the current folder
    python examples/fitting/triangle.py --opengl              the same with the other context
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import report
import torch

import mipbake.nvdiffrast as dr

SIZE = 256
FILE = Path("tri.png")


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    chosen = parser.add_mutually_exclusive_group(required=True)
    chosen.add_argument("--cuda", action="store_true", help="rasterise with RasterizeCudaContext")
    chosen.add_argument("--opengl", action="store_true", help="rasterise with RasterizeGLContext")
    opengl = parser.parse_args(arguments).opengl
    device = "cuda" if torch.cuda.is_available() else "cpu"

    glctx = dr.RasterizeGLContext() if opengl else dr.RasterizeCudaContext()
    pos = torch.tensor([[[-0.8, -0.8, 0, 1], [0.8, -0.8, 0, 1], [-0.8, 0.8, 0, 1]]], device=device)
    col = torch.tensor([[[1.0, 0, 0], [0, 1, 0], [0, 0, 1]]], device=device)
    tri = torch.tensor([[0, 1, 2]], dtype=torch.int32, device=device)
    rast, _ = dr.rasterize(glctx, pos, tri, resolution=[SIZE, SIZE])
    image, _ = dr.interpolate(col, rast, tri)
    report.write_picture(FILE, report.upright(image[0]))
    print(f"the picture is in {FILE}")


if __name__ == "__main__":
    main()
