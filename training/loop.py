"""The training loop."""

from __future__ import annotations

import copy
import csv
import dataclasses
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from mipbake._native import cuda_available
from mipbake.base.checkpoints import Checkpoint, alone_with
from mipbake.base.device import checked_device
from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import one_line
from mipbake.base.progress import ProgressLine
from mipbake.base.publish import replaced_file, writing
from mipbake.models.base import Network
from mipbake.training.base import Batch, mapped
from mipbake.training.batches import batches
from mipbake.training.config import RunConfig, TrainingConfig, config_from, plain
from mipbake.training.data import Materials, draw_crops, load_materials, step_generator
from mipbake.training.optimiser import FlatAdam
from mipbake.training.ranks import Ranks, ranks
from mipbake.training.recorded import RecordedSteps
from mipbake.training.validation import Figures, ValidationEffort, Validator

LAST, BEST = "last.npz", "best.npz"

_FORMAT = 1  # of a checkpoint
_ADVICE = f"train anew, or --start from the {BEST} beside it"
_CPU = torch.device("cpu")
_WHITENING_SAMPLES = 16  # patches; section 3.4 of the paper
_WHITENING_STEP = 2**62  # random numbers of their own, apart from every step's; a seed


def threads_beside_batches() -> int:
    """Torch threads that train fastest: one core is busy drawing batches. OMP_NUM_THREADS, where set, is obeyed."""
    return int(os.environ.get("OMP_NUM_THREADS") or 0) or max(1, (os.cpu_count() or 2) - 1)


def batches_ahead(device: torch.device) -> int:
    """Batches that are drawn at a time, a core each. On the processor one, because training takes the other cores.
    Beside a graphics card as many as there are other cores that this process may use, up to 16: a guess."""
    if device.type == "cpu":
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return max(1, min(16, cores - 1))


@dataclass
class TrainingState:
    """All that a training carries from step to step; randomness needs nothing but the step's index.

    Args:
        network: being optimised. average: moving average of its weights, or the network itself without one.
        step: steps done. figures: of the last validation; none before it. best: highest mean of the network so far.
        recorded: makes losses and gradients on a graphics card; None on other devices.
    """

    config: TrainingConfig
    network: Network
    average: Network
    optimiser: FlatAdam
    step: int = 0
    figures: Figures = field(default_factory=dict)
    best: float = float("-inf")
    commit: str = "unknown"
    recorded: RecordedSteps | None = None

    def advance(self, batch: Batch, among: Ranks = Ranks()) -> Tensor:  # noqa: B008
        """One optimisation step; returns its loss, here alone where several processes train."""
        loss = (self.recorded or self._losses)(batch)
        among.average_(self.optimiser.gradients(batch.source))
        self.optimiser.step(self.step, batch.source)
        self.step += 1
        return loss

    def _losses(self, batch: Batch) -> Tensor:
        """The loss, and the gradients of all parameters where they lie."""
        self.optimiser.zero_grad()
        loss: Tensor = self.config.loss.value(self.network, batch.to(self.network.device))
        loss.backward()  # type: ignore[no-untyped-call]
        return loss.detach()

    def content(self) -> dict[str, Any]:
        """All that it takes to go on: what JSON holds, and `tensors`, name to tensor."""
        parts = {
            "network": self.network.state_dict(),
            "average": self.average.state_dict(),
            "optimiser": self.optimiser.state_dict(),
        }
        tensors = {f"{part} {name}": tensor for part, of in parts.items() for name, tensor in of.items()}
        counts = {"step": self.step, "figures": self.figures, "best": self.best, "commit": self.commit}
        return {"config": plain(self.config), **counts, "tensors": tensors}

    def save(self, path: Path) -> None:
        """Replaces a checkpoint as a whole, so that there is one at any time."""
        content = self.content()
        arrays = {name: tensor.detach().cpu().numpy() for name, tensor in content.pop("tensors").items()}
        checkpoint_at(path).save(content, arrays)


def checkpoint_at(path: Path) -> Checkpoint:
    """A file that a training is kept in."""
    return Checkpoint(path, "training", _FORMAT, _ADVICE)


def device_named(name: str) -> torch.device:
    """The device of a name: `cpu`, `cuda` or `cuda:1`.

    Raises:
        UsageError: there is no such device, or mipbake or torch is built without CUDA.
    """
    device = torch.device(checked_device(name, "train"))
    if device.type == "cuda" and not cuda_available():
        raise UsageError(
            f"the device {name} cannot be used (mipbake, which shades there, was built without CUDA or finds no "
            "graphics card; `mipbake --version` says which): leave the device out to train on the processor"
        )
    return device


