"""What code and weights a record depends on, as short hashes, a file each, that comments and docstrings do not change.

Python: the syntax tree of an entry point and of every module of this project that it imports, directly or not, inside
functions as well. What `import mipbake` itself runs is not followed, because it imports everything: `mipbake.NAME` and
`from mipbake import NAME` lead to the module that defines the name. C++: where a door of the native core is among
the modules, its sources and what they include, without comments and white space. Not seen: CUDA, the build's
options, the versions of libraries, and data files other than the weights.
"""

from __future__ import annotations

import ast
import hashlib
import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from rooms.folders import ROOT, folders

Hashes = dict[str, str]
"""File, relative to the root, or `weights NAME`, to a short hash of what counts in it."""

LENGTH = 12
"""Hexadecimal digits of a hash."""

BEYOND = (
    "mipbake.stack", "mipbake.manifest", "mipbake.output", "mipbake.packing", "mipbake.opacity", "mipbake.glb",
    "mipbake.content", "mipbake._version", "mipbake._extras",
    "mipbake.io.gltf", "mipbake.io.mtlx", "mipbake.io.publish", "mipbake.io.mip_exr", "mipbake.io.mip_tx",
    "mipbake.io.mip_png", "mipbake.io.oiio_levels", "mipbake.io.ktx2", "mipbake.io.dds", "mipbake.io.gpu_files",
    "mipbake.io.gpu_format", "mipbake.io.blocks", "mipbake.io.bc7", "mipbake.io.uastc", "mipbake.io.decode",
    "mipbake.io.containers", "mipbake.io.map_files", "mipbake.io.layout", "mipbake.io.quantise",
    "mipbake.io.messages", "mipbake.prefilter.search.time_budget", "mipbake.render.cache",
    "mipbake.prefilter.search.checkpoint", "mipbake.prefilter.search.kept_arrays",
    "mipbake.prefilter.search.kept_search", "mipbake.prefilter.search.sitting",
)  # fmt: skip
"""Modules that records of quality import and that cannot change a figure: they write stacks, read documents that no
measured set has, keep searches that are interrupted, or say which package is missing. Levels are measured as they are
in memory."""

_FOLDERS = {name: folder for name, folder in folders().items() if name.startswith("mipbake.")}
"""Rooms that the build maps into the package."""

_SCRIPTS = ("benchmarks", "docs", "examples/fitting")
"""Folders whose scripts import each other by bare names."""

_NATIVE = {
    "shading": ("bind/shading.cpp", "cpu/shading*.cpp"),
    "sampling": ("bind/texture.cpp", "cpu/texture*.cpp", "cpu/mip*.cpp"),
    "stochastic": ("bind/stochastic.cpp", "cpu/stochastic*.cpp"),
    "raster": (
        "bind/raster.cpp", "bind/interpolate.cpp", "bind/antialias.cpp",
        "cpu/raster*.cpp", "cpu/interpolate*.cpp", "cpu/antialias*.cpp", "cpu/triangle*.cpp",
    ),
}  # fmt: skip
"""Door of the native core to its sources, below csrc."""

_CPP_NOISE = re.compile(r'("(?:\\.|[^"\\])*")|//[^\n]*|/\*.*?\*/', re.DOTALL)
_INCLUDE = re.compile(r'^\s*#\s*include\s+"([^"]+)"', re.MULTILINE)


@dataclass(frozen=True)
class Entry:
    """Where the code of a measurement begins.

    Args:
        modules: dotted names of modules of the package, or paths of scripts, relative to the root.
        weights: names of released weights; "*" for all.
        files: patterns of other files, relative to the root, that count as they are.
    """

    modules: Sequence[str]
    weights: Sequence[str] = ()
    files: Sequence[str] = ()


def hashes(entry: Entry, root: Path = ROOT) -> Hashes:
    """The hashes of all files that the entry reaches, in the order of their names."""
    found = {str(path.relative_to(root)): _python(path) for path in modules(entry, root)}
    doors = {match[1] for name in found if (match := re.match(r"mipbake/(shading|sampling|raster|stochastic)/", name))}
    found |= {str(path.relative_to(root)): _cpp(path) for path in sources(doors, root)}
    found |= {str(p.relative_to(root)): _short(p.read_bytes()) for each in entry.files for p in root.glob(each)}
    found |= {f"weights {name}": digest for name, digest in _weights(entry.weights, root).items()}
    return dict(sorted(found.items()))


def changes(old: Mapping[str, str], new: Mapping[str, str]) -> list[str]:
    """Names whose hashes differ, or that are on one side alone. What has come to be BEYOND since is no change."""
    beyond = {name for name in old if _within(name.removesuffix(".py").replace("/", "."), BEYOND)}
    return sorted(name for name in {*old, *new} - beyond if old.get(name) != new.get(name))


def forget() -> None:
    """Files are read anew from now on."""
    for cached in (imported, _python, _cpp, _exported):
        cached.cache_clear()


def together(found: Mapping[str, str]) -> str:
    """One hash of many."""
    return _short(json.dumps(found, sort_keys=True).encode())


def modules(entry: Entry, root: Path = ROOT) -> list[Path]:
    """Python files that the entry reaches."""

    def imports(path: Path) -> Iterator[Path]:
        for name in imported(path, root):
            if not _within(name, BEYOND):
                yield from _files(name, path, root)

    return sorted(_reached((path for name in entry.modules for path in _entry_paths(name, root)), imports))


