"""Commands are loaded when they are asked for, and what is said of them before that is what they say themselves."""

from __future__ import annotations

import inspect
import subprocess
import sys
from pathlib import Path

import pytest

import mipbake
from mipbake.cli.commands import SUMMARIES, loaded

SET = Path(__file__).resolve().parent.parent / "examples" / "glazed_tiles"


def loaded_by(*arguments: str) -> set[str]:
    """Modules that are loaded when a command has run."""
    script = "import sys; from mipbake.cli.main import main; main(sys.argv[1:]); print(*sys.modules, file=sys.stderr)"
    run = subprocess.run([sys.executable, "-c", script, *arguments], capture_output=True, text=True, check=True)
    return set(run.stderr.split())


def test_help_on_all_commands_loads_none() -> None:
    loaded = loaded_by("--help")
    assert "mipbake.cli.main" in loaded
    assert not loaded & {
        "numpy",
        "rich",
        "mipbake.source.images.read",
        "mipbake.baking.methods",
        *(f"mipbake.cli.{n}" for n in SUMMARIES),
    }


@pytest.mark.long
@pytest.mark.parametrize("arguments", [("inspect", str(SET)), ("presets",)])
def test_a_command_loads_no_methods_that_it_does_not_use(arguments: tuple[str, ...]) -> None:
    loaded = loaded_by(*arguments)
    assert not loaded & {"torch", "mipbake.baking.methods", "mipbake.comparing", "mipbake.comparing.meshes"}


def test_the_list_says_the_first_sentence_of_each_command() -> None:
    for name, summary in SUMMARIES.items():
        said = " ".join((inspect.getdoc(loaded(name)) or "").split())
        assert said.startswith(summary) and summary.endswith(".")


def test_the_package_offers_names_and_no_modules() -> None:
    assert set(mipbake.__all__) <= set(dir(mipbake))
    for name in mipbake.__all__:
        assert not inspect.ismodule(getattr(mipbake, name)), name
    with pytest.raises(AttributeError, match="no attribute 'brake'"):
        mipbake.brake  # type: ignore[attr-defined]  # noqa: B018
