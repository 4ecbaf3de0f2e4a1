"""Fits a texture in several processes, each with its own graphics card, or with none.

torch.nn.parallel.DistributedDataParallel wraps what renders, as it wraps any other module: every process draws views of
its own, and a step takes the mean of all their gradients. So the textures of all processes stay the same, and equal
what one process finds that draws all of these views. Each process makes its context on its own card. On cards the
processes talk by NCCL, else by Gloo.

    torchrun --standalone --nproc-per-node 2 examples/fitting/several.py
    torchrun --standalone --nproc-per-node 8 examples/fitting/several.py --device cuda
"""

import argparse
import os

import torch
import torch.distributed as dist
from camera import random_quaternions, rotation_matrix, to_clip
from meshes import sphere
from report import number, psnr
from textures import planet

import mipbake.nvdiffrast as dr


class Planet(torch.nn.Module):
    """A sphere that wears a texture, which is its parameter, and shows the squared distance to another one."""

    def __init__(self, target, device):
        super().__init__()
        self.glctx, self.mesh, self.target = dr.RasterizeCudaContext(device), sphere(8).to(device), target.to(device)
        self.texture = torch.nn.Parameter(torch.full(target.shape, 0.5, device=device))

    def forward(self, rotation):
        pos = to_clip(self.mesh.positions, rotation, distance=3)
        rast, rast_db = dr.rasterize(self.glctx, pos, self.mesh.triangles, resolution=(64, 64))
        uv, uv_da = dr.interpolate(self.mesh.positions[None], rast, self.mesh.triangles, rast_db, diff_attrs="all")
        shown = [dr.texture(texture, uv, uv_da, boundary_mode="cube") for texture in (self.texture, self.target)]
        return ((shown[0] - shown[1]) * (rast[..., 3:] > 0)).square().mean()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--device", default="cpu", choices=("cpu", "cuda"))
    parser.add_argument("--views", type=number(int), default=4, help="of a step, for all processes together")
    parser.add_argument("--iterations", type=number(int), default=200)
    parser.add_argument("--output", help="a file for the texture")
    options = parser.parse_args()
    device = options.device
    if device == "cuda":
        device = f"cuda:{os.environ['LOCAL_RANK']}"
        torch.cuda.set_device(device)
    dist.init_process_group("nccl" if options.device == "cuda" else "gloo")
    rank, count = dist.get_rank(), dist.get_world_size()
    if options.views % count:
        raise SystemExit(f"--views is {options.views}: expected a multiple of the {count} processes")
    torch.set_num_threads(1)

    target, generator = planet(32), torch.Generator().manual_seed(0)
    model = torch.nn.parallel.DistributedDataParallel(Planet(target, device))
    optimiser = torch.optim.Adam(model.parameters(), lr=0.05)
    for _ in range(options.iterations):
        # All processes draw the same views, and each takes its share.
        views = random_quaternions(options.views, generator).chunk(count)[rank].to(device)
        loss = model(rotation_matrix(views))
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()
    texture = model.module.texture.detach().cpu()
    if rank == 0:
        print(f"processes: {count}, PSNR of the texture: {psnr(texture, target):.1f} dB")
        if options.output:
            torch.save(texture, options.output)
    dist.destroy_process_group()


if __name__ == "__main__":
    main()
