"""The one door to the package cvvdp, which asks for far more when it is imported than ColorVideoVDP needs.

cvvdp 0.5.7 imports torchvision for one blur, and ffmpeg and huggingface_hub for what mipbake does not call. Builds of
torchvision fit one build of torch each, so on many machines there is none that can be imported. All three are stood in
for here, also where they are installed, so that figures do not hang on it, and only while the package is imported:
afterwards `sys.modules` and `sys.path` are as they were, and the package itself is known to nobody but this door.
"""

from __future__ import annotations

import importlib
import importlib.util
import sys
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.machinery import ModuleSpec
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, NoReturn

from mipbake.base.errors import UsageError

if TYPE_CHECKING:
    import torch

_NAME = "pycvvdp"
_TO_TYPE = 'python -m pip install "mipbake[films]" && python -m pip install --no-deps cvvdp==0.5.7'
_LOCK = threading.Lock()  # for imports of one thread must not be taken for imports of another


class GaussianBlur:
    """What cvvdp uses of torchvision.transforms.GaussianBlur: a Gaussian of odd `kernel_size` taps, mirrored borders.

    The weights are exp(-x^2 / (2 sigma^2)) at the integers x from -(kernel_size // 2) to kernel_size // 2, over their
    sum, along rows and then along columns. The border is mirrored about the centre of the edge pixel.
    """

    def __init__(self, kernel_size: int, sigma: float) -> None:
        self._reach, self._sigma = kernel_size // 2, float(sigma)

    def forward(self, image: torch.Tensor) -> torch.Tensor:
        """(N, 1, H, W) to the same shape; H and W are larger than kernel_size // 2. Gradients pass."""
        import torch
        from torch.nn import functional

        x = torch.arange(-self._reach, self._reach + 1, dtype=image.dtype, device=image.device)
        weights = torch.exp(-0.5 * (x / self._sigma) ** 2)
        weights = weights / weights.sum()
        padded = functional.pad(image, [self._reach] * 4, mode="reflect")
        return functional.conv2d(functional.conv2d(padded, weights.view(1, 1, 1, -1)), weights.view(1, 1, -1, 1))


def cvvdp_package() -> ModuleType:
    """The package `pycvvdp`, imported once.

    Raises:
        UsageError: the package, or something that it needs and that nothing stands in for, is not installed.
    """
    with _LOCK:
        return _imported()


@cache
def _imported() -> ModuleType:
    try:
        spec = importlib.util.find_spec(_NAME)
        if spec is None or not spec.submodule_search_locations:
            raise ModuleNotFoundError(f"No module named {_NAME!r}")
        with _alone(Path(spec.submodule_search_locations[0])):
            return importlib.import_module(_NAME)
    except ImportError as error:
        raise UsageError(
            f"a film is judged by ColorVideoVDP, which is not installed ({error}): type '{_TO_TYPE}'"
        ) from None


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """Within, the package in `folder` finds its own files and everything that it asks for; after, no trace is left.

    It puts its folder on sys.path and imports files of its own under bare names, such as `interp`. Modules of other
    people under these names, and what is stood in for, are put aside.
    """
    own = {_NAME, *(path.stem for path in folder.iterdir()), *(name.partition(".")[0] for name in _STAND_INS)}
    aside = {name: module for name, module in sys.modules.items() if name.partition(".")[0] in own}
    path = list(sys.path)
    for name in aside:
        del sys.modules[name]
    sys.path.insert(0, str(folder))
    try:
        for name, attributes in _STAND_INS.items():
            sys.modules[name] = made = importlib.util.module_from_spec(ModuleSpec(name, None))
            vars(made).update(attributes)
            if "." in name:
                holder, _, attribute = name.rpartition(".")
                setattr(sys.modules[holder], attribute, made)
        yield
    finally:
        sys.path[:] = path
        for name in [each for each in sys.modules if each.partition(".")[0] in own]:
            del sys.modules[name]
        sys.modules.update(aside)


def _not_there(*_: object, **__: object) -> NoReturn:
    raise NotImplementedError("mipbake imports cvvdp for ColorVideoVDP alone, without what other metrics of it need")


_STAND_INS: Mapping[str, Mapping[str, object]] = {
    "torchvision": {},
    "torchvision.transforms": {"GaussianBlur": GaussianBlur},
    "torchvision.ops": {"MLP": _not_there},
    "ffmpeg": {},
    "huggingface_hub": {"hf_hub_download": _not_there},
}
"""Modules that are stood in for, with what is in them."""
