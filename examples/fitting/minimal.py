"""Fits a texture to pictures of a sphere that wears it: the whole of it, on a CPU, in seconds."""

import torch
from camera import random_quaternions, rotation_matrix, to_clip
from meshes import sphere
from textures import planet

import mipbake.nvdiffrast as dr

glctx = dr.RasterizeCudaContext(device="cpu")
mesh, target, generator = sphere(8), planet(32), torch.Generator().manual_seed(0)


def render(texture, rotation):
    pos = to_clip(mesh.positions, rotation, distance=3)
    rast, rast_db = dr.rasterize(glctx, pos, mesh.triangles, resolution=(64, 64))
    uv, uv_da = dr.interpolate(mesh.positions[None], rast, mesh.triangles, rast_db, diff_attrs="all")
    return dr.texture(texture, uv, uv_da, boundary_mode="cube") * (rast[..., 3:] > 0)


learned = torch.full_like(target, 0.5, requires_grad=True)
optimiser = torch.optim.Adam([learned], lr=0.05)
for _ in range(200):
    rotation = rotation_matrix(random_quaternions(2, generator))
    loss = (render(learned, rotation) - render(target, rotation)).square().mean()
    optimiser.zero_grad()
    loss.backward()
    optimiser.step()
print(f"PSNR of the texture: {-10 * torch.log10((learned.detach() - target).square().mean()):.1f} dB")
