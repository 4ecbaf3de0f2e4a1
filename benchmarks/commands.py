"""Every command of `mipbake`, on every texture set of a folder: does it work, how long, how large, what do files cost.

    python benchmarks/commands.py SETS --results build/commands.json

Each command is a process of its own, as a user runs it. What stands in the results file is not run again; the page is
written after every set. Sources other than folders (MaterialX, UDIM tiles) are made of each set's own files.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import os
import platform
import re
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

from timing import cpu_name, table

import mipbake
from mipbake.baking.convert import TARGETS as MODELS
from mipbake.stack.costs import LIMIT
from mipbake.stack.packing import PACKINGS
from mipbake.stack.presets import PRESETS

FORMATS = "exr,tx,ktx2,dds,png,glb"
"""All formats, as one bake writes them."""

MTLX_INPUTS = {"base_color": "color3", "metallic": "float", "roughness": "float"}
"""Inputs of glTF's shader in MaterialX that a set's maps go to, and their types."""

UDIM_TILES = (1001, 1002)


@dataclass(frozen=True)
class Run:
    """One process.

    Args:
        set, command: names.
        code: exit code. message: the last line of what it said of an error.
        seconds: of the wall clock. peak: memory of the largest process, GiB. size: of what was written, MB.
        costs: format to what its files cost near the mirror and over the hemisphere, dB.
        warnings: sentences.
    """

    set: str
    command: str
    code: int
    message: str
    seconds: float
    peak: float
    size: float
    costs: dict[str, dict[str, float]]
    warnings: tuple[str, ...]


Arguments = Callable[[Path, Path], Sequence[str]]


def commands(fast: str) -> dict[str, Arguments]:
    """Name to what makes the arguments from a set and a folder for its results, which later commands find as it is.

    Args:
        fast: the method of bakes whose subject is files.
    """

    def bake(*more: str) -> Arguments:
        return lambda source, out: ["bake", str(source), "-o", str(out), *more, "--json"]

    def made(build: Callable[[Path, Path], Path], *more: str) -> Arguments:
        return lambda source, out: [
            "bake", str(build(source, out.with_name(out.name + " source"))), "-o", str(out), *more, "--json",
        ]  # fmt: skip

    def convert(model: str) -> Arguments:
        return lambda source, out: ["convert", str(source), "--to", model, "-o", str(out), "--json"]

    def info(kind: str) -> Arguments:
        return lambda _, out: ["info", str(_first(out.parent / "bake, all formats", kind)), "--json"]

    few = ("--method", fast, "--format", "dds:bc")
    return {
        "inspect": lambda source, _: ["inspect", str(source), "--json"],
        "bake, all formats": bake("--format", FORMATS),
        **{f"info of a {kind} file": info(kind) for kind in FORMATS.split(",")},
        "info of a stack": info("json"),
        **{f"bake --preset {name}": bake("--method", fast, "--preset", name) for name in PRESETS},
        **{f"bake --packing {name}": bake(*few, "--packing", name) for name in PACKINGS if name != "source"},
        "bake --write-normals directx": bake(*few, "--write-normals", "directx"),
        "bake, adjusted": bake(
            *few, "--keep-level0", "--strength", "0.5", "--min-roughness", "0.1", "--max-level", "6"
        ),
        "bake of MaterialX": made(_mtlx, *few),
        "bake of UDIM tiles": made(_udim, *few),
        **{f"convert --to {model}": convert(model) for model in MODELS},
    }


def _written(folder: Path) -> list[Path]:
    return sorted(path for path in folder.rglob("*") if path.is_file())


def _first(folder: Path, kind: str) -> Path:
    """The first file of a kind."""
    return next(path for path in _written(folder) if path.suffix == f".{kind}")


def _mtlx(source: Path, folder: Path) -> Path:
    """A MaterialX document that points at the files of a set."""
    folder.mkdir()
    texture_set = mipbake.load(source)
    images, inputs = [], []
    for role, kind in {**MTLX_INPUTS, "normal": "vector3"}.items():
        found = texture_set.maps.get(role)
        if found is None or found.source.path is None:
            continue
        space = ' colorspace="srgb_texture"' if role == "base_color" else ""
        images.append(
            f'<image name="{role}" type="{kind}"><input name="file" type="filename" '
            f"value={quoteattr(str(found.source.path))}{space}/></image>"
        )
        node = role
        if role == "normal":
            images.append('<normalmap name="bumps" type="vector3"><input name="in" type="vector3" nodename="normal"/>'
                          "</normalmap>")  # fmt: skip
            node = "bumps"
        inputs.append(f'<input name="{role}" type="{kind}" nodename="{node}"/>')
    document = (
        f'<materialx version="1.38">{"".join(images)}<gltf_pbr name="shader" type="surfaceshader">{"".join(inputs)}'
        '</gltf_pbr><surfacematerial name="material" type="material"><input name="surfaceshader" '
        'type="surfaceshader" nodename="shader"/></surfacematerial></materialx>'
    )
    path = folder / f"{texture_set.name}.mtlx"
    path.write_text(document, encoding="utf-8")
    return path


def _udim(source: Path, folder: Path) -> Path:
    """A folder with the same maps in tiles that touch."""
    folder.mkdir()
    for role, found in mipbake.load(source).maps.items():
        if found.source.path is not None:
            for tile in UDIM_TILES:
                (folder / f"{source.name}_{role}.{tile}{found.source.path.suffix}").symlink_to(found.source.path)
    return folder


def run(name: str, command: str, arguments: Sequence[str], out: Path) -> Run:
    """Runs one `mipbake` process to its end."""
    start = time.perf_counter()
    with tempfile.TemporaryFile() as said, tempfile.TemporaryFile() as wrong:
        code = "from mipbake.cli.main import run; raise SystemExit(run())"
        process = subprocess.Popen([sys.executable, "-c", code, *arguments], stdout=said, stderr=wrong)
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        seconds = time.perf_counter() - start
        said.seek(0)
        wrong.seek(0)
        printed, complained = said.read().decode(), wrong.read().decode().strip().splitlines()
    results = _results(printed)
    size = sum(path.stat().st_size for path in _written(out)) if out.exists() else 0
    return Run(
        set=name,
        command=command,
        code=process.returncode,
        message=complained[-1] if process.returncode and complained else "",
        seconds=seconds,
        peak=usage.ru_maxrss / 2**20,
        size=size / 1e6,
        costs={cost["format"]: cost["loss"] for each in results for cost in each.get("costs", [])},
        warnings=tuple(dict.fromkeys(text for each in results for text in each.get("warnings", []))),
    )


def _results(printed: str) -> list[dict[str, Any]]:
    """The results in the JSON that a command printed; none where it is not about sets."""
    given = json.loads(printed) if printed.strip() else {}
    return given.get("results", []) if isinstance(given, dict) else []


def measured(source: Path, done: set[tuple[str, str]], fast: str) -> Iterator[Run]:
    """Runs what has not been run on a set."""
    todo = {name: make for name, make in commands(fast).items() if (source.name, name) not in done}
    if any(name.startswith("info") for name in todo):  # they need what this one writes
        todo = {"bake, all formats": commands(fast)["bake, all formats"], **todo}
    with tempfile.TemporaryDirectory() as scratch:
        for name, make in todo.items():
            out = Path(scratch) / name
            found = run(source.name, name, make(source, out), out)
            if (source.name, name) not in done:
                yield found


def page_of(data: Mapping[str, Any]) -> str:
    """The Markdown page of what `main` writes."""
    runs, fast = [Run(**each) for each in data["runs"]], data["fast"]
    failed = [f"- {each.set}, {each.command}: exit code {each.code}, {each.message}" for each in runs if each.code]
    return f"""# Every command on every set

