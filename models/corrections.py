"""What a decoder may change about the averages of a level's texel: every change vanishes where a material is constant.

Colours that diffuse light is seen in stay averages, because diffuse light is linear in them. Colours of highlights may
change: the colours of metals, and a specular reflectance.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import torch
from torch import Tensor

from mipbake.material import Kind, MaterialModel, most_roughness
from mipbake.models.channels import channels, count, has_log_gamma, has_metallic, has_specular, parts, places
from mipbake.models.moment_statistics import Statistics
from mipbake.models.moments import Moments, least_roughness, moment_places
from mipbake.models.parameters import of_coordinates

T = TypeVar("T")


@dataclass(frozen=True)
class Outputs(Generic[T]):
    """What the decoder says of a texel.

    Args:
        to_lean, to_widened, to_geometric, to_quartic: shares of these changes of ln roughness.
        roughness: of what may change freely. gain: of a metal's colour, freely.
        metallic_colour, metallic_variance: shares of these changes of base colour and of metallic.
        lean_normal: share of this change of the normal. tilt: how much more the normal leans. normal: freely.
        choice: of the texels that the lobe stands for.
        specular_gain: of a specular reflectance, freely. tall_specular, upward_specular: shares of these changes of it.
        log_gamma: of what may change freely.
    """

    to_lean: T = field(metadata=channels(1))
    to_widened: T = field(metadata=channels(1))
    to_geometric: T = field(metadata=channels(1))
    to_quartic: T = field(metadata=channels(1))
    roughness: T = field(metadata=channels(1))
    gain: T = field(metadata=channels(3, has_metallic))
    metallic_colour: T = field(metadata=channels(1, has_metallic))
    metallic_variance: T = field(metadata=channels(1, has_metallic))
    lean_normal: T = field(metadata=channels(1))
    tilt: T = field(metadata=channels(1))
    normal: T = field(metadata=channels(2))
    choice: T = field(metadata=channels(2))
    specular_gain: T = field(metadata=channels(3, has_specular))
    tall_specular: T = field(metadata=channels(1, has_specular))
    upward_specular: T = field(metadata=channels(1, has_specular))
    log_gamma: T = field(metadata=channels(1, has_log_gamma))


def output_places(model: MaterialModel) -> Outputs[slice]:
    """Where each output stands among the outputs for a model that is made."""
    found: Outputs[slice] = places(Outputs, model)
    return found


def output_count(model: MaterialModel) -> int:
    """How many numbers a decoder says of a texel."""
    return count(Outputs, model)


CRISP = 3
"""How much more sharpening there is of colours, of lobes, and of normals: -1 for none, to 1 for twice. Not tuned: one
for each."""

_CAUTION = 2.0  # logarithm of how much an untrained network prefers all texels to the bright ones
_DECISION = 5.0  # what an output of 1 counts in that logarithm

_MOST_GAIN = 0.5  # of a metal's colour, as a logarithm
_MOST_SPECULAR_GAIN = 1.5  # of a specular reflectance, as a logarithm
_MOST_PEAK = 0.5  # of ln gamma
_MOST_CHANGE = 3.0  # of ln roughness
_NARROWER = 0.1  # ln of roughness: how much narrower a lobe may be than the lobes that it stands for
_FARTHEST = 0.5  # share of a lobe's alpha by which its normal may move freely
_MAX_LENGTH2, _MIN_HEIGHT2 = 0.999, 1e-4  # of baked normals: the derivative of sqrt(1 - x^2) has no bound


def _choice(out: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Shares of a lobe for all texels, and for the bright ones by either weight; (..., 2) outputs to (..., 1) each.

    Width and direction of a lobe go together: a sharp highlight of bright texels is no use around another normal.
    """
    logits = torch.cat([torch.zeros_like(out[..., :1]), _DECISION * out - _CAUTION], -1)
    shares = logits.softmax(-1)
    return shares[..., :1], shares[..., 1:2], shares[..., 2:]


