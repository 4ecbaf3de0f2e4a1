"""The wheel for any system: the core as WebAssembly, which wasmtime runs, in place of the compiled one.

    python .ci/fallback_wheel.py [FOLDER]     writes the wheel to FOLDER, dist where none is named

Needs cmake, ninja, wheel and ziglang, all of them on PyPI. What was compiled stays in build/fallback. The core stays in
mipbake/_wasm, where the tests find it.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "web"))
from build import compiled  # noqa: E402

BUILD = ROOT / "build" / "fallback"
CORE = ROOT / "mipbake" / "_wasm" / "core.wasm"
RUNTIME = "wasmtime>=50"
NATIVE = "import sys\n\nfrom mipbake import _wasm\n\nsys.modules[__name__] = _wasm\n"
"""What stands for the compiled module. No checkout has it, and Python prefers a compiled module of that name."""


def run(*command: str | Path) -> None:
    subprocess.run(command, check=True)


def main() -> None:
    """Compiles the core, and puts it into a wheel of everything but a compiled core."""
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "dist").resolve()
    shutil.copyfile(compiled("native", BUILD), CORE)
    with tempfile.TemporaryDirectory() as folder:
        pure, parts = Path(folder, "pure"), Path(folder, "parts")
        settings = "wheel.cmake=false", "wheel.py-api=py3", "wheel.platlib=false"
        options = [f"--config-settings={each}" for each in settings]
        run(sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", *options, "-w", pure, ROOT)
        run(sys.executable, "-m", "wheel", "unpack", "--dest", parts, next(pure.glob("*.whl")))
        (tree,) = parts.iterdir()
        shutil.copyfile(CORE, tree / "mipbake" / "_wasm" / CORE.name)
        (tree / "mipbake" / "_native").with_suffix(".py").write_text(NATIVE, encoding="utf-8")
        (described,) = tree.glob("*.dist-info/METADATA")
        text = described.read_text(encoding="utf-8")
        required = re.sub(r"^Requires-Dist:", f"Requires-Dist: {RUNTIME}\nRequires-Dist:", text, count=1, flags=re.M)
        described.write_text(required, encoding="utf-8")
        out.mkdir(parents=True, exist_ok=True)
        run(sys.executable, "-m", "wheel", "pack", "--dest-dir", out, tree)


if __name__ == "__main__":
    main()
