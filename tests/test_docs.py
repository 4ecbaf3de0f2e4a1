"""Pages that quote the code stay in step with it."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_the_primitives_page_quotes_the_docstrings() -> None:
    run = subprocess.run(
        [sys.executable, ROOT / "docs" / "make_primitives_page.py", "--check"],
        check=False,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stderr
