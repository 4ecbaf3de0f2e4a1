"""mypy, strict, over the rooms under their import names: the build maps models/, training/, cli/ into the package.

An editable install does not serve: it finds these rooms by a hook at run time (tried with scikit-build-core 1.1), which
mypy and editors do not follow. So links lay the rooms out here as the build does.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        package = Path(folder) / "mipbake"
        package.mkdir()
        for entry in (ROOT / "mipbake").iterdir():
            (package / entry.name).symlink_to(entry)
        for room in ("models", "training", "cli"):
            (package / room).symlink_to(ROOT / room)
        (Path(folder) / "mipbake_start").symlink_to(ROOT / "cli" / "mipbake_start")
        command = [
            sys.executable,
            "-m",
            "mypy",
            "--config-file",
            str(ROOT / "pyproject.toml"),
            "-p",
            "mipbake",
            "-p",
            "mipbake_start",
        ]
        return subprocess.run(command, cwd=folder, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