def new_state(config: TrainingConfig, device: torch.device = _CPU) -> TrainingState:
    """An untrained network on a device, initialised from the seed: the same on all devices."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(config.run.seed)
        network = config.network.build()
    return _state(config, network, device)


def _state(config: TrainingConfig, network: Network, device: torch.device) -> TrainingState:
    settings = config.optimiser
    network.to(device)
    average = copy.deepcopy(network).requires_grad_(False) if settings.ema_decay else network
    optimiser = FlatAdam(network, average if settings.ema_decay else None, settings)
    recorded = RecordedSteps(network, config.loss, optimiser.zero_grad) if device.type == "cuda" else None
    return TrainingState(config, network, average, optimiser, recorded=recorded)


def load_state(path: Path, device: torch.device = _CPU) -> TrainingState:
    """The state in a checkpoint, on a device; InputError when it cannot be read as one."""
    about, arrays = checkpoint_at(path).load()
    try:
        return state_of({**about, "tensors": {name: torch.from_numpy(each) for name, each in arrays.items()}}, device)
    except Exception as error:
        raise InputError(
            f"{path}: not a checkpoint of this version's training ({one_line(str(error))[:120]}): {_ADVICE}"
        ) from error


def state_of(content: dict[str, Any], device: torch.device = _CPU) -> TrainingState:
    """The state that `TrainingState.content` gave, on a device."""
    config = config_from(content["config"])
    state = _state(config, config.network.build(), device)
    for part, of in (("network", state.network), ("average", state.average), ("optimiser", state.optimiser)):
        tensors = {name.partition(" "): tensor for name, tensor in content["tensors"].items()}
        of.load_state_dict({name: tensor for (own, _, name), tensor in tensors.items() if own == part})
    state.step, state.best, state.commit = content["step"], content["best"], content["commit"]
    state.figures = content["figures"]
    return state


def resumed_state(path: Path, config: TrainingConfig, device: torch.device = _CPU) -> TrainingState:
    """The state in a checkpoint, to be continued under a configuration that may differ in the run's length and logs."""
    state = load_state(path, device)
    for name in ("network", "data", "loss", "optimiser"):
        if getattr(state.config, name) != getattr(config, name):
            raise UsageError(
                f"{path}: made with another [{name}] section; resume with the section that it was started with"
            )
    if state.config.run.seed != config.run.seed:
        raise UsageError(f"{path}: made with seed {state.config.run.seed}, resumed with {config.run.seed}")
    state.config = config
    return state


def start_from(state: TrainingState, path: Path) -> list[str]:
    """Gives a new training the averaged weights of another one's checkpoint, or weights that were released, wherever
    names and shapes are the same.

    Args:
        path: a checkpoint, or a file `<name>.safetensors`.

    Returns:
        Names of the weights that stay as they were.

    Raises:
        InputError: the checkpoint cannot be read. UsageError: nothing in it fits.
    """
    own, other = state.network.state_dict(), _released(path) or load_state(path).average.state_dict()
    if "told" in own and "told" in other and len(other["told"]) < len(own["told"]):
        # More of the sampler is taken than those weights know: the features that they know come first.
        other = {**other, "told": torch.cat([other["told"], own["told"][len(other["told"]) :]])}
    fitting = {name: value for name, value in other.items() if name in own and own[name].shape == value.shape}
    if not fitting:
        raise UsageError(f"{path}: no weights of this architecture; start from a training of the same [network]")
    state.network.load_state_dict({**own, **fitting})
    return [name for name in own if name not in fitting]


def _released(path: Path) -> dict[str, Tensor]:
    """The tensors of released weights; none where the file is another one."""
    if path.suffix != ".safetensors":
        return {}
    from safetensors import SafetensorError
    from safetensors.torch import load_file

    try:
        return load_file(path)
    except (OSError, SafetensorError) as error:
        raise InputError(f"{path}: no weights can be read there ({error})") from error


def fit_whitening(network: Network, materials: Materials, config: TrainingConfig) -> None:
    """Has a network take its whitening, where it has one, from 16 augmented samples (section 3.4)."""
    rng = step_generator(config.run.seed, _WHITENING_STEP)
    here = copy.deepcopy(network).to(_CPU)
    data = dataclasses.replace(config.data, strided=0.0, plain=0.0)
    here.fit(lambda source: draw_crops(materials, _WHITENING_SAMPLES, config.loss.crop_size, source, rng, data))
    network.load_state_dict(here.state_dict())


