"""The plain torch twins of the shading kernels: every model written out as its equations, and nothing native.

They are the oracle of the tests, in float64, and the yardstick of the benchmark. Autograd differentiates them, also in
the lights and views, and they run wherever torch does. docs/conventions.md has the equations.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import torch
from torch import Tensor

from mipbake.material import DIELECTRIC_F0, MAX_LOG_GAMMA, MIN_ROUGHNESS, model_named
from mipbake.shading._arguments import LIT_AXES, TurnedAway, batch_shape, is_black, lit_batch

__all__ = ["MODELS", "beckmann_distribution", "distribution", "shade", "shade_lit"]


class Surface(NamedTuple):
    """What the shared lobe needs of each texel; tensors are (..., channels)."""

    albedo: Tensor
    f0: Tensor
    normal: Tensor
    tensor: Tensor
    """S11, S22, S12 of the roughness tensor, in the tangent frame of the normal."""
    dielectric_diffuse: bool
    """Whether the diffuse term carries glTF's factor 1 - F_d, with F_d = 0.04 + 0.96 (1 - l.h)^5."""
    gamma: Tensor | None = None
    """Exponent of the generalised Beckmann distribution; None for GGX."""
    isotropic: bool = False
    """Whether w_t^T S w_t is alpha^2 (1 - w_n^2) of a cosine that is held, and not of the direction itself."""


def shade(model: str, material: Tensor, light: Tensor, view: Tensor, *, turned_away: TurnedAway = "clamp") -> Tensor:
    """f(theta, l, v), the cosine included: arguments, shapes and result of `mipbake.shading.shade`."""
    batch, *_ = batch_shape(model_named(model).channels, material.shape, light.shape, view.shape)
    surface = MODELS[model](material.clamp(-1e4, 1e4).unsqueeze(-3))  # (B, 1, N, .), against pairs of (B, K, 1 or N, 3)
    light, view = (d if d.ndim == 4 else d.unsqueeze(-2) for d in (light, view))
    radiance = evaluate(surface, light, view, is_black(turned_away))
    return radiance if batch is None or radiance.ndim == 4 else radiance[None]


def shade_lit(
    model: str,
    material: Tensor,
    frame: Tensor,
    view: Tensor,
    light: Tensor,
    radiance: Tensor,
    *,
    turned_away: TurnedAway = "clamp",
) -> Tensor:
    """The sum over lights of radiance f(theta, l, v): arguments, shapes and result of `mipbake.shading.shade_lit`."""
    given = (material, frame, view, light, radiance)
    surfaces = lit_batch(model_named(model).channels, *(tuple(each.shape) for each in given))
    if surfaces is not None:
        every = [
            each.expand(surfaces, *each.shape[-axes:]) for each, axes in zip(given, LIT_AXES.values(), strict=True)
        ]
        return torch.stack([shade_lit(model, *one, turned_away=turned_away) for one in zip(*every, strict=True)])
    local_light = torch.einsum("nij,kj->kni", frame, light)
    local_view = torch.einsum("nij,nj->ni", frame, view).expand_as(local_light)
    f = shade(model, material, local_light[None], local_view[None], turned_away=turned_away)[0]
    return torch.einsum("knc,kc->nc", f, radiance)


def evaluate(s: Surface, light: Tensor, view: Tensor, black: bool = False) -> Tensor:
    """f = (k albedo / pi + D V F) l_n, 0 where l_n <= 0; D is 0 where h_n <= 0, and V holds v_n to 1e-4. With `black` f
    is 0 where v_n <= 0, and v_n is not held. Shapes broadcast."""
    total = light + view
    half = total / total.norm(dim=-1, keepdim=True).clamp_min(1e-15)
    lt, lb, ln = _in_frame(light, s.normal)
    vt, vb, vn = _in_frame(view, s.normal)
    lit = (ln > 1e-9) & (vn > 1e-9) if black else (ln > 1e-9) & torch.isfinite(vn)
    reflected = lit & (ln + vn > 0)
    # Unlit pairs get an upright geometry, so that no gradient through torch.where is NaN.
    ln, vn = torch.where(lit, ln, 1.0), torch.where(lit, vn if black else vn.clamp_min(1e-4), 1.0)
    masking = _ggx_masking if s.gamma is None else _beckmann_masking
    if s.isotropic:
        alpha2 = s.tensor[..., 0]
        form_l, form_v = alpha2 * (1 - ln * ln), alpha2 * (1 - vn * vn)
    else:
        form_l, form_v = _form(s.tensor, lt, lb), _form(s.tensor, vt, vb)
    visibility = 0.5 / (ln * masking(vn, form_v) + vn * masking(ln, form_l))
    schlick = (1 - (light * half).sum(-1)).clamp_min(0) ** 5
    fresnel = s.f0 + (1 - s.f0) * schlick[..., None]
    weight = (1 - DIELECTRIC_F0) * (1 - schlick) if s.dielectric_diffuse else torch.ones_like(schlick)
    # What reflects nothing gets a half vector along the normal, for the same reason.
    half = torch.where(reflected[..., None], half, s.normal)
    if s.gamma is None:
        d = distribution(s.tensor, s.normal, half)
    else:
        d = beckmann_distribution(s.tensor, s.gamma, s.normal, half)
    specular = torch.where(reflected, d * visibility, 0.0)
    f = (s.albedo / math.pi * weight[..., None] + fresnel * specular[..., None]) * ln[..., None]
    return torch.where(lit[..., None], f, 0.0)


