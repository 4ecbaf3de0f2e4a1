"""Without the packages of extras commands work, or say in one sentence what to install."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from mipbake.base.errors import UsageError
from mipbake.base.extras import EXTRAS, check_extra, extra, told_of

from .command_line import write_set

BLOCKED = sorted(module for packages in EXTRAS.values() for module in packages)
SCRIPT = f"""
import sys
for name in {BLOCKED!r}:
    sys.modules[name] = None
from mipbake.cli.main import main
sys.exit(main(sys.argv[1:]))
"""
ROOT = Path(__file__).resolve().parent.parent
SET = ROOT / "examples" / "lacquered_leather"


def command(*arguments: str | Path) -> subprocess.CompletedProcess[str]:
    """Runs the command line where no package of an extra can be imported."""
    return subprocess.run(
        [sys.executable, "-c", SCRIPT, *map(str, arguments)], capture_output=True, text=True, check=False, cwd=ROOT
    )


@pytest.mark.long
def test_commands_work_without_extras(tmp_path: Path) -> None:
    folder, out = write_set(tmp_path / "metal"), tmp_path / "out"
    for arguments in (
        ("bake", folder, "-o", out, "--method", "linear", "--format", "exr,ktx2:uastc,dds:bc1,glb"),
        ("bake", folder, "-o", tmp_path / "auto", "--budget", "0.01s", "--colour-space", "Display P3"),
        ("info", out / "metal"),
        ("convert", folder, "-o", tmp_path / "converted", "--to", "ggx"),
        ("validate", folder, out / "metal"),
    ):
        done = command(*arguments)
        assert done.returncode == 0, done.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (
            ("compare", SET, "-o", "{tmp}"),
            "a comparison needs colour-science, flip-evaluator, scipy, scikit-image, which mipbake's extra "
            '`compare` brings: python -m pip install "mipbake[compare]"',
        ),
        (
            ("inspect", SET, "--colour-space", "ProPhoto RGB"),
            "the colour space 'ProPhoto RGB', which mipbake does not know itself, needs colour-science",
        ),
        (
            ("bake", SET, "-o", "{tmp}", "--device", "cuda"),
            "the device cuda needs torch, which mipbake's extra `train` brings: python -m pip install "
            '"mipbake[train]"',
        ),
    ],
)
def test_who_lacks_an_extra_reads_what_to_type(arguments, sentence, tmp_path):
    done = command(*(str(argument).format(tmp=tmp_path / "out") for argument in arguments))
    assert done.returncode == 2, done.stderr
    assert sentence in done.stderr and done.stderr.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_packages_that_are_broken_are_not_called_missing() -> None:
    with pytest.raises(ModuleNotFoundError, match="no_such"), extra("compare", "this"):
        import no_such_package  # noqa: F401
    with pytest.raises(UsageError, match="this needs scipy, which"), extra("compare", "this"):
        raise ModuleNotFoundError(name="scipy.ndimage")
    check_extra("compare", "this")
    assert told_of(ModuleNotFoundError(name="no_such_package")) is None
    assert "this needs torch, which mipbake's extra `train` brings" in (
        told_of(ModuleNotFoundError(name="torch")) or ""
    )
