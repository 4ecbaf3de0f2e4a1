"""Runs mipbake on the images of a material, in a process of its own."""

import importlib.util
import os
import shutil
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .nodes import BakeError, Plan, Use, files_of

_ENDINGS = {"JPEG": "jpg", "OPEN_EXR": "exr", "TARGA": "tga", "TIFF": "tif"}
_SPACES = {"sRGB": "sRGB", "Linear Rec.709": "linear sRGB", "Non-Color": "linear sRGB"}


@dataclass
class Job:
    """A bake that runs.

    Args:
        out: folder of the baked images, whose names begin with its own.
        staged: a temporary folder with the images that are baked, and what mipbake prints.
    """

    process: subprocess.Popen[bytes]
    out: Path
    staged: Path
    began: float

    @property
    def runs(self) -> bool:
        return self.process.poll() is None

    def status(self) -> str:
        """One line for the status bar."""
        seconds = time.monotonic() - self.began
        return "   ".join([f"mipbake: {self.out.name}, {seconds:.0f} s, Esc cancels", *self._printed("stderr")[-1:]])

    def lines(self) -> list[str]:
        """Waits, and returns what mipbake says of the result. BakeError where there is none."""
        code = self.process.wait()
        said, errors = self._printed("stdout"), self._printed("stderr")
        self.clear()
        if code:
            found = [line.removeprefix("mipbake: ") for line in errors if line.startswith("mipbake: ")]
            sentence = (found or errors or [f"mipbake ended with exit code {code}"])[-1]
            raise BakeError(sentence.replace(f"{self.staged / self.out.name}{os.sep}", ""))
        return [line for line in said if not line.startswith("in Blender")]

    def stop(self) -> None:
        """Ends the bake; results of earlier ones stay as they were."""
        self.process.terminate()
        self.process.wait()
        self.clear()

    def clear(self) -> None:
        shutil.rmtree(self.staged, ignore_errors=True)

    def _printed(self, stream: str) -> list[str]:
        return (self.staged / stream).read_text(encoding="utf-8", errors="replace").splitlines()


def start(plan: Plan, name: str, folder: Path, command: str) -> Job:
    """Begins to bake into a folder below `folder`. BakeError where mipbake is not found, or an image cannot be read."""
    program, environment = program_of(command)
    staged = Path(tempfile.mkdtemp(prefix="mipbake-"))
    try:
        (staged / name).mkdir()
        options = [word for pair in maps(plan, staged / name) for word in ("--map", pair)] + choices(plan)
        formats = ("--preset", "blender", "--format", "exr,png")
        words = [*program, "bake", str(staged / name), "--out", str(folder), *formats, *options]
        with (staged / "stdout").open("wb") as out, (staged / "stderr").open("wb") as err:
            flags = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # on Windows, no black window
            process = subprocess.Popen(
                words, env=environment, stdin=subprocess.DEVNULL, stdout=out, stderr=err, creationflags=flags
            )
    except (OSError, RuntimeError) as error:  # what Blender raises for images that it cannot write
        shutil.rmtree(staged, ignore_errors=True)
        raise BakeError(f"the bake cannot begin: {' '.join(str(error).split())}") from error
    return Job(process, folder / name, staged, time.monotonic())


def program_of(command: str) -> tuple[list[str], dict[str, str]]:
    """How mipbake is called, and the environment: as a library of Blender's Python, else by its command."""
    environment = {**os.environ, "PYTHONUTF8": "1"}
    found = importlib.util.find_spec("mipbake")
    if found is not None and found.origin and "python" in Path(sys.executable).name.lower():
        environment["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))  # the wheels of extensions
        return [sys.executable, "-m", "mipbake"], environment
    path = shutil.which(bpy.path.abspath(command))
    if path is None:
        raise BakeError(
            f"the program '{command}' is not there: install mipbake, and set the path of its command in Preferences > "
            "Add-ons > mipbake"
        )
    return [path], environment


def maps(plan: Plan, folder: Path) -> list[str]:
    """Puts the images of a plan into a folder; returns what each is, as `mipbake bake --map` takes it."""
    said = [f"{role}={value:g}" for role, value in plan.constants.items()]
    staged: dict[str, str] = {}
    for use in plan.uses:
        if use.as_it_is and use.image.name in staged:
            file = staged[use.image.name]
        else:
            file = _copied(use, folder) if use.as_it_is else _computed(use, folder)
            if use.as_it_is:
                staged[use.image.name] = file
        channel = "R" if not use.as_it_is and use.role != "normal" else use.channel
        said.append(f"{use.role}={file}" + (f":{channel}" if channel else ""))
    missing = {"normal", "opacity"} - {use.role for use in plan.uses}
    return said + [f"{role}=none" for role in sorted(missing)]


def choices(plan: Plan) -> list[str]:
    """Options that say how the images are read."""
    said: list[str] = []
    for use in plan.uses:
        if use.role == "normal":
            said += ["--normal-convention", "directx" if use.directx else "opengl"]
        if use.role == "base_color":
            said += ["--colour-space", _SPACES[use.image.colorspace_settings.name]]
    if plan.uses[0].node.extension != "REPEAT":
        said += ["--wrap-u", "clamp", "--wrap-v", "clamp"]
    return said


def _copied(use: Use, folder: Path) -> str:
    """Copies the files of an image, and returns the name of one of them."""
    image = use.image
    if image.packed_file:
        ending = Path(image.filepath).suffix or f".{_ENDINGS.get(image.file_format, image.file_format.lower())}"
        (folder / f"{use.role}{ending}").write_bytes(image.packed_file.data)
        return f"{use.role}{ending}"
    name = ""
    for tile, path in files_of(image).items():
        name = f"{use.role}.{tile}{path.suffix}" if tile else f"{use.role}{path.suffix}"
        shutil.copyfile(path, folder / name)
    return name


def _computed(use: Use, folder: Path) -> str:
    """Writes what the nodes behind an image make of it, and returns the name of the file."""
    width, height = use.image.size
    pixels = np.empty(width * height * 4, np.float32)
    use.image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(-1, 4)
    if use.role == "normal":  # as Cycles does it
        pixels[:, :2] = (pixels[:, :2] - 0.5) * use.strength + 0.5
        pixels[:, 2] = 1 + (pixels[:, 2] - 1) * min(use.strength, 1)
    else:
        value = pixels[:, "RGBA".index(use.channel or "R")] * use.slope + use.offset
        pixels[:, :3] = np.clip(value, 0, 1)[:, None]
    pixels[:, 3] = 1
    made = bpy.data.images.new("mipbake", width, height, float_buffer=True, is_data=True)
    try:
        made.pixels.foreach_set(pixels.ravel())
        made.file_format, made.filepath_raw = "OPEN_EXR", str(folder / f"{use.role}.exr")
        made.save()
    finally:
        bpy.data.images.remove(made)
    return f"{use.role}.exr"
