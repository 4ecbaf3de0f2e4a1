"""Damaged files, one after the other, through every reader: in a process of its own, because libraries crash.

Input number i of a seed is always the same, so whatever breaks can be made again.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from .damage import damaged

CORPUS = Path(__file__).parent / "corpus"
PATIENCE = 30.0
"""Seconds of a processor after which a reader hangs."""
_SILENCE = 300.0
"""Seconds without an answer after which a reader waits for something: a machine may have other work."""
_ADDRESS_SPACE = 8 << 30
_TURNS = {"images": 12, "environment": 2, "gltf": 2, "mesh": 2, "mtlx": 2, "stack-exr": 2}
"""How often a reader's turn comes in a round; others once."""


@dataclass(frozen=True)
class Case:
    """A damaged file: which reader is to read it, its path in that reader's folder, and its bytes."""

    reader: str
    file: Path
    data: bytes


@dataclass(frozen=True)
class Defect:
    """What broke: the input's number, its case, and how it broke, the place in our code included."""

    number: int
    case: Case
    what: str


@dataclass
class Result:
    """The result of a campaign: how many inputs each reader got, how many were refused or read, and what broke."""

    inputs: Counter[str] = field(default_factory=Counter)
    answers: Counter[str] = field(default_factory=Counter)
    defects: list[Defect] = field(default_factory=list)


def case_of(number: int, seed: int, readers: Sequence[str]) -> Case:
    """Input `number` of a seed. The files of the corpus as they are come first, one after the other."""
    turns = [reader for reader in readers for _ in range(_TURNS.get(reader, 1))]
    at = number % len(turns)
    reader = turns[at]
    folder = CORPUS / reader
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    turn = number // len(turns) * turns.count(reader) + at - turns.index(reader)
    if turn < len(files):
        return Case(reader, files[turn].relative_to(folder), files[turn].read_bytes())
    random = Random(f"{seed}/{number}")
    file = random.choice(files)
    others = [path.read_bytes() for path in files if path.suffix == file.suffix and path != file]
    return Case(reader, file.relative_to(folder), damaged(file.read_bytes(), file.name, others, random))


def run(seed: int, readers: Sequence[str], inputs: int | None, seconds: float | None) -> Result:
    """Runs until so many inputs were read or so many seconds are over, the time for starting processes included."""
    result, number, end = Result(), 0, time.monotonic() + (seconds or float("inf"))
    while (inputs is None or number < inputs) and time.monotonic() < end:
        for at, answer in _answers(seed, readers, number, inputs, end):
            number = at + 1
            case = case_of(at, seed, readers)
            result.inputs[case.reader] += 1
            result.answers[answer.split(":")[0] if answer.startswith("defect") else answer] += 1
            if answer.startswith("defect"):
                result.defects.append(Defect(at, case, answer.partition(":")[2].strip()))
    return result


def _answers(
    seed: int, readers: Sequence[str], first: int, inputs: int | None, end: float
) -> Iterator[tuple[int, str]]:
    """Number and answer of inputs from `first` on, from one worker; its death or its silence is the last answer."""
    command = [sys.executable, "-m", "tests.fuzz", "--worker", str(first), "--seed", str(seed)]
    command += [f"--reader={reader}" for reader in readers]
    root = Path(__file__).resolve().parents[2]
    with TemporaryDirectory() as scratch:
        said = Path(scratch) / "stderr"
        with said.open("wb") as errors:
            worker = subprocess.Popen(
                command, cwd=root, env={**os.environ, "TMPDIR": scratch}, stdout=subprocess.PIPE, stderr=errors
            )
        assert worker.stdout is not None
        number, silent_since, pending = first, time.monotonic(), b""
        try:
            while True:
                ready, _, _ = select.select([worker.stdout], [], [], 1.0)
                chunk = os.read(worker.stdout.fileno(), 1 << 16) if ready else b""
                *lines, pending = (pending + chunk).split(b"\n")
                for line in lines:
                    silent_since = time.monotonic()
                    if line.startswith(b"{"):
                        answer = json.loads(line)
                        yield answer["number"], answer["answer"]
                        number = answer["number"] + 1
                        if inputs is not None and number >= inputs:
                            return
                if ready and not chunk:
                    code = worker.wait()
                    if code == -signal.SIGPROF:
                        yield number, f"defect: takes more than {PATIENCE:g} s of a processor"
                        return
                    name = signal.Signals(-code).name if code < 0 else f"exit {code}"
                    last = said.read_text(errors="replace").strip().splitlines()[-1:]
                    yield number, f"defect: {name} {' '.join(last)}"
                    return
                if time.monotonic() - silent_since > _SILENCE:
                    yield number, f"defect: gives no answer for {_SILENCE:g} s"
                    return
                if time.monotonic() > end:
                    return
        finally:
            worker.kill()
            worker.wait()


def work(seed: int, readers: Sequence[str], first: int) -> None:
    """The worker: reads inputs from `first` on for ever, and writes a line of JSON for each to stdout."""
    import resource

    from mipbake.base.errors import MipbakeError

    from .readers import READERS

    resource.setrlimit(resource.RLIMIT_AS, (_ADDRESS_SPACE, _ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with TemporaryDirectory() as scratch:
        places = {reader: Path(scratch) / reader for reader in readers}
        for reader, place in places.items():
            shutil.copytree(CORPUS / reader, place)
        number = first
        while True:
            case = case_of(number, seed, readers)
            path = places[case.reader] / case.file
            whole = path.read_bytes()
            path.write_bytes(case.data)
            signal.setitimer(signal.ITIMER_PROF, PATIENCE)  # nothing handles it: it ends the process
            try:
                READERS[case.reader](places[case.reader], path)
                answer = "read"
            except MipbakeError:
                answer = "refused"
            except MemoryError:
                answer = "too little memory"
            except Exception as error:
                answer = f"defect: {_told(error)}"
            path.write_bytes(whole)
            sys.stdout.write(json.dumps({"number": number, "answer": answer}) + "\n")
            sys.stdout.flush()
            number += 1


def _told(error: Exception) -> str:
    """The error, and the last place in our own code that it came through."""
    place, trace = "", error.__traceback__
    while trace is not None:
        file = Path(trace.tb_frame.f_code.co_filename)
        if "tests" not in file.parts:
            place = f"{file.name}:{trace.tb_lineno}"
        if "site-packages" in file.parts:
            break
        trace = trace.tb_next
    return f"{type(error).__name__} at {place}: {' '.join(str(error).split())[:200]}"
