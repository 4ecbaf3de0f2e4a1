"""Networks in the core as WebAssembly. A bake has a machine of its own, which holds all its images."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from mipbake._wasm.machine import Machine, Out, run

_KINDS = ["moments", "latents"]


def network_counts(kind: str, read: int, made: int) -> tuple[int, int, int, int, int, int, int]:
    _require(kind in _KINDS)
    counts = np.zeros(7, np.int64)
    run("network_counts", _KINDS.index(kind), read, made, Out(counts))
    return tuple(counts.tolist())


class Network:
    """Weights of a network, which each bake packs."""

    def __init__(
        self,
        kind: str,
        read: int,
        made: int,
        limits: Sequence[float],
        whiten: tuple[Any, Any] | None,
        encoder: Sequence[tuple[Any, Any]],
        project: tuple[Any, Any],
        decoder: Sequence[tuple[Any, Any]],
    ) -> None:
        _require(0 <= read < 4 and 0 <= made < 4 and len(limits) == 6 and len(decoder) > 0)
        _require((whiten is not None) == (kind == "latents"))
        self.counts = network_counts(kind, read, made)
        self.words = [_KINDS.index(kind), read, made, [float(each) for each in limits], _layer(whiten)]
        self.words += [len(encoder), *map(_layer, encoder), _layer(project), len(decoder), *map(_layer, decoder)]
        run("network_check", self.words)


class NetworkBake:
    """A bake of every level, some rows of level 0 at a time."""

    def __init__(
        self,
        network: Network,
        stored: NDArray[np.float32],
        wrap_rows: bool,
        wrap_columns: bool,
        sharp: NDArray[np.float32],
        plain: NDArray[np.float32],
        bias: NDArray[np.float32],
        top: NDArray[np.float32],
        sinks: Sequence[Any],
    ) -> None:
        height, width, channels = stored.shape
        read, made, *_ = network.counts
        _require(channels == read and top.shape == (height, width, made) and len(sharp) % 2 == 1)
        _require(len(plain) == max(len(sharp) - 2, 0))
        sizes, words = [(height, width)], list[Any]()
        for source, rows, columns, out, own in sinks:
            _require(-1 <= source < len(sizes) - 1 and (out is None) == (own is None))
            finer, size = sizes[source + 1], (len(rows[0]), len(columns[0]))
            _require(out is None or out.shape == (*size, made))
            sizes.append(size)
            words += [source, _axis(rows, finer[0]), _axis(columns, finer[1]), out if out is None else Out(out), own]
        images = [stored, height, width, wrap_rows, wrap_columns, sharp, plain, len(sharp) // 2, bias, Out(top)]
        self._height: int = height
        self._machine: Machine | None = Machine()
        self._bake = self._machine.call("bake_begin", self._machine.placed(network.words, images, len(sinks), words))

    def advance(self) -> int:
        """Bakes the next rows; gives the number of rows of level 0 that are done. Images are filled after the last."""
        if self._machine is None:
            return self._height
        done: int = self._machine.call("bake_advance", self._bake)
        if done >= self._height:
            self._machine.collect()
            self._machine = None
        return done

    def run_on_card(self, device: int) -> NoReturn:
        raise ValueError(f"no CUDA kernels in this build, so none for card {device}")


def _layer(given: tuple[Any, Any] | None) -> list[Any]:
    """Words of NetworkLayer. Weights are (outputs, inputs), or (outputs, inputs, 3, 3)."""
    if given is None:
        return [0, 0, 0, 0, 0]
    weight, bias = given
    _require(weight.shape[2:] in ((), (3, 3)) and bias.shape == weight.shape[:1])
    return [weight, bias, *weight.shape[:2], 9 if weight.ndim == 4 else 1]


def _axis(given: tuple[Any, Any, Any], finer: int) -> list[Any]:
    index, sharp, plain = given
    _require(index.dtype == np.int32 and index.ndim == 2 and sharp.shape == plain.shape == index.shape)
    _require(not index.size or 0 <= index.min() <= index.max() < finer)
    return [index, sharp, plain, *index.shape]


def _require(good: bool) -> None:
    if not good:
        raise ValueError("unexpected shape of an array of a network")