def train(
    config: TrainingConfig,
    out: Path,
    resume: bool,
    say: Callable[[str], None] = print,
    start: Path | None = None,
    effort: ValidationEffort | None = None,
    device: str = "cpu",
) -> TrainingState:
    """Trains to the configured number of steps; a new training from the weights in the checkpoint `start`, if given.

    Validations take the usual effort, or `effort`. The network lies on a `device` that `device_named` knows; batches
    are drawn on the processor. A training may go on on another device than it began on, and in another number of
    processes (`mipbake.training.ranks`), each of which adds a batch to every step.

    Writes to `out`: last.npz and best.npz (checkpoints), log.csv (losses), validation.csv, validation-<step>.png. Of
    several processes the first one reads and writes there.
    """
    if resume and start is not None:
        raise UsageError("a training is resumed from its own checkpoint: leave out either --resume or --start")
    with ExitStack() as held, ranks(device) as among:
        where = device_named(among.device(device))
        if among.first:
            held.enter_context(alone_with(out / LAST))
            if not resume and (out / LAST).exists():
                raise UsageError(f"{out}: holds a training already; pass --resume to continue it, or another --out")
        train_materials, held_out = load_materials(config)
        if not among.first:
            state = state_of(among.of_first(None), where)
            state.config = config
            for batch in batches(train_materials, config, state.step, among, batches_ahead(where)):
                state.advance(batch, among)
            return state
        state = resumed_state(out / LAST, config, where) if resume else new_state(config, where)
        say(f"materials: {len(train_materials)} to train on, {len(held_out)} held out")
        if not resume:
            state.commit = _commit()
            fit_whitening(state.network, train_materials, config)
            if start is not None:
                new = start_from(state, start)
                say(f"weights of {start}" + (f", except for {', '.join(new)}, which are new" if new else ""))
            state.average.load_state_dict(state.network.state_dict())
        among.of_first(mapped(state.content(), Tensor.cpu))  # other processes have other cards
        coming = batches(train_materials, config, state.step, among, batches_ahead(where))
        _trained(state, out, resume, coming, among, say, held_out, effort)
        return state


def _trained(
    state: TrainingState,
    out: Path,
    resume: bool,
    coming: Iterator[Batch],
    among: Ranks,
    say: Callable[[str], None],
    held_out: Materials,
    effort: ValidationEffort | None,
) -> None:
    """Trains on the batches that come, and writes what becomes of it."""
    config = state.config
    validator = Validator(held_out, config.network, config.loss.pixel_filter, effort)
    logs = _Logs(out, config.run, state.step if resume else None)

    def validate() -> None:
        score = validator.score(state.average)
        logs.write("validation", state.step, score.columns())
        say("            " + "  ".join(f"{name} {value:.2f}" for name, value in score.columns().items()) + " dB")
        validator.picture(state.average, out / f"validation-{state.step:07d}.png")
        state.figures = score.figures()
        if score.total > state.best:
            state.best = score.total
            state.save(out / BEST)

    if not resume:
        validate()  # the untrained network makes averages of parameters, or of moments with its first guess
    run, started, first = config.run, time.perf_counter(), state.step
    recent: list[Tensor] = []
    with ProgressLine(sys.stderr, out.name) as line:
        for batch in coming:
            recent.append(state.advance(batch, among))
            step, done = state.step, state.step == run.steps
            if step % run.log_every == 0 or done:
                loss = float(torch.stack(recent).mean())
                recent.clear()
                pace = (time.perf_counter() - started) / (step - first)
                rate = config.optimiser.rate(step - 1)
                logs.write("log", step, {"loss": loss, "learning rate": rate, "ms": pace * 1e3})
                line.show("training", step / run.steps, (run.steps - step) * pace)
                line.note(f"step {step}, loss {loss:.4f}")
            if step % run.validate_every == 0 or done:
                with line.aside():
                    validate()
            if step % run.checkpoint_every == 0 or done:
                state.save(out / LAST)
    logs.close()


class _Logs:
    """CSV files, one a table, and TensorBoard where configured.

    Args:
        step: that a run is resumed from, which drops the rows that it will write again; None for a new run.
    """

    def __init__(self, out: Path, run: RunConfig, step: int | None) -> None:
        self._out = out
        self._board = _tensorboard(out) if run.tensorboard else None
        for path in (out / f"{table}.csv" for table in ("log", "validation")):
            if step is None:
                path.unlink(missing_ok=True)
            elif path.exists():
                head, *rows = path.read_text(encoding="utf-8").splitlines(keepends=True) or [""]
                steps = [row.split(",")[0] if row.endswith("\n") else "" for row in rows]  # a crash cuts the last one
                kept = [row for row, at in zip(rows, steps, strict=True) if at.isdecimal() and int(at) <= step]
                replaced_file(path, "".join([head, *kept]).encode())

    def write(self, table: str, step: int, values: dict[str, float]) -> None:
        path = self._out / f"{table}.csv"
        new = not path.exists() or not path.stat().st_size
        with writing(f"cannot write {path}"), path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            if new:
                writer.writerow(["step", *values])
            writer.writerow([step, *(f"{v:.6g}" for v in values.values())])
        if self._board is not None:
            for name, value in values.items():
                self._board.add_scalar(f"{table}/{name}", value, step)

    def close(self) -> None:
        if self._board is not None:
            self._board.close()


def _tensorboard(out: Path) -> Any:
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise UsageError(
            "run.tensorboard is true but TensorBoard is not installed: install mipbake[train], or set it to false"
        ) from error
    return SummaryWriter(str(out))


def _commit() -> str:
    """Revision of the checkout that this file lies in, with + when it was changed since; "unknown" outside one."""
    folder = Path(__file__).resolve().parent
    try:
        run = [
            subprocess.run(["git", "-C", str(folder), *args], capture_output=True, text=True, check=True).stdout.strip()
            for args in (["rev-parse", "HEAD"], ["status", "--porcelain", "--untracked-files=no"])
        ]
    except (OSError, subprocess.CalledProcessError):
        return "unknown"
    return run[0] + ("+" if run[1] else "")
