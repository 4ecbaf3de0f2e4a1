"""Wheels for other systems, out of the wheel that this system has.

    python .ci/cross.py WHEEL [FOLDER] [TARGET...]

WHEEL serves Python 3.12 and later on this system. For each of the targets, all where none is named, the module in it
is compiled anew for that system and put in its place; everything else is the same everywhere. The wheels go to FOLDER,
dist where none is named.

It runs on Python 3.12 or later, whose headers it uses, and needs abi3audit, cmake, nanobind, ninja, wheel and ziglang,
all of them on PyPI. BUILD names a folder that keeps what was compiled. For macOS it also needs ld64.lld, the linker of
LLVM (Debian's lld), because the linker of Zig 0.17 crashes on the module.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
CROSS = ROOT / ".ci" / "cross"


@dataclass(frozen=True)
class Target:
    """A system: its names in wheels, in CMake and in Zig, and the module's file. minimum: the oldest macOS."""

    tag: str
    system: str
    processor: str
    triple: str
    module: str = "_native.abi3.so"
    minimum: str = ""


TARGETS = {
    "linux-aarch64": Target("manylinux_2_28_aarch64", "Linux", "aarch64", "aarch64-linux-gnu.2.28"),
    "macos-arm64": Target("macosx_11_0_arm64", "Darwin", "arm64", "aarch64-macos.11.0", minimum="11.0"),
    "macos-x86_64": Target("macosx_10_15_x86_64", "Darwin", "x86_64", "x86_64-macos.10.15", minimum="10.15"),
    "windows-amd64": Target("win_amd64", "Windows", "AMD64", "x86_64-windows-gnu", "_native.pyd"),
}


def tools(folder: Path, zig: Path) -> None:
    """The headers of Python for any system, the names of python3.dll, and Zig's archiver under names of its own."""
    from abi3info import DATAS, FUNCTIONS

    shutil.copytree(sysconfig.get_path("include"), folder / "include", dirs_exist_ok=True)
    shutil.copy(CROSS / "pyconfig.h", folder / "include")
    for name in ("ar", "ranlib"):
        (folder / name).write_text(f'#!/bin/sh\nexec "{zig}" {name} "$@"\n')
        (folder / name).chmod(0o755)
    names = [f"    {symbol.name}" for symbol in FUNCTIONS] + [f"    {symbol.name} DATA" for symbol in DATAS]
    (folder / "python3.def").write_text("\n".join(["LIBRARY python3.dll", "EXPORTS", *sorted(names), ""]))
    library = ["-m", "i386:x86-64", "-d", folder / "python3.def", "-l", folder / "python3.lib"]
    subprocess.run([zig, "dlltool", *library], check=True)


def macos_linker(target: Target, folder: Path, zig: Path) -> None:
    """A script that links a module of macOS: the libraries of C++ are Zig's, in the module; the system's is told by
    name, and Python's functions are found as it loads."""
    names = ("ld64.lld", *(f"ld64.lld-{version}" for version in range(25, 13, -1)))
    linker = next((found for name in names if (found := shutil.which(name))), None)
    if linker is None:
        sys.exit("ld64.lld is missing: install LLVM's linker (Debian's lld)")
    empty, place = folder / "empty.cpp", folder / target.processor
    place.mkdir(exist_ok=True)
    empty.write_text("#include <string>\nint main(int, char** all) { throw std::string(all[0]); }\n")
    told = subprocess.run(
        [zig, "c++", "-target", target.triple, empty, "-o", place / "empty"],
        env={**os.environ, "ZIG_VERBOSE_LINK": "1"}, check=True, capture_output=True, text=True,
    )  # fmt: skip
    libraries = [word for word in told.stderr.split() if word.endswith(".a")]
    system = (zig.parent / "lib" / "libc" / "darwin" / "libSystem.tbd").read_text()
    # A processor that older linkers do not know.
    system = re.sub(r"arm64e\.x1-\w+,\s*", "", re.sub(r",\s*arm64e\.x1-\w+", "", system))
    (place / "libSystem.tbd").write_text(system)
    words = ["-arch", target.processor, "-platform_version", "macos", target.minimum, target.minimum, "-bundle"]
    words += ["-undefined", "dynamic_lookup", "-dead_strip", "-exported_symbol", "_PyInit__native", "-o", '"$@"']
    words += [*libraries, f"-L{place}", "-lSystem"]
    script = folder / "link"
    script.write_text(f"#!/bin/sh\nexec {linker} {' '.join(words)}\n")
    script.chmod(0o755)


