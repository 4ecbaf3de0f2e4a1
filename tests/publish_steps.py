"""A program for tests: publishes over an earlier result once for every step of doing so, and is stopped at that step.

A step is a call of the system or a return from one, or a call or return in the modules under test: Python handles
signals there, and what is done to the file system is done in between. Each time a child process is stopped, then the
parent looks at what is left, and puts it in order.
It prints how often the child was stopped, and what was wrong.

    python publish_steps.py FOLDER exchange|renames KILL|INT|TERM folder|file
"""

import contextlib
import ctypes
import inspect
import os
import signal
import sys
from pathlib import Path

from mipbake.base import leftovers, publish, signals

OURS = {contextlib.__file__, publish.__file__, leftovers.__file__, signals.__file__}


def without_exchange(_name):
    raise OSError("no C library")


class Terminated(BaseException):
    pass


def terminate(_number, _frame):
    raise Terminated


def is_ours(folder):
    return {path.name for path in folder.iterdir()} <= {"first", "second"}


def write_folder(place, text):
    with publish.published(place, is_ours) as folder:
        (folder / "first").write_text(text)
        (folder / "second").write_text(text)


def write_file(place, text):
    publish.replaced_file(place, text.encode())


def read(path):
    """What a result says, where it is whole."""
    try:
        if path.is_file():
            return path.read_text()
        texts = [(path / name).read_text() for name in ("first", "second")]
        return texts[0] if texts[0] == texts[1] and is_ours(path) else "broken"
    except OSError:
        return "none"


def stopped_at(step, number, write, place):
    """Publishes in a child that gets a signal at a step. How it ended: "done", "stopped", "killed", "left <names>"."""
    child = os.fork()
    if child:
        _, status = os.waitpid(child, 0)
        if os.WIFSIGNALED(status):
            return "killed"
        return {0: "done", 1: "stopped", 2: "left"}.get(os.WEXITSTATUS(status), "failed")
    steps = 0

    def count(frame, event, argument):
        nonlocal steps
        if event == "return" and frame.f_code.co_flags & inspect.CO_GENERATOR:  # no place where Python handles signals
            return
        if frame.f_code.co_filename not in OURS and getattr(argument, "__module__", "") not in ("posix", "fcntl"):
            return
        steps += 1
        if steps == step:
            os.kill(os.getpid(), number)

    code = 0
    try:
        sys.setprofile(count)
        write(place, "new")
        sys.setprofile(None)
    except (KeyboardInterrupt, Terminated):
        code = 1
    except BaseException:
        code = 3
    sys.setprofile(None)
    os._exit(2 if leftovers.unfinished() else 0 if not code and steps < step else max(code, 1))


def main(place, how, name, what):
    if how == "renames":
        ctypes.CDLL = without_exchange
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGTERM, terminate)
    write = write_folder if what == "folder" else write_file
    folder, number = Path(place), signal.Signals[f"SIG{name}"]
    place = folder / "set"
    allowed = {"old", "new"}
    step, wrong, seen = 0, [], {}
    while True:
        step += 1
        if read(place) != "old":
            write(place, "old")
        ended = stopped_at(step, number, write, place)
        if ended == "done":
            break
        found, beside = read(place), sorted(path.name for path in folder.iterdir() if path != place)
        seen[found] = seen.get(found, 0) + 1
        if ended != ("killed" if name == "KILL" else "stopped"):
            wrong.append(f"step {step}: {ended}")
        aside = [read(folder / each) for each in beside if each.endswith(".old")]
        lost = found not in allowed and not (
            name == "KILL" and how == "renames" and found == "none" and aside == ["old"]
        )
        if lost or (name != "KILL" and beside):
            wrong.append(f"step {step}: {found}, beside it {beside}")
        leftovers.tidy(place)  # with which the next bake begins
        leftovers.tidy(place.with_name(publish.TRIAL))
        after, beside = read(place), [path.name for path in folder.iterdir() if path != place]
        if after != (found if found in allowed else "old") or beside:
            wrong.append(f"step {step}, afterwards: {after}, beside it {beside}")
    print(f"{step - 1} steps, {seen}")
    print("\n".join(wrong))


if __name__ == "__main__":
    os.fsync = lambda _handle: None  # which is slow, and no step of its own
    main(*sys.argv[1:])
