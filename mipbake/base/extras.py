"""Packages that not every command needs: they come with extras of mipbake, and who lacks one is told what to type."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from importlib.util import find_spec

from mipbake.base.errors import UsageError

EXTRAS: Mapping[str, Mapping[str, str]] = {
    "cluster": {"ray": "ray"},
    "compare": {
        "colour": "colour-science",
        "flip_evaluator": "flip-evaluator",
        "scipy": "scipy",
        "skimage": "scikit-image",
    },
    "etc1s": {"alktx2": "alktx2"},
    "fit": {"moderngl": "moderngl"},
    "train": {"torch": "torch"},
    "watch": {"watchfiles": "watchfiles"},
}
"""Extra to the modules that the code imports, and what each is called where it is installed from."""


@contextmanager
def extra(name: str, user: str) -> Iterator[None]:
    """Around imports of packages that an extra brings.

    Args:
        name: a key of EXTRAS.
        user: what needs the packages, as the beginning of a sentence.

    Raises:
        UsageError: one of them is not installed; the sentence says what to type.
    """
    try:
        yield
    except ModuleNotFoundError as error:
        missing = (error.name or "").partition(".")[0]
        if missing not in EXTRAS[name]:
            raise  # a package that is installed lacks something itself
        raise UsageError(_sentence(name, user, EXTRAS[name][missing])) from None


def told_of(error: ModuleNotFoundError) -> str | None:
    """What to type, as a sentence, where an extra brings what was not found; None where none does."""
    missing = (error.name or "").partition(".")[0]
    bringing = (name for name, packages in EXTRAS.items() if missing in packages)
    return next((_sentence(name, "this", EXTRAS[name][missing]) for name in bringing), None)


def check_extra(name: str, user: str) -> None:
    """UsageError, as of `extra`, where a package of an extra is not installed. For before long work; imports none."""
    missing = [distribution for module, distribution in EXTRAS[name].items() if find_spec(module) is None]
    if missing:
        raise UsageError(_sentence(name, user, ", ".join(missing)))


def _sentence(name: str, user: str, missing: str) -> str:
    return f'{user} needs {missing}, which mipbake\'s extra `{name}` brings: python -m pip install "mipbake[{name}]"'
