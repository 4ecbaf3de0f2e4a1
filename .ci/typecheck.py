"""mypy, strict, over the rooms under their import names: pyproject.toml maps models/, training/, cli/ into the package.

An editable install does not serve: it finds these rooms by a hook at run time (tried with scikit-build-core 1.1), which
mypy and editors do not follow. So links lay the rooms out here as the build does.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))
from source_tree import folders  # noqa: E402


def main() -> int:
    with tempfile.TemporaryDirectory() as folder:
        for name, where in folders().items():
            place = Path(folder, *name.split("."))
            if any(other.startswith(f"{name}.") for other in folders()):
                place.mkdir()
                for entry in (ROOT / where).iterdir():
                    (place / entry.name).symlink_to(entry)
            else:
                place.symlink_to(ROOT / where)
        packages = [word for name in folders() if "." not in name for word in ("-p", name)]
        command = [sys.executable, "-m", "mypy", "--config-file", str(ROOT / "pyproject.toml"), *packages]
        return subprocess.run(command, cwd=folder, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
