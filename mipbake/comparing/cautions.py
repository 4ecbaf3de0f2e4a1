"""What a reader of a comparison must know, in sentences: what figures leave out, and which of them noise is in."""

from __future__ import annotations

import math
import shlex
from collections.abc import Sequence

from mipbake.comparing.pictures import RESOLVED_SHARE
from mipbake.comparing.result import FilmedScene, Scene
from mipbake.material import losses, model_named
from mipbake.quality.figures import Method
from mipbake.quality.samplers import RenderSampler, baked_for
from mipbake.stack.written import BAKED


def limits(source: str, target: str, opened_one: bool) -> tuple[str, ...]:
    """What the figures of stacks of model `target` leave out, or cannot reach, in sentences.

    Args:
        source, target: material models.
        opened_one: whether a stack that was opened is compared.
    """
    said = ["methods that were baked here were measured in 32-bit floats, not in the 8 bits of files."]
    if opened_one:
        said = [
            f"{BAKED} was measured as its files hold it; methods that were baked here were measured in 32-bit floats."
        ]
    given, wanted, lost = model_named(source), model_named(target), losses(source, target)
    if given.coated and lost.diffuse:
        said.append(
            f"the diffuse term of {source} loses the light that a dielectric's surface reflects, and the diffuse term "
            f"of {target} does not: this difference between the models is in the error of every method, and no stack "
            "can avoid it."
        )
    if lost.lobe:
        said.append(
            f"the highlights of {source} have {given.lobe.tails}, and the highlights of {target} have "
            f"{wanted.lobe.tails}: this difference between the models is in the error of every method."
        )
    if lost.anisotropy:
        said.append(
            f"stacks of {target} are isotropic and the source is not: this difference is in the error of every method."
        )
    return tuple(said)


def made_for_others(methods: Sequence[Method], sampler: RenderSampler) -> tuple[str, ...]:
    """A sentence for every stack that was made for another sampler than stacks were looked up with."""
    return tuple(
        f"{each.name} was made for the sampler {each.sampler}, and stacks were looked up with the sampler {sampler}: "
        f"with --sampler {shlex.quote(str(each.sampler))} the comparison shows {each.name} as it was meant."
        for each in methods
        if each.sampler not in (None, baked_for(sampler))
    )


def not_converged(scenes: Sequence[Scene], films: Sequence[FilmedScene]) -> tuple[str, ...]:
    """A sentence about all references of pictures that did not converge, and one about the references of films."""
    pictures = [_noisy(each, each.standard_error) for each in scenes if not each.converged]
    moving = [_noisy(each, each.noise) for each in films if not each.converged]
    sentences = []
    for what, found in (("renders", pictures), ("films", moving)):
        if found:
            sentences.append(
                f"the noise of the reference should be at most {RESOLVED_SHARE:.0%} of the best candidate's error, and "
                f"it is more in {', '.join(found)}: the noise counts as error in all measures of these {what} except "
                "SNR and flicker."
            )
    return tuple(sentences)


def _noisy(scene: Scene | FilmedScene, noise: float) -> str:
    share = noise / scene.candidate_error if scene.candidate_error else math.inf
    left = f"{share:.0%} of the error" if share < 1 else "all of the error or more"
    return f"{scene.name} ({left} after {scene.passes} samples per pixel)"