`python benchmarks/commands.py` on {data["machine"]}, Python {data["python"]}: {len({r.set for r in runs})} sets,
{len(runs)} processes, {len(failed)} failed. All formats are baked by the default method, the rest by `{fast}`. Times
are of whole processes on a machine that had other work, too; memory is what the largest process took.

{table(("command", "median s", "largest s", "peak GiB", "median MB"), _commands(runs))}

{chr(10).join(failed)}

## What files cost

dB of SNR that the shaded result loses, near the mirror or over the hemisphere, where it loses more; above {LIMIT:g}
mipbake warns. `ktx2` and `dds` choose their own texels here, the others have the first of their kind. Presets are with
`{fast}`.

{table(("files", f"sets above {LIMIT:g} dB", "median dB", "largest dB"), _costs(runs))}
"""


def _commands(runs: Sequence[Run]) -> list[list[str]]:
    rows = []
    for name in dict.fromkeys(map(_kind, commands(""))):
        some = [each for each in runs if _kind(each.command) == name]
        if some:
            seconds = [each.seconds for each in some]
            rows.append(
                [
                    f"`{name}`" if "--" in name else name,
                    f"{statistics.median(seconds):.1f}",
                    f"{max(seconds):.1f}",
                    f"{max(each.peak for each in some):.2f}",
                    f"{statistics.median(each.size for each in some):.1f}",
                ]
            )
    return rows


def _kind(command: str) -> str:
    """What the page calls a command: all of `info`, of a packing and of `convert` are one."""
    return re.sub(r"^(info) of .*|(bake --packing|convert --to) .*", r"\1\2", command)


def _costs(runs: Sequence[Run]) -> list[list[str]]:
    """A row for each container, and for each preset."""
    found: dict[str, list[float]] = {}
    for each in runs:
        preset = each.command.removeprefix("bake --preset ")
        for texels, loss in each.costs.items():
            if preset in PRESETS:
                found.setdefault(f"preset {preset}", []).append(max(max(cost.values()) for cost in each.costs.values()))
                break
            if each.command == "bake, all formats":
                found.setdefault(texels.partition(":")[0], []).append(max(loss.values()))
    return [
        [name, f"{sum(loss > LIMIT for loss in losses)} of {len(losses)}", f"{statistics.median(losses):.2f}",
         f"{max(losses):.2f}"]
        for name, losses in found.items()
    ]  # fmt: skip


def main() -> None:
    """Runs what is missing; docs/remake.py makes the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", type=Path, help="a folder of texture sets")
    parser.add_argument("--results", type=Path, required=True, help="a .json file of what has been run")
    parser.add_argument("--fast", default="linear", help="method of bakes whose subject is files (default linear)")
    options = parser.parse_args()
    done = json.loads(options.results.read_text())["runs"] if options.results.exists() else []
    runs = [Run(**each) for each in done]
    about = {"machine": cpu_name(), "python": platform.python_version(), "fast": options.fast}
    for source in sorted(each for each in options.sets.resolve().iterdir() if each.is_dir()):
        for found in measured(source, {(each.set, each.command) for each in runs}, options.fast):
            runs.append(found)
            options.results.parent.mkdir(parents=True, exist_ok=True)
            written = about | {"runs": [dataclasses.asdict(each) for each in runs]}
            options.results.write_text(json.dumps(written, indent=1))
            print(f"{found.set}, {found.command}: {found.code} {found.message} {found.seconds:.1f} s", flush=True)


if __name__ == "__main__":
    main()
