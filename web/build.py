"""Compiles the core to WebAssembly: web/dist/bakes.wasm, the same for engines without SIMD, and the weights beside it.

    python web/build.py [FOLDER]     FOLDER keeps what was compiled, build/web where none is named

Needs cmake, ninja and ziglang, all of them on PyPI.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

WEB = Path(__file__).resolve().parent
ROOT = WEB.parent
WEIGHTS = ("mipbake-3", "mipbake-3-anisotropic", "mipbake-3-ggx")


def compiled(which: str, build: Path, simd: bool = True) -> Path:
    """The module of WebAssembly that csrc/wasm/<which>.cpp makes; `build` keeps what was compiled."""
    import ziglang

    zig = Path(ziglang.__file__).parent / "zig"
    subprocess.run(
        ["cmake", "-S", ROOT, "-B", build, "-G", "Ninja", "-DCMAKE_BUILD_TYPE=Release", "-Wno-dev",
         f"-DCMAKE_TOOLCHAIN_FILE={WEB / 'toolchain.cmake'}", f"-DMIPBAKE_ZIG={zig}", f"-DMIPBAKE_WASM={which}",
         f"-DMIPBAKE_WASM_SIMD={'ON' if simd else 'OFF'}"],
        check=True,
    )  # fmt: skip
    subprocess.run(["cmake", "--build", build], check=True)
    return build / "mipbake_wasm"


def main() -> None:
    """Compiles and copies."""
    dist = WEB / "dist"
    build = Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "build" / "web"
    dist.mkdir(exist_ok=True)
    shutil.copy(compiled("bakes", build / "simd"), dist / "bakes.wasm")
    shutil.copy(compiled("bakes", build / "scalar", simd=False), dist / "bakes-scalar.wasm")
    for name in WEIGHTS:
        for suffix in (".json", ".safetensors"):
            shutil.copy(ROOT / "models" / "weights" / f"{name}{suffix}", dist)


if __name__ == "__main__":
    main()