def more(detail: Tensor, crisp: Tensor, model: MaterialModel) -> Tensor:
    """What more sharpening adds to the averages of a model's first moments, up to the normal, in their order.

    Args:
        detail: (..., n) what sharpening added. crisp: (..., CRISP).
    """
    colours, lobes, normals = (crisp[..., i : i + 1] for i in range(CRISP))
    where = moment_places(model)
    return torch.cat(
        [
            colours * detail[..., : where.specular.stop],
            lobes * detail[..., where.roughness.start : where.log_gamma.stop],
            normals * detail[..., where.normal],
        ],
        -1,
    )


def corrected(
    found: Statistics, out: Tensor, added: Tensor, read: MaterialModel, made: MaterialModel
) -> Mapping[Kind, Tensor]:
    """What a model stores of a round lobe: the averages, changed.

    Args:
        found: averages of the model that is read. out: (..., output_count) outputs for the model that is made.
        added: what sharpening adds to the averages (more).

    Returns:
        Channels by the kinds of parts, colours and shares as one; and roughness, whatever stands for it.
    """
    said: Outputs[Tensor] = parts(output_places(made), out)
    where = moment_places(read)
    kept, tall, upward = _choice(said.choice)
    change = said.to_lean * found.to_lean + said.to_widened * found.to_widened + said.to_geometric * found.to_geometric
    change = kept * (change + said.to_quartic * found.to_quartic) + tall * found.to_tall + upward * found.to_upward
    freedom = kept * found.freedom + tall * found.tall_freedom + upward * found.upward_freedom
    change = change + freedom * said.roughness.tanh()
    shaded = found.log_roughness.exp()
    # What lies below the roughness that is shaded is kept beside the change, so that a change of nothing changes
    # nothing.
    below = found.roughness - found.roughness.clamp(min=least_roughness(read))
    least = found.to_narrowest - _NARROWER * freedom
    factor = torch.maximum(change, least).clamp(max=_MOST_CHANGE).exp()
    roughness = (shaded * factor + below + added[..., where.roughness]).clamp(0, most_roughness(made))
    peak = found.log_gamma + _MOST_PEAK * freedom * said.log_gamma.tanh() + added[..., where.log_gamma]
    tilt = (1 + freedom * said.tilt.tanh()) * found.normal + kept * said.lean_normal * found.lean_normal
    tilt = tilt + tall * found.tall_normal + upward * found.upward_normal
    # A highlight is lost when it moves by its own width, however far the texels spread.
    reach = torch.minimum(found.spread.sqrt(), _FARTHEST * roughness.square())
    xy = tilt + reach * said.normal.tanh() + added[..., where.normal]
    xy = xy * (xy.square().sum(-1, keepdim=True) / _MAX_LENGTH2).clamp(min=1).rsqrt()
    height = (1 - xy.square().sum(-1, keepdim=True)).clamp(min=_MIN_HEIGHT2).sqrt()
    return {
        Kind.REFLECTANCE: _colours(found, said, added, where),
        Kind.ROUGHNESS: roughness,
        Kind.NORMAL: torch.cat([xy, height], -1),
        Kind.NORMAL_XY: xy,
        Kind.LOG_GAMMA: of_coordinates(peak, Kind.LOG_GAMMA, made.least_alpha2),
    }


def _colours(found: Statistics, said: Outputs[Tensor], added: Tensor, where: Moments[slice]) -> Tensor:
    """(..., 4) base colour and metallic, or (..., 6) both reflectances."""
    gain = _MOST_GAIN * found.colour_freedom.clamp(max=1) * found.metallic * said.gain.tanh()
    base = found.base * gain.exp() + said.metallic_colour * found.metallic_colour
    metallic = found.metallic + said.metallic_variance * found.metallic_variance
    # A lobe that stands for some of the texels reflects less than they do, and lobes differ where colours do not.
    freedom = (found.colour_freedom + found.freedom).clamp(max=1)
    specular = found.specular * (_MOST_SPECULAR_GAIN * freedom * said.specular_gain.tanh()).exp()
    specular = specular + said.tall_specular * found.tall_specular + said.upward_specular * found.upward_specular
    colours = (base, where.base), (metallic, where.metallic), (found.diffuse, where.diffuse), (specular, where.specular)
    return torch.cat([(colour + added[..., place]).clamp(0, 1) for colour, place in colours], -1)