def distribution(tensor: Tensor, normal: Tensor, half: Tensor) -> Tensor:
    """GGX: D(h) = 1 / (pi sqrt(det S) (h_t^T S^-1 h_t + h_n^2)^2) for (..., 3) S11, S22, S12, normals and unit h."""
    ht, hb, hn = _in_frame(half, normal)
    s11, s22, s12 = tensor.unbind(-1)
    det = s11 * s22 - s12 * s12
    q = (s22 * ht * ht - 2 * s12 * ht * hb + s11 * hb * hb) / det + hn * hn
    # Only a half vector of length 0 makes q vanish; it is never lit.
    return 1 / (math.pi * torch.sqrt(det) * torch.where(q > 0, q, 1.0) ** 2)


def beckmann_distribution(tensor: Tensor, gamma: Tensor, normal: Tensor, half: Tensor) -> Tensor:
    """Generalised Beckmann (Aittala et al. 2015): D(h) = exp(-q^gamma) / (pi Gamma(1 + 1/gamma) sqrt(det S) h_n^4).

    q = h_t^T S^-1 h_t / h_n^2 for (..., 3) S11, S22, S12; (...) gamma; normals and unit h. gamma = 1 is Beckmann. Below
    q = 1e-20, where the slope of the power has no bound for gamma < 1, its chord from 0. h_n is at least 1e-6.
    """
    ht, hb, hn = _in_frame(half, normal)
    s11, s22, s12 = tensor.unbind(-1)
    det = s11 * s22 - s12 * s12
    # h_t^T S^-1 h_t with S = L L^T: L^-1 h_t, whose squares do not cancel.
    first = ht / torch.sqrt(s11)
    second = (hb - s12 / s11 * ht) * torch.sqrt(s11 / det)
    q = (first * first + second * second) / hn.clamp_min(1e-20) ** 2
    power = torch.exp((gamma * torch.log(q.clamp_min(1e-20))).clamp_max(6.6)) * (q * 1e20).clamp_max(1)
    norm = torch.exp(torch.lgamma(1 + 1 / gamma))
    return torch.exp(-power) / (math.pi * norm * torch.sqrt(det) * hn.clamp_min(1e-6) ** 4)


def _ggx_masking(w_n: Tensor, form: Tensor) -> Tensor:
    """w_n (1 + 2 Lambda(w)) of Smith's Lambda for GGX, form = w_t^T S w_t: sqrt(w_n^2 + form)."""
    return torch.sqrt(w_n * w_n + form)


def _beckmann_masking(w_n: Tensor, form: Tensor) -> Tensor:
    """w_n (1 + 2 Lambda(w)) with Beckmann's Lambda = (erf a - 1) / 2 + exp(-a^2) / (2 a sqrt pi), a = w_n / sqrt(form).

    Walter et al. 2007, section 5.2. This is masking for gamma = 1, whatever gamma is: an approximation.
    """
    flat = form < 1e-4 * w_n * w_n  # there a is beyond 100, and Lambda is 0
    s = torch.sqrt(torch.where(flat, 1.0, form))
    a = w_n / s
    rough = w_n * torch.erf(a) + s / math.sqrt(math.pi) * torch.exp(-a * a)
    return torch.where(flat, w_n, rough)


def _form(tensor: Tensor, t: Tensor, b: Tensor) -> Tensor:
    s11, s22, s12 = tensor.unbind(-1)
    return s11 * t * t + 2 * s12 * t * b + s22 * b * b