@cache
def imported(path: Path, root: Path = ROOT) -> frozenset[str]:
    """Dotted names that a file imports; names from `mipbake` itself as the names of the modules that define them."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    names: set[str] = set()
    plain = False
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
            plain |= any(alias.name == "mipbake" for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    for node in ast.walk(tree) if plain else ():
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "mipbake":
            names.add(f"mipbake.{node.attr}")
    exported = _exported(root)
    return frozenset(exported.get(name, name) for name in names) - {"mipbake"}


@cache
def _exported(root: Path) -> Mapping[str, str]:
    """`mipbake.NAME` to the module that defines it, as mipbake/__init__.py says."""
    tree = ast.parse((root / "mipbake" / "__init__.py").read_text(encoding="utf-8"))
    return {
        f"mipbake.{alias.name}": node.module
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith("mipbake")
        for alias in node.names
    }


def sources(doors: Iterable[str], root: Path = ROOT) -> list[Path]:
    """C++ files of doors of the native core, with what they include."""
    csrc = root / "csrc"

    def includes(path: Path) -> Iterator[Path]:
        for name in _INCLUDE.findall(path.read_text(encoding="utf-8")):
            yield from [found for found in (path.parent / name, csrc / name) if found.is_file()][:1]

    beginnings = (path for door in doors for pattern in _NATIVE[door] for path in csrc.glob(pattern))
    return sorted(path.resolve() for path in _reached(beginnings, includes))


def _reached(beginnings: Iterable[Path], leads_to: Callable[[Path], Iterable[Path]]) -> set[Path]:
    """Files, and all that they lead to, directly or not."""
    todo, seen = list(beginnings), set[Path]()
    while todo:
        path = todo.pop()
        if path not in seen:
            seen.add(path)
            todo += leads_to(path)
    return seen


def _entry_paths(name: str, root: Path) -> Iterator[Path]:
    path = root / name
    if name.endswith(".py"):
        if not path.is_file():
            raise FileNotFoundError(f"{name} is named as an entry point and is not there")
        yield path
        return
    found = _files(name, root / "mipbake" / "x.py", root)
    if not found:
        raise ModuleNotFoundError(f"{name} is named as an entry point and is not there")
    yield from found


def _files(name: str, importer: Path, root: Path) -> list[Path]:
    """The file of a module of this project, and of the packages that it lies in; none for other modules."""
    if name.split(".", maxsplit=1)[0] != "mipbake":
        parts = name.split(".")
        tops = [importer.parent, *(root / folder for folder in _SCRIPTS if importer.is_relative_to(root / folder))]
        outside = (top for top in tops if not top.is_relative_to(root / "mipbake"))
        return next((found for top in outside if (found := _below(top, parts))), [])
    room = next((room for room in _FOLDERS if name == room or name.startswith(room + ".")), "mipbake")
    parts = name.removeprefix(room).strip(".").split(".") if name != room else []
    return _below(root / _FOLDERS.get(room, room), parts, room != "mipbake")


def _below(top: Path, parts: Sequence[str], own: bool = False) -> list[Path]:
    """Files that importing `parts` below a folder runs; a last part that is not a module is a name inside one."""
    found = [top / "__init__.py"] if own and (top / "__init__.py").is_file() else []
    at = top
    for part in parts:
        if (at / f"{part}.py").is_file():
            return [*found, at / f"{part}.py"]
        at = at / part
        if not (at / "__init__.py").is_file():
            break
        found.append(at / "__init__.py")
    return found


def _within(name: str, prefixes: Sequence[str]) -> bool:
    return any(name == prefix or name.startswith(prefix + ".") for prefix in prefixes)


@cache
def _python(path: Path) -> str:
    return _short(python_content(path.read_text(encoding="utf-8")).encode())


def python_content(text: str) -> str:
    """The syntax tree without docstrings, in a form that is the same in every version of Python."""
    tree = ast.parse(text)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list):
            node.body = [each for each in body if not _is_words(each)]  # type: ignore[attr-defined]
    return _dumped(tree)


def _is_words(node: ast.AST) -> bool:
    """Docstrings, and the strings that describe constants."""
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)


def _dumped(node: object) -> str:
    """Fields that are empty are left out: versions of Python differ in which there are."""
    if isinstance(node, ast.AST):
        fields = ((name, value) for name, value in ast.iter_fields(node) if value is not None and value != [])
        inside = ",".join(f"{name}={_dumped(value)}" for name, value in fields if name not in ("ctx", "kind"))
        return f"{type(node).__name__}({inside})"
    if isinstance(node, list):
        return f"[{','.join(map(_dumped, node))}]"
    return repr(node)


@cache
def _cpp(path: Path) -> str:
    return _short(cpp_content(path.read_text(encoding="utf-8")).encode())


def cpp_content(text: str) -> str:
    """C++ without comments, and with single spaces."""
    return " ".join(_CPP_NOISE.sub(lambda found: found[1] or " ", text).split())


def _weights(names: Sequence[str], root: Path) -> Hashes:
    """Released weights: their tensors, and the architecture and defaults that go with them."""
    found = {}
    for path in sorted((root / "models" / "weights").glob("*.safetensors")):
        if path.stem in names or "*" in names:
            about = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
            kept = json.dumps({key: about[key] for key in ("network", "pixel_filters", "default")}, sort_keys=True)
            found[path.stem] = _short(path.read_bytes() + kept.encode())
    missing = {*names} - {*found, "*"}
    if missing:
        raise FileNotFoundError(f"weights {', '.join(sorted(missing))} are named by a record and are not there")
    return found


def _short(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()[:LENGTH]
