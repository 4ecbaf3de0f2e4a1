"""Adam on few long vectors: the parameters of a network lie one after the other, and so do their gradients.

A step of an optimiser over dozens of small tensors costs more in calls than in arithmetic. What is trained with one
source alone, as an encoder of a cross-trained network is (`Network.only_of`), is a vector of its own: in steps that it
has no part in, it and its moments stay as they are.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from mipbake.models.base import Network
from mipbake.training.config import OptimiserConfig


@dataclass
class _Together:
    """Parameters that are trained together: views of a vector, their gradients views of another."""

    vector: nn.Parameter
    gradient: Tensor
    average: Tensor | None


class FlatAdam:
    """Adam and the moving average, in place on the parameters of a network.

    Args:
        network: its parameters become views of vectors: one for each source that has parameters of its own, and one
            for all others.
        average: its twin, whose parameters follow as the moving average; None for none.
    """

    def __init__(self, network: Network, average: Network | None, settings: OptimiserConfig) -> None:
        self._settings = settings
        named = dict(network.named_parameters())
        twins = dict(average.named_parameters()) if average is not None else {}
        groups: dict[str, list[str]] = {}
        for name in named:
            groups.setdefault(network.only_of(name), []).append(name)
        self._parts: dict[str, _Together] = {}
        for part, names in groups.items():
            vector = nn.Parameter(_flattened([named[n] for n in names]))
            gradient = torch.zeros_like(vector)
            for n, view in zip(names, _views(gradient, [named[n] for n in names]), strict=True):
                named[n].grad = view
            mean = _flattened([twins[n] for n in names]) if twins else None
            self._parts[part] = _Together(vector, gradient, mean)
        self._adam = torch.optim.Adam(
            [part.vector for part in self._parts.values()],
            settings.learning_rate,
            (settings.beta1, settings.beta2),
            settings.epsilon,
            fused=True,
        )

    def zero_grad(self) -> None:
        """Clears the gradients, in place: a backward pass adds to them."""
        for part in self._parts.values():
            part.gradient.zero_()

    def gradients(self, source: str) -> list[Tensor]:
        """The gradients that a step takes, a vector each: of all parameters except those that other sources train."""
        return [part.gradient for name, part in self._parts.items() if name in ("", source)]

    def step(self, index: int, source: str) -> None:
        """Moves all parameters except those that other sources alone train; `index` decides the rate."""
        for group in self._adam.param_groups:
            group["lr"] = self._settings.rate(index)
        for name, part in self._parts.items():
            part.vector.grad = part.gradient if name in ("", source) else None
        if self._settings.clip:
            vectors = [part.vector for part in self._parts.values() if part.vector.grad is not None]
            torch.nn.utils.clip_grad_norm_(vectors, self._settings.clip)
        self._adam.step()
        for part in self._parts.values():
            if part.average is not None:
                part.average.lerp_(part.vector.detach(), 1 - self._settings.ema_decay)

    def state_dict(self) -> dict[str, Tensor]:
        """Adam's moments and step counts, `<index of the vector> <name>`."""
        kept = self._adam.state_dict()["state"].items()
        return {f"{index} {name}": value for index, state in kept for name, value in state.items()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        """Takes back what `state_dict` gave."""
        found: dict[int, dict[str, Tensor]] = {}
        for key, value in state.items():
            index, _, name = key.partition(" ")
            found.setdefault(int(index), {})[name] = value
        self._adam.load_state_dict({**self._adam.state_dict(), "state": found})


def _flattened(parameters: list[nn.Parameter]) -> Tensor:
    """A vector of all values, which the parameters are views of from now on, in the memory format that they have."""
    vector = torch.cat([_as_stored(p.detach()).reshape(-1) for p in parameters])
    for parameter, view in zip(parameters, _views(vector, parameters), strict=True):
        parameter.data = view
    return vector


def _views(vector: Tensor, parameters: list[nn.Parameter]) -> list[Tensor]:
    views, first = [], 0
    for parameter in parameters:
        shape = _as_stored(parameter).shape
        view = vector[first : first + parameter.numel()].view(shape)
        views.append(view.movedim(-1, 1) if parameter.ndim == 4 else view)
        first += parameter.numel()
    return views


def _as_stored(parameter: Tensor) -> Tensor:
    """Kernels of convolutions with the maps that they read last, as channels-last memory has them."""
    return parameter.movedim(1, -1) if parameter.ndim == 4 else parameter
