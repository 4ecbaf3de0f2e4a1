"""Variables of the environment that the native core reads hold what they can hold, or a sentence says so."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from mipbake import _native

WRONG = [("MIPBAKE_THREADS", text) for text in ("abc", "0", "1025", "2.5")] + [("MIPBAKE_ISA", "sse")]
SHADE = "import numpy as n; from mipbake.shading import shade; shade('gltf', *map(n.ones, [(9, 8), (2, 3), (2, 3)]))"
FIRST_USE = {
    "MIPBAKE_THREADS": SHADE,
    "MIPBAKE_ISA": "from mipbake import _native; _native.isa()",  # on other processors kernels have no choice
}


def run(variable: str, text: str, script: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", script], env={**os.environ, variable: text}, capture_output=True, text=True, check=False
    )


def test_threads_are_a_number() -> None:
    found = run("MIPBAKE_THREADS", "7", "from mipbake import _native; print(_native.num_threads())")
    assert found.stdout == "7\n", found.stderr


def test_an_instruction_set_that_is_lacking_gives_the_best_that_is_there() -> None:
    found = run("MIPBAKE_ISA", "avx512", "from mipbake import _native; print(_native.isa())")
    assert found.stdout.strip() in ("baseline", "avx2", "avx512"), found.stderr
    assert run("MIPBAKE_ISA", "baseline", "from mipbake import _native; print(_native.isa())").stdout == "baseline\n"
    assert _native.isa()


@pytest.mark.long
@pytest.mark.parametrize(("variable", "text"), WRONG)
def test_anything_else_is_a_sentence(variable: str, text: str) -> None:
    library = run(variable, text, FIRST_USE[variable])
    assert "UsageError: the environment variable " + variable in library.stderr and repr(text) in library.stderr
    command = run(
        variable, text, "import sys; from mipbake.cli.main import main; sys.exit(main(['info', 'nothing.png']))"
    )
    assert command.returncode == 2 and command.stderr.count("\n") == 1, command.stderr
    assert f"{variable} is '{text}': expected" in command.stderr