def compile_module(target: Target, build: Path, folder: Path, zig: Path) -> Path:
    """The module for a target."""
    import nanobind

    if target.system == "Darwin":
        macos_linker(target, folder, zig)
    values = {
        "CMAKE_TOOLCHAIN_FILE": CROSS / "toolchain.cmake",
        "CMAKE_BUILD_TYPE": "Release",
        "MIPBAKE_SYSTEM": target.system,
        "MIPBAKE_PROCESSOR": target.processor,
        "MIPBAKE_TARGET": target.triple,
        "MIPBAKE_ZIG": zig,
        "MIPBAKE_TOOLS": folder,
        "MIPBAKE_PYTHON": sys.executable,
        "MIPBAKE_CUDA": "OFF",
        "SKBUILD_SABI_COMPONENT": "Development.SABIModule",
        "nanobind_ROOT": nanobind.cmake_dir(),
    }
    defines = [f"-D{name}={value}" for name, value in values.items()]
    subprocess.run(["cmake", "-S", ROOT, "-B", build, "-G", "Ninja", "-Wno-dev", *defines], check=True)
    subprocess.run(["cmake", "--build", build, "--target", "_native"], check=True)
    return build / target.module


def assemble(wheel: Path, module: Path, target: Target, out: Path) -> Path:
    """The wheel with another module in it."""
    with tempfile.TemporaryDirectory() as temporary:
        run = [sys.executable, "-m", "wheel"]
        subprocess.run([*run, "unpack", "--dest", temporary, wheel], check=True)
        (tree,) = Path(temporary).iterdir()
        (here,) = (tree / "mipbake").glob("_native.*.so")
        here.unlink()
        shutil.copy(module, tree / "mipbake" / target.module)
        # What auditwheel noted of the other module.
        shutil.rmtree(next(tree.glob("*.dist-info")) / "sboms", ignore_errors=True)
        subprocess.run([*run, "pack", "--dest-dir", temporary, tree], check=True)
        (packed,) = Path(temporary).glob("*.whl")
        subprocess.run([*run, "tags", "--remove", "--platform-tag", target.tag, packed], check=True)
        (tagged,) = Path(temporary).glob("*.whl")
        return Path(shutil.copy(tagged, out))


def main() -> None:
    """Reads the arguments, and makes one wheel after the other."""
    arguments = sys.argv[1:]
    names = arguments[2:] or list(TARGETS)
    wheel = Path(arguments[0]) if arguments else Path()
    unknown = [name for name in names if name not in TARGETS]
    if unknown:
        sys.exit(f"{unknown[0]} is no target: expected any of {', '.join(TARGETS)}")
    if not (wheel.is_file() and "-cp312-abi3-" in wheel.name):
        sys.exit(f"'{wheel}' is no wheel for Python 3.12 and later: name one whose file name has -cp312-abi3- in it")
    if sys.version_info < (3, 12):
        sys.exit(f"this is Python {sys.version_info[0]}.{sys.version_info[1]}: run .ci/cross.py on 3.12 or later")
    import ziglang

    zig = Path(ziglang.__file__).parent / "zig"
    out = Path(arguments[1] if arguments[1:] else "dist")
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temporary:
        build = Path(os.environ.get("BUILD", temporary)).resolve()
        (build / "tools").mkdir(parents=True, exist_ok=True)
        tools(build / "tools", zig)
        for name in names:
            module = compile_module(TARGETS[name], build / name, build / "tools", zig)
            made = assemble(wheel, module, TARGETS[name], out)
            subprocess.run([sys.executable, "-m", "abi3audit", "--strict", "--summary", made], check=True)
            print(made)


if __name__ == "__main__":
    main()
