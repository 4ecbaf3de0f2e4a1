"""Steps on a graphics card, recorded once and then replayed.

A step is hundreds of short kernels, and asking for each of them takes longer than it runs. So the first step of each
kind of batch is recorded as a graph, and later steps are one call each.

A recorded step reads the same memory every time, where each batch is copied to, and asks nothing of the processor. One
thing has to be found out in between: which signs directions take, where a model stores directions
(`mipbake.material.directions`). A graph of its own makes the levels that this is found in, and the graph of the step
reads what was found.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, field
from typing import TypeVar

import torch
from torch import Tensor

from mipbake.material import MaterialModel, model_named
from mipbake.material.pixel_filter import Wrap
from mipbake.models.base import Network
from mipbake.models.parameters import Agreement, agreement, agreements_by
from mipbake.training.base import Batch, Loss

_WARM = 3  # rounds before a recording, in which libraries make what they keep

_Result = TypeVar("_Result")


def recorded(work: Callable[[], _Result]) -> Callable[[], _Result]:
    """Work that asks a graphics card for kernels, as a graph of them. Each call replays it and returns the result of
    the recording, whose tensors hold new numbers then. The work has run before it was recorded, and not since."""
    torch.cuda.synchronize()
    with torch.cuda.stream(torch.cuda.Stream()):  # type: ignore[no-untyped-call]
        for _ in range(_WARM):
            work()
    torch.cuda.synchronize()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        result = work()

    def replay() -> _Result:
        graph.replay()
        return result

    return replay


def _current(device: torch.device) -> AbstractContextManager[object]:
    """Inside, a graphics card is the one that works where none is named."""
    return torch.cuda.device(device) if device.type == "cuda" else nullcontext()


class RecordedSteps:
    """The loss of batches and its gradients, on a graphics card.

    Args:
        network: on the card. Its parameters and their gradients stay where they lie.
        loss: of its batches.
        zero_grad: clears the gradients, in place.
        record: work as something that is called again and again.
    """

    def __init__(
        self,
        network: Network,
        loss: Loss[Batch],
        zero_grad: Callable[[], None],
        record: Callable[[Callable[[], Tensor]], Callable[[], Tensor]] = recorded,
    ) -> None:
        self._network, self._loss, self._zero_grad, self._record = network, loss, zero_grad, record
        self._steps: dict[str, _Step] = {}

    def __call__(self, batch: Batch) -> Tensor:
        """The loss, a scalar on the card, and the gradients of all parameters where they lie."""
        kind = batch.kind()
        with _current(self._network.device):
            if kind not in self._steps:
                self._steps[kind] = self._recorded(batch)
            return self._steps[kind](batch)

    def _recorded(self, example: Batch) -> _Step:
        batch, directions = example.to(self._network.device), _Directions(self._network.config.decoders)

        def collect() -> Tensor:
            directions.seen.clear()
            try:
                with torch.no_grad(), agreements_by(directions.collect):
                    self._loss.value(self._network, batch)
            except _AllSeenError:
                pass
            return batch.patches

        def whole() -> Tensor:
            self._zero_grad()
            with agreements_by(directions.agreed):
                loss: Tensor = self._loss.value(self._network, batch)
            loss.backward()  # type: ignore[no-untyped-call]
            return loss.detach()

        before = self._record(collect) if directions.directed_models else None
        if before is not None:
            before()
            directions.agree()
        return _Step(batch, before, directions, self._record(whole))


@dataclass(frozen=True)
class _Step:
    """A step of one kind of batch.

    Args:
        batch: whose memory every batch is copied to.
        before: makes the levels that directions are found in; None where no model stores directions.
        directions: what makes them agree.
        whole: clears the gradients, and makes the loss and its gradients.
    """

    batch: Batch
    before: Callable[[], Tensor] | None
    directions: _Directions
    whole: Callable[[], Tensor]

    def __call__(self, batch: Batch) -> Tensor:
        for there, new in zip(self.batch.tensors(), batch.tensors(), strict=True):
            there.copy_(new)
        if self.before is not None:
            self.before()
            self.directions.agree()
        return self.whole().clone()


class _AllSeenError(Exception):
    """All levels are there that directions are found in: what follows is not needed."""


@dataclass
class _Directions:
    """The levels of the models that store directions.

    Args:
        models: that are made.
        seen: by model, levels that are to agree. found: by model, what makes them agree, in memory that stays.
    """

    models: tuple[str, ...]
    seen: dict[str, tuple[list[Tensor], MaterialModel, Wrap]] = field(default_factory=dict)
    found: dict[str, tuple[Tensor, ...]] = field(default_factory=dict)

    @property
    def directed_models(self) -> int:
        """How many of the models store directions."""
        return sum(model_named(model).lines is not None for model in self.models)

    def collect(self, levels: list[Tensor], model: MaterialModel, wrap: Wrap) -> Agreement:
        """Takes the levels of a model, and says that they agree already."""
        self.seen[model.name] = levels, model, wrap
        if len(self.seen) == self.directed_models:
            raise _AllSeenError
        return Agreement([torch.ones_like(level[..., 0]) for level in levels], [None] * len(levels))

    def agree(self) -> None:
        """Finds what makes the levels agree."""
        for name, each in self.seen.items():
            made = agreement(*each)
            shares = (torch.ones_like(s) if h is None else h for s, h in zip(made.signs, made.shares, strict=True))
            new = (*made.signs, *shares)
            for there, value in zip(self.found.setdefault(name, new), new, strict=True):
                there.copy_(value)

    def agreed(self, levels: list[Tensor], model: MaterialModel, wrap: Wrap) -> Agreement:  # noqa: ARG002
        """What was found for a model."""
        found = self.found[model.name]
        return Agreement(found[: len(levels)], found[len(levels) :])
