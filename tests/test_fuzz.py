"""Damaged files through every reader: each is read or refused with a sentence, whatever is in it.

`python -m tests.fuzz` goes on for as long as one likes, and keeps what broke.
"""

from __future__ import annotations

import os

import pytest

from .fuzz.__main__ import summary
from .fuzz.campaign import CORPUS, case_of, run
from .fuzz.make_corpus import MAKERS
from .fuzz.readers import READERS

pytestmark = pytest.mark.skipif(os.name == "nt", reason="limits of processes are those of POSIX")


def test_every_reader_has_a_corpus_and_every_corpus_a_reader() -> None:
    assert {folder.name for folder in CORPUS.iterdir()} == set(READERS) == set(MAKERS)
    sizes = [file.stat().st_size for file in CORPUS.rglob("*") if file.is_file()]
    assert sum(sizes) < 250_000


def test_an_input_can_be_made_again() -> None:
    readers = sorted(READERS)
    assert case_of(1234, 5, readers) == case_of(1234, 5, readers) != case_of(1234, 6, readers)


@pytest.mark.long
def test_damaged_files_are_read_or_refused() -> None:
    """Every file of the corpus as it is, and thousands of damaged ones: about half a minute of one core."""
    result = run(seed=0, readers=sorted(READERS), inputs=3000, seconds=None)
    assert not result.defects, summary(result)
    assert result.answers["read"] > 100 and result.answers["refused"] > 100
