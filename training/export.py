"""Releasing a checkpoint: the tensors, their description and the model card."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path
from statistics import fmean

from mipbake.base.errors import UsageError
from mipbake.base.publish import replaced_file
from mipbake.models.architecture import Description
from mipbake.models.registry import WEIGHTS_LICENCE, WeightsInfo, check_sole_default
from mipbake.training.config import TrainingConfig
from mipbake.training.loop import load_state
from mipbake.training.validation import Figures

_CARD = """# {info.name}

The trained weights of a network, for the method `neural` of mipbake.

| | |
|---|---|
| Reads | {encoders} |
| Makes | {decoders} |
| Pixel filters | {filters} |
| Method | {described.method} |
| Encoder | {described.encoder} |
| Latents | {described.latents} |
| Decoder | {described.decoder} |
| Parameters | {parameters} |
| Trained on | {info.data} |
| Licence of the data | {info.data_licence} |
| Training | {info.steps} steps, in each {crops} of {loss.crop_size} x {loss.crop_size} texels |
| Light-view pairs | {loss.pairs} for each patch, {loss.drawn} |
| Revision of mipbake | {info.commit} |
| Licence of the weights | {info.licence} |
| SHA-256 | `{info.sha256}` |

The weights hold no texel of the data. Levels of detail beyond {loss.max_lod} are extrapolated: the training saw none.

{validation}
"""

_BASELINES = {"linear": "plain averages", "lean": "LEAN"}
"""What cards call the closed forms that a validation measures."""

_VALIDATION = """\
Mean SNR in dB on held-out patches, near the mirror / over the hemisphere. Plain averages and LEAN, both with the box,
are measured alike on the same patches:

{table}

{words}"""


def export_weights(checkpoint: Path, name: str, folder: Path, default: bool) -> WeightsInfo:
    """Writes NAME.safetensors, NAME.json and NAME.md from the averaged weights of a checkpoint.

    Raises:
        UsageError: the name is not a plain file name, the checkpoint is a baseline, or other weights in the folder are
            the default already.
        InputError: the checkpoint cannot be read. OutputError: the folder cannot be written.
    """
    import torch
    from safetensors.torch import save

    if not re.fullmatch(r"[a-z0-9][a-z0-9._-]*", name):
        raise UsageError(f"weights' name {name!r} must be lower-case letters, digits, '.', '_' and '-'")
    state = load_state(checkpoint)
    config, described = state.config, state.config.network.describe()
    if described is None:
        raise UsageError(f"{checkpoint}: a baseline, which is compared with and not released; export another training")
    tensors = {
        key: value.detach().clone(memory_format=torch.contiguous_format)
        for key, value in state.average.state_dict().items()
    }
    content = save(tensors)
    info = WeightsInfo(
        name=name,
        network=config.network,
        pixel_filters=config.loss.pixel_filters,
        default=default,
        steps=state.step,
        commit=state.commit,
        data=config.data.description,
        data_licence=config.data.licence,
        licence=WEIGHTS_LICENCE,
        sha256=hashlib.sha256(content).hexdigest(),
        folder=folder,
    )
    if default:
        check_sole_default(info)
    parameters = sum(value.numel() for value in state.average.parameters())
    # The description last: without it nobody finds half-written weights.
    replaced_file(info.tensors, content)
    replaced_file(folder / f"{name}.md", card(info, described, config, parameters, state.figures).encode())
    replaced_file(folder / f"{name}.json", info.to_json().encode())
    return info


def _listed(models: tuple[str, ...]) -> str:
    *others, last = [f"`{model}`" for model in models]
    return f"{', '.join(others)} and {last}" if others else last


def card(info: WeightsInfo, described: Description, config: TrainingConfig, parameters: int, figures: Figures) -> str:
    """The model card.

    Args:
        info: what is said of the weights elsewhere, too.
        described: what is said of the architecture.
        config: of the training.
        parameters: how many numbers the network has.
        figures: of the last validation before; empty where there was none.
    """
    return _CARD.format(
        info=info,
        loss=config.loss,
        described=described,
        encoders=_listed(info.network.encoders),
        decoders=_listed(info.network.decoders),
        filters=_listed(info.pixel_filters),
        parameters=parameters,
        crops="1 patch" if config.loss.crops == 1 else f"{config.loss.crops} patches",
        validation=_validation(figures),
    )


def _validation(figures: Figures) -> str:
    """The network beside closed forms, and whether it is behind one of them in the mean."""
    if not figures:
        return "The network was not validated."
    names = {"network": "network", **_BASELINES}
    rows = [["model that is made", *names.values()], ["---"] * (1 + len(names))]
    for model, methods in figures.items():
        rows.append([f"`{model}`", *(" / ".join(f"{snr:.2f}" for snr in methods[name]) for name in names)])
    mean = {name: fmean(snr for methods in figures.values() for snr in methods[name]) for name in names}
    words = []
    for name, shown in _BASELINES.items():
        gain = mean["network"] - mean[name]
        words.append(f"{'ahead of' if gain >= 0 else '**behind**'} {shown} by {abs(gain):.2f} dB")
    table = "\n".join(f"| {' | '.join(row)} |" for row in rows)
    return _VALIDATION.format(table=table, words=f"In the mean of its figures the network is {' and '.join(words)}.")
