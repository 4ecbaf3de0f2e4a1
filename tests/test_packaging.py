"""What the build installs is what the checkout holds."""

from __future__ import annotations

from importlib import metadata
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
ROOMS = {
    "mipbake/": "mipbake",
    "mipbake/models/": "models",
    "mipbake/training/": "training",
    "mipbake/cli/": "cli",
    "mipbake_start/": "cli/mipbake_start",
}


def test_the_wheel_holds_every_module_config_and_weight() -> None:
    try:
        files = metadata.files("mipbake")
    except metadata.PackageNotFoundError:
        pytest.skip("mipbake is not installed: it runs from the checkout")
    assert files is not None
    installed = {str(path) for path in files}
    kinds = {".py", ".pyi", ".toml", ".safetensors", ".json", ".md", ".typed"}
    rooms = {ROOT / folder for folder in ROOMS.values()}
    expected = {
        f"{prefix}{path.relative_to(ROOT / folder).as_posix()}"
        for prefix, folder in ROOMS.items()
        for path in (ROOT / folder).rglob("*")
        if path.suffix in kinds and "__pycache__" not in path.parts
        # A file belongs to the innermost room that it is in.
        if next(parent for parent in path.parents if parent in rooms) == ROOT / folder
    }
    assert expected - installed == set()
    assert any(name.startswith("mipbake/_native") and not name.endswith(".pyi") for name in installed)