def _in_frame(w: Tensor, n: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Components of w along t = normalize(x - (x.n) n), b = n x t and n; t = (0, 0, -sign(n.x)) where n is +x or -x."""
    nx, ny, nz = n.unbind(-1)
    p = ny * ny + nz * nz
    usable = p > 1e-16
    inverse = torch.rsqrt(torch.where(usable, p, 1.0))
    side = torch.where(nx > 0, -1.0, 1.0).to(n.dtype)
    by, bz = torch.where(usable, nz * inverse, -side * nx), torch.where(usable, -ny * inverse, 0.0)
    tx, ty = by * nz - bz * ny, bz * nx
    tz = torch.where(usable, -by * nx, side)
    x, y, z = w.unbind(-1)
    return x * tx + y * ty + z * tz, y * by + z * bz, x * nx + y * ny + z * nz


def _normalized(v: Tensor, axis: int) -> Tensor:
    """v / |v|; the unit vector along `axis` where v is shorter than 1e-6."""
    length2 = (v * v).sum(-1, keepdim=True)
    usable = length2 > 1e-12
    fallback = torch.zeros_like(v)
    fallback[..., axis] = 1
    return torch.where(usable, v * torch.rsqrt(torch.where(usable, length2, 1.0)), fallback)


def _gltf(c: Tensor) -> Surface:
    base, metallic, alpha = c[..., 0:3], c[..., 3:4], c[..., 4].clamp(MIN_ROUGHNESS, 100) ** 2
    f0 = DIELECTRIC_F0 + (base - DIELECTRIC_F0) * metallic
    tensor = torch.stack([alpha * alpha, alpha * alpha, torch.zeros_like(alpha)], -1)
    return Surface(base * (1 - metallic), f0, _normalized(c[..., 5:8], 2), tensor, True, isotropic=True)


def _gltf_anisotropic(c: Tensor) -> Surface:
    alpha = c[..., 4].clamp(MIN_ROUGHNESS, 100) ** 2
    along, across = (alpha + (1 - alpha) * c[..., 10].clamp(-1, 1) ** 2) ** 2, alpha**2
    x, y = _normalized(c[..., 8:10], 0).unbind(-1)
    tensor = torch.stack([along * x * x + across * y * y, along * y * y + across * x * x, (along - across) * x * y], -1)
    return _gltf(c[..., 0:8])._replace(tensor=tensor, isotropic=False)


def _ggx(c: Tensor) -> Surface:
    return Surface(c[..., 0:3], c[..., 3:6], _lifted(c[..., 6:8]), _tensor_exp(c[..., 8:11]), False)


def _beckmann(c: Tensor) -> Surface:
    return _ggx(c[..., 0:11])._replace(gamma=c[..., 11].clamp(-MAX_LOG_GAMMA, MAX_LOG_GAMMA).exp())


def _lifted(xy: Tensor) -> Tensor:
    """z = sqrt(1 - x^2 - y^2), its chord over the last 1e-8 before the rim; outside the disc (x, y) is scaled to it."""
    r2 = (xy * xy).sum(-1, keepdim=True)
    xy = xy * torch.where(r2 > 1, torch.rsqrt(r2.clamp_min(1)), 1.0)
    z2 = (1 - r2).clamp_min(0)
    return torch.cat([xy, torch.where(z2 > 1e-8, torch.sqrt(z2.clamp_min(1e-8)), z2 * 1e4)], -1)


def _tensor_exp(abc: Tensor) -> Tensor:
    """exp([[a, c], [c, b]]) = e^m (cosh r I + sinh(r) / r [[d, c], [c, -d]]), m = (a + b) / 2, d = (a - b) / 2.

    Kemppinen et al. 2023, equation 6. m is held to [-30, 10] and r = sqrt(d^2 + c^2) to 20.
    """
    a, b, c = abc.unbind(-1)
    m, d = ((a + b) / 2).clamp(-30, 10), (a - b) / 2
    r2 = d * d + c * c
    limit = torch.where(r2 > 400, 20 * torch.rsqrt(r2.clamp_min(400)), 1.0)
    d, c, r2 = d * limit, c * limit, r2.clamp_max(400)
    small = r2 < 1e-2
    r = torch.sqrt(torch.where(small, 1.0, r2))
    sinhc = torch.where(small, 1 + r2 / 6 * (1 + r2 / 20 * (1 + r2 / 42 * (1 + r2 / 72))), torch.sinh(r) / r)
    cosh = torch.where(small, 1 + r2 / 2 * (1 + r2 / 12 * (1 + r2 / 30 * (1 + r2 / 56))), torch.cosh(r))
    return torch.exp(m)[..., None] * torch.stack([cosh + sinhc * d, cosh - sinhc * d, sinhc * c], -1)


MODELS: Mapping[str, Callable[[Tensor], Surface]] = {
    "gltf": _gltf,
    "gltf-anisotropic": _gltf_anisotropic,
    "ggx": _ggx,
    "beckmann": _beckmann,
}
"""The texel that each model makes from its (..., C) stored channels."""
