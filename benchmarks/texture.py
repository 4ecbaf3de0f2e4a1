"""Texture lookups: mipbake.sampling.texture against torch's grid_sample, in one run; prints Markdown.

    python benchmarks/texture.py [--device cpu] [--side 1024] [--rounds 7]

The lookups are an image of side x side, in a texture of 2048 x 2048 with 4 float32 channels: at random places, or as a
camera makes them (`coherent`: rotated, about 1.5 texels apart and so between levels 0 and 1). torch's grid_sample is
bilinear, half the texels of a trilinear lookup; torch has nothing trilinear. Forward + backward computes the gradients
of the texels, or of the texels and of everything that places the lookup. The stack of levels is given, or built and
collapsed inside, which is part of the time then. Times are medians over the rounds, which alternate between the
candidates; the spread is (largest - smallest) / median.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import torch
from timing import Timing, arguments, measure, on_device, show
from torch import Tensor
from torch.nn.functional import grid_sample

from mipbake import _native, sampling

TEXTURE, CHANNELS = 2048, 4


@dataclass(frozen=True)
class Lookups:
    """uv (1, h, w, 2), and its image-space derivatives (1, h, w, 4)."""

    name: str
    uv: Tensor
    uv_da: Tensor


def random_lookups(side: int, device: torch.device) -> Lookups:
    """Independent places, and footprints from one texel to the whole texture."""
    generator = torch.Generator().manual_seed(0)
    lod = torch.rand(1, side, side, generator=generator) * math.log2(TEXTURE)
    angle = torch.rand(1, side, side, generator=generator) * math.tau
    rotation = torch.stack([angle.cos(), -angle.sin(), angle.sin(), angle.cos()], -1)
    uv = torch.rand(1, side, side, 2, generator=generator)
    return Lookups("random", uv.to(device), (rotation * (2**lod / TEXTURE)[..., None]).to(device))


def coherent_lookups(side: int, device: torch.device) -> Lookups:
    """An image of the texture, rotated by a tenth of a turn."""
    step, angle = 1.5 / TEXTURE, 0.1 * math.tau
    jacobian = torch.tensor([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]]) * step
    index = torch.arange(side) + 0.3
    pixel = torch.stack(torch.meshgrid(index, index, indexing="xy"), -1)
    uv = (pixel @ jacobian.T)[None] % 1
    uv_da = jacobian.reshape(1, 1, 1, 4).expand(1, side, side, 4).contiguous()
    return Lookups("coherent", uv.to(device), uv_da.to(device))


class Bench:
    """The two contestants on one device, each as a function of what needs gradients."""

    def __init__(self, device: torch.device, side: int, rounds: int) -> None:
        self.device, self.rounds = device, rounds
        generator = torch.Generator().manual_seed(1)
        self.tex = torch.rand(1, TEXTURE, TEXTURE, CHANNELS, generator=generator).to(device)
        self.planar = self.tex.permute(0, 3, 1, 2).contiguous()
        self.mip = sampling.texture_construct_mip(self.tex)
        self.grad = torch.rand(1, side, side, CHANNELS, generator=generator).to(device)
        self.grad_planar = self.grad.permute(0, 3, 1, 2).contiguous()

    def timed(self, candidates: dict[str, Callable[[], object]]) -> dict[str, Timing]:
        return measure(candidates, self.rounds, on_device(str(self.device))[1])

    def theirs(self, lookups: Lookups, needs: str) -> Callable[[], object]:
        grid = lookups.uv * 2 - 1

        def call() -> object:
            tex, where = self.planar, grid
            if "texels" in needs:
                tex = tex.detach().requires_grad_()
            if "coordinates" in needs:
                where = where.detach().requires_grad_()
            out = grid_sample(tex, where, mode="bilinear", padding_mode="border", align_corners=False)
            wanted = [t for t in (tex, where) if t.requires_grad]
            return torch.autograd.grad(out, wanted, self.grad_planar) if wanted else out

        return call

    def ours(
        self, lookups: Lookups, needs: str, mode: str = "linear-mipmap-linear", build: bool = False
    ) -> Callable[[], object]:
        def call() -> object:
            tex, uv, uv_da = self.tex, lookups.uv, lookups.uv_da
            if "texels" in needs:
                tex = tex.detach().requires_grad_()
            if "coordinates" in needs:
                uv, uv_da = uv.detach().requires_grad_(), uv_da.detach().requires_grad_()
            mipped = mode != "linear"
            mip = self.mip if mipped and not build else None
            out = sampling.texture(tex, uv, uv_da if mipped else None, mip=mip, filter_mode=mode, boundary_mode="clamp")
            wanted = [t for t in (tex, uv, *([uv_da] if mipped else [])) if t.requires_grad]
            return torch.autograd.grad(out, wanted, self.grad) if wanted else out

        return call

    def against_grid_sample(self, lookups: Lookups) -> Iterator[list[str]]:
        for needs in ("", "texels", "texels and coordinates"):
            name = f"{lookups.name}, forward" + (f" + backward to {needs}" if needs else "")
            timings = self.timed(
                {
                    "bilinear": self.ours(lookups, needs, "linear"),
                    "trilinear": self.ours(lookups, needs),
                    "built": self.ours(lookups, needs, build=True),
                    "grid_sample": self.theirs(lookups, needs),
                }
            )
            reference = timings["grid_sample"].median
            ours = [each.median for each in list(timings.values())[:3]]
            cells = [f"{median * 1e3:.1f} ms ({reference / median:.1f})" for median in ours]
            spread = max(t.spread for t in timings.values())
            yield [name, *cells, f"{reference * 1e3:.1f} ms", f"{spread:.0%}"]

    def anisotropic(self, lookups: Lookups) -> list[str]:
        """What torch has nothing to compare with, in milliseconds, and nanoseconds a lookup."""
        stretched = lookups.uv_da * torch.tensor([1.0, 0.25, 1.0, 0.25], device=self.device)
        call = self.ours(Lookups(lookups.name, lookups.uv, stretched), "", "anisotropic")
        found = self.timed({"anisotropic": call})["anisotropic"]
        each = found.median / lookups.uv[..., 0].numel() * 1e9
        time = f"{found.median * 1e3:.1f} ms ({each:.1f} ns, spread {found.spread:.0%})"
        return [f"{lookups.name}, anisotropic, 4 : 1, forward", time]


def main() -> None:
    options = arguments(__doc__, device="cpu", side=1024, rounds=7)
    device = torch.device(options.device)
    machine, _ = on_device(options.device)
    print(
        f"{machine}; {_native.num_threads()} threads ({torch.get_num_threads()} for torch); torch {torch.__version__}; "
        f"{options.side} x {options.side} lookups; "
        f"medians of {options.rounds} rounds, in brackets times faster than grid_sample\n"
    )
    bench = Bench(device, options.side, options.rounds)
    both = random_lookups(options.side, device), coherent_lookups(options.side, device)
    heads = ["lookups", "bilinear", "trilinear", "trilinear, levels built inside", "grid_sample (bilinear)", "spread"]
    show(heads, (row for lookups in both for row in bench.against_grid_sample(lookups)))
    print()
    show(["lookups", "mipbake"], [bench.anisotropic(both[0])])


if __name__ == "__main__":
    main()
