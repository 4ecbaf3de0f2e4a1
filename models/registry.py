"""Released weights: which there are, and loading them with their hash verified.

Weights have three files, in models/weights or any other folder: `<name>.safetensors` holds the tensors, `<name>.json`
the typed description below, `<name>.md` the model card.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from functools import lru_cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from mipbake import _native
from mipbake.base.device import PROCESSOR
from mipbake.base.errors import InputError, MipbakeError, UsageError
from mipbake.base.names import known_name
from mipbake.material import MODELS
from mipbake.models.architecture import Architecture, Baker
from mipbake.models.architectures import ARCHITECTURES

if TYPE_CHECKING:
    from mipbake.models.base import Network

_Made = TypeVar("_Made")

WEIGHTS_FOLDER = Path(__file__).parent / "weights"
WEIGHTS_LICENCE = "CC0-1.0"


@dataclass(frozen=True)
class WeightsInfo:
    """What `<name>.json` says.

    Args:
        name: what users call the weights.
        network: architecture.
        pixel_filters: that the network was trained for.
        default: whether bakes of this model and pixel filter use it when nobody names another.
        steps: training steps behind it.
        commit: revision of this project that trained it.
        data: what it was trained on; data_licence the licence of that.
        licence: licence of the weights.
        sha256: hash of the safetensors file.
        folder: where the three files lie; not part of the file.
    """

    name: str
    network: Architecture
    pixel_filters: tuple[str, ...]
    default: bool
    steps: int
    commit: str
    data: str
    data_licence: str
    licence: str
    sha256: str
    folder: Path = WEIGHTS_FOLDER

    @property
    def targets(self) -> tuple[str, ...]:
        """Material models that the weights can make."""
        return self.network.targets

    @property
    def tensors(self) -> Path:
        """The safetensors file."""
        return self.folder / f"{self.name}.safetensors"

    def to_json(self) -> str:
        """Text of `<name>.json`."""
        content = asdict(self)
        del content["folder"]
        content["network"] = {"architecture": self.network.architecture, **content["network"]}
        return json.dumps(content, indent=2) + "\n"


def read_info(path: Path) -> WeightsInfo:
    """The description in that JSON file; InputError when it does not hold one."""
    try:
        content: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        described = _tuples(content.pop("network"))
        network = ARCHITECTURES[described.pop("architecture")](**described)
        info = WeightsInfo(network=network, folder=path.parent, **_tuples(content))
    except (OSError, ValueError, TypeError, AttributeError, KeyError, RecursionError, MipbakeError) as error:
        raise InputError(
            f"{path}: not a description of mipbake weights ({error}); install the release again"
        ) from error
    wrong = [
        f.name for f in fields(info) if f.type in _TYPES and not isinstance(getattr(info, f.name), _TYPES[str(f.type)])
    ]
    if wrong or info.name != path.stem:
        fault = ", ".join(wrong) or "name"
        raise InputError(f"{path}: wrong value of {fault} in a description of weights; install the release again")
    return info


_TYPES: dict[str, type] = {"str": str, "int": int, "bool": bool, "tuple[str, ...]": tuple}


def _tuples(content: dict[str, Any]) -> dict[str, Any]:
    """JSON has lists where the descriptions have tuples."""
    return {key: tuple(value) if isinstance(value, list) else value for key, value in content.items()}


def list_weights(folder: Path = WEIGHTS_FOLDER) -> list[WeightsInfo]:
    """Every set of weights in a folder, by name; empty when there is none."""
    return [read_info(path) for path in sorted(folder.glob("*.json"))]


def find_weights(name: str, folder: Path = WEIGHTS_FOLDER) -> WeightsInfo:
    """The weights of that name; UsageError with the list of names when there are none."""
    found = {info.name: info for info in list_weights(folder)}
    return found[known_name("weights", name, found)]


def default_weights(
    target: str, pixel_filter: str = "gaussian", folder: Path = WEIGHTS_FOLDER, source: str = "gltf"
) -> WeightsInfo:
    """The weights that bakes of a target use: the default ones that fit it.

    Weights that see all of the source come before others, then weights with a decoder of the target's own.

    Raises:
        UsageError: no weights were released for the target and the pixel filter.
        InputError: several default weights fit equally well.
    """
    every = list_weights(folder)
    found = [info for info in every if info.default and info.network.takes(source)]
    fitting = _best(found, target, pixel_filter, source)
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise InputError(
            f"{folder} holds several default weights for material model {target!r} with pixel filter "
            f'{pixel_filter!r}, {", ".join(info.name for info in fitting)}: expected one, so set "default" to false in '
            "the .json files of the others"
        )
    released = ", ".join(sorted({f"{t} with {f}" for i in found for t in i.targets for f in i.pixel_filters})) or "none"
    others = [i.name for i in every if target in i.targets and pixel_filter in i.pixel_filters]
    named = f", name some that are no default ({', '.join(others)})" if others else ""
    raise UsageError(
        f"no trained weights for material model {target!r} with pixel filter {pixel_filter!r} (released: {released}); "
        f"choose one of those{named}, or another method"
    )


def check_sole_default(info: WeightsInfo) -> None:
    """UsageError where other default weights in the folder of `info` fit a bake as well as `info` would."""
    others = [each for each in list_weights(info.folder) if each.default and each.name != info.name]
    for target, pixel_filter, source in product(info.targets, info.pixel_filters, MODELS):
        found = [each for each in (info, *others) if each.network.takes(source)]
        fitting = _best(found, target, pixel_filter, source)
        if info in fitting and len(fitting) > 1:
            other = next(each for each in fitting if each is not info)
            raise UsageError(
                f"{other.name} are the default weights for material model {target!r} with pixel filter "
                f'{pixel_filter!r} already: set "default" to false in {other.folder / other.name}.json first, or leave '
                "--default out and name the new weights in bakes"
            )


def _best(found: Sequence[WeightsInfo], target: str, pixel_filter: str, source: str) -> list[WeightsInfo]:
    """Of some weights those that suit a bake best, all of them where several are equal."""
    fitting = [info for info in found if target in info.targets and pixel_filter in info.pixel_filters]
    ranks = [(not info.network.reads(source), target not in info.network.decoders) for info in fitting]
    return [info for info, rank in zip(fitting, ranks, strict=True) if rank == min(ranks)]


def load_network(info: WeightsInfo) -> Network:
    """The network in torch with its weights, ready for inference.

    Raises:
        InputError: the safetensors file is missing, or is not the one that was released.
    """
    from mipbake.models.base import network_of

    return _fitting(info, network_of)


def load_baker(info: WeightsInfo, device: str = PROCESSOR) -> Baker:
    """What bakes with the weights: the native core where it is compiled for the device and has the architecture, else
    torch.

    Args:
        info: the weights.
        device: one that `mipbake.base.device.checked_device` knows.

    Raises:
        InputError: the safetensors file is missing, or is not the one that was released.
    """
    if device == PROCESSOR or (device.startswith("cuda") and _native.cuda_compiled()):
        return _fitting(info, lambda config, tensors, filters: config.baker(tensors, filters, device))
    return _network_on(info, device)


# `auto` and `refine` bake a part first, to see how long the whole takes: loading is not to count there.
@lru_cache(maxsize=4)
def _network_on(info: WeightsInfo, device: str) -> Network:
    return load_network(info).to(device)


def _fitting(
    info: WeightsInfo,
    make: Callable[[Architecture, Mapping[str, NDArray[np.float32]], tuple[str, ...]], _Made],
) -> _Made:
    """What is made of an architecture, its tensors and its pixel filters."""
    from safetensors import SafetensorError
    from safetensors.numpy import load

    try:
        content = info.tensors.read_bytes()
    except OSError as error:
        raise InputError(
            f"{info.tensors}: the weights {info.name!r} cannot be read ({error.strerror}); install the release again"
        ) from error
    digest = hashlib.sha256(content).hexdigest()
    if digest != info.sha256:
        raise InputError(
            f"{info.tensors}: damaged or altered weights, expected SHA-256 {info.sha256[:12]}..., found "
            f"{digest[:12]}...; install the release again"
        )
    try:
        return make(info.network, load(content), info.pixel_filters)
    except (KeyError, ValueError, SafetensorError) as error:
        raise InputError(
            f"{info.tensors}: the tensors are damaged or do not fit the architecture in {info.name}.json; install the "
            "release again"
        ) from error
