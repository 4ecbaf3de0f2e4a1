"""A small texture set as files, and the command line run on it: for the tests of the commands."""

import io
import json
from contextlib import redirect_stdout

import numpy as np
import OpenImageIO

from mipbake.cli.main import main


def write_png(path, pixels):
    pixels = np.ascontiguousarray(pixels if pixels.ndim == 3 else pixels[..., None])
    buffer = OpenImageIO.ImageBuf(pixels)
    assert buffer.write(str(path)), buffer.geterror()


def bumps(height=16, width=16):
    """A periodic bumpy metal: 8-bit maps by file stem, normals in the OpenGL convention."""
    v, u = np.meshgrid((np.arange(height) + 0.5) / height, (np.arange(width) + 0.5) / width, indexing="ij")
    dx, dy = 0.5 * np.cos(4 * np.pi * u + 1), 0.4 * np.cos(2 * np.pi * v)
    normal = np.stack([-dx, dy, np.ones_like(u)], -1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    colour = np.stack([0.5 + 0.4 * np.sin(2 * np.pi * u), 0.5 + 0 * u, 0.5 + 0.3 * np.sin(2 * np.pi * v)], -1)
    maps = {"base_color": colour, "normal": (normal + 1) / 2, "roughness": 0.3 + 0.1 * np.sin(2 * np.pi * v)}
    return {name: np.rint(image * 255).astype(np.uint8) for name, image in maps.items()}


def write_set(folder, **changes):
    """A set in a new folder; None leaves a map out."""
    folder.mkdir(parents=True)
    for name, pixels in (bumps() | changes).items():
        if pixels is not None:
            write_png(folder / f"{name}.png", pixels)
    return folder


def tree(path):
    return sorted(str(p.relative_to(path)) for p in path.rglob("*"))


LINEAR = ("--method", "linear")


def run(*arguments):
    """Exit code and what is printed."""
    said = io.StringIO()
    with redirect_stdout(said):
        code = main([str(each) for each in arguments])
    return code, said.getvalue()


def bake(*arguments):
    """Exit code and the JSON of a bake by `linear`."""
    code, said = run("bake", *arguments, *LINEAR, "--json")
    return code, json.loads(said)


def fails(capsys, code, *arguments):
    """Runs, expects the exit code and exactly one sentence on stderr; returns the sentence."""
    assert main([str(a) for a in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("mipbake: ") and err.count("\n") == 1 and err.endswith("\n"), err
    assert "Traceback" not in err
    return err
