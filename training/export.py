"""Releasing a checkpoint: the tensors, their description and the model card."""

from __future__ import annotations

import hashlib
import math
import re
from pathlib import Path

from mipbake.errors import OutputError, UsageError
from mipbake.models.config import AnyConfig, NetworkConfig
from mipbake.models.moments import COUNT
from mipbake.models.registry import WEIGHTS_LICENCE, WeightsInfo, check_sole_default
from mipbake.prefilter.pixel_filter import FILTERS
from mipbake.training.baseline import BaselineConfig
from mipbake.training.config import BalancedLossConfig, LossConfig, TrainingConfig
from mipbake.training.loop import load_state

_CARD = """# {name}

Weights of mipbake's `neural` method: {parameters} parameters that turn a texture set into a MIP stack, level 0
included, for rendering with the pixel filter {filters}. They read {encoders} and make {decoders}.

| | |
|---|---|
| Method | {method} |
| Architecture | {architecture} |
| Trained on | {data} |
| Licence of the data | {data_licence} |
| Training | {steps} steps of {crops} patches of {crop_size} x {crop_size} texels and {pairs} light-view pairs{drawn} |
| Validation when exported | {validation} |
| Revision | {commit} |
| Licence of the weights | {licence} |
| SHA-256 | `{sha256}` |

The weights are a few hundred kilobytes of numbers; they hold no texel of the data. Levels beyond {max_lod}, the last
seen in training, are extrapolated: the decoder meets averages over ever larger areas. A surface whose normals fall into
several distinct directions within a pixel cannot be matched by one lobe; there the result is a compromise.
"""

_PAPER = "Kemppinen, Aittala and Lehtinen: Data-driven Pixel Filter Aware MIP Maps for SVBRDFs, 2023"


def export_weights(checkpoint: Path, name: str, folder: Path, default: bool) -> WeightsInfo:
    """Writes NAME.safetensors, NAME.json and NAME.md from the averaged weights of a checkpoint.

    Raises:
        UsageError: the name is no plain file name; a baseline; other weights in the folder are the default already.
        InputError: the checkpoint cannot be read. OutputError: the folder cannot be written.
    """
    import torch
    from safetensors.torch import save

    if not re.fullmatch(r"[a-z0-9][a-z0-9._-]*", name):
        raise UsageError(f"weights' name {name!r} must be lower-case letters, digits, '.', '_' and '-'")
    state = load_state(checkpoint)
    network = state.config.network
    if isinstance(network, BaselineConfig):
        raise UsageError(f"{checkpoint}: a baseline, which is compared with and not released; export another training")
    tensors = {
        key: value.detach().clone(memory_format=torch.contiguous_format)
        for key, value in state.average.state_dict().items()
    }
    content = save(tensors)
    config = state.config
    info = WeightsInfo(
        name=name,
        network=network,
        pixel_filters=_filters(config.loss),
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
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # The description last: without it nobody finds half-written weights.
        _write(info.tensors, content)
        _write(folder / f"{name}.md", _card(info, config, parameters, state.best).encode())
        _write(folder / f"{name}.json", info.to_json().encode())
    except OSError as error:
        raise OutputError(f"{folder}: the weights cannot be written ({error.strerror})") from error
    return info


def _filters(loss: LossConfig | BalancedLossConfig) -> tuple[str, ...]:
    """The pixel filters that a training was for, its main one first."""
    others = FILTERS if isinstance(loss, BalancedLossConfig) and loss.any_filter > 0 else ()
    return tuple(dict.fromkeys((loss.pixel_filter, *others)))


def _listed(models: tuple[str, ...]) -> str:
    *others, last = [f"`{model}`" for model in models]
    return f"{', '.join(others)} and {last}" if others else last


def _write(path: Path, content: bytes) -> None:
    temporary = path.with_suffix(path.suffix + ".partial")
    temporary.write_bytes(content)
    temporary.replace(path)


def _card(info: WeightsInfo, config: TrainingConfig, parameters: int, best: float) -> str:
    loss = config.loss
    drawn = ", drawn for both pair sets by importance"
    if isinstance(loss, LossConfig):
        drawn = f", {loss.mirror_pairs} of them near the mirror direction"
    return _CARD.format(
        name=info.name,
        parameters=parameters,
        filters=_listed(info.pixel_filters),
        encoders=_listed(info.network.encoders),
        decoders=_listed(info.network.decoders),
        method=_PAPER if isinstance(info.network, NetworkConfig) else f"averages of moments, corrected; after {_PAPER}",
        architecture=_architecture(info.network),
        data=info.data,
        data_licence=info.data_licence,
        steps=info.steps,
        crops=loss.crops,
        crop_size=loss.crop_size,
        pairs=loss.pairs,
        drawn=drawn,
        validation=f"mean SNR {best:.2f} dB on held-out patches" if math.isfinite(best) else "none",
        commit=info.commit,
        licence=info.licence,
        sha256=info.sha256,
        max_lod=loss.max_lod,
    )


def _architecture(network: AnyConfig) -> str:
    if isinstance(network, NetworkConfig):
        return (
            f"encoder {network.encoder_layers} layers of 3 x 3, decoder {network.decoder_layers} of 1 x 1, "
            f"{network.growth} new maps a layer, {network.latent_channels} latent channels, latents downsampled with "
            f"`{network.latent_filter}`"
        )
    return (
        f"encoder {network.convolutions} layers of 3 x 3 and {network.pointwise} of 1 x 1, {network.growth} new maps a "
        f"layer; {network.latent_channels} learned latent channels beside {COUNT} moments, filtered with the pixel "
        f"filter; decoder {network.decoder_layers} layers of 1 x 1, {network.decoder_growth} new maps a layer"
    )
