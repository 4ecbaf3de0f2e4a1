"""Renderers by the names that the command line takes, and the views that go with them."""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from functools import wraps
from pathlib import Path
from typing import Any

from mipbake.base.errors import MipbakeError, RendererError, UsageError
from mipbake.fitting.process import ProcessRenderer
from mipbake.fitting.program import Frame
from mipbake.fitting.protocol import read_views
from mipbake.fitting.renderer import Levels, Renderer
from mipbake.fitting.views import standard_views

RENDERERS = ("gl", "three", "torch")

_OPTIONS = {"timeout": "renderer-timeout", "start_timeout": "renderer-start-timeout", "views": "views-file"}
"""What the command line calls them, where that is another word."""


@dataclass(frozen=True)
class RendererChoice:
    """Which renderer a fit has, as the command line takes it.

    Args:
        renderer: a name in RENDERERS, or MODULE:FACTORY, a function without arguments that makes a renderer; None for
            `command`.
        shader: for `gl` the name of a shader that comes with mipbake, or a file of GLSL; for `three` the name of a
            material; None for the default.
        command: a program that speaks the protocol of docs/fit-protocol.md. timeout: seconds that a render may take.
            start_timeout: seconds that the program may take to start.
        three: the folder that holds three.js; None to look for it.
        views: a JSON file with a list of views for `command` or MODULE:FACTORY; None for views of a plane.

    Raises:
        UsageError: none or two renderers, or an option that the renderer does not have.
    """

    renderer: str | None
    shader: str | None = None
    command: str | None = None
    timeout: float | None = None
    start_timeout: float | None = None
    three: Path | None = None
    views: Path | None = None

    def __post_init__(self) -> None:
        if (self.renderer is None) == (self.command is None):
            raise UsageError("expected a renderer, by --renderer or by --renderer-command, and not both")
        if self.renderer is not None and self.renderer not in RENDERERS and ":" not in self.renderer:
            raise UsageError(f"unknown renderer {self.renderer!r}: expected {', '.join(RENDERERS)} or MODULE:FACTORY")
        allowed = {
            "shader": self.renderer in ("gl", "three"),
            "three": self.renderer == "three",
            "timeout": self.command is not None or self.renderer == "three",
            "start_timeout": self.command is not None,
            "views": self.renderer not in RENDERERS,
        }
        for name, fits in allowed.items():
            if getattr(self, name) is not None and not fits:
                option = _OPTIONS.get(name, name)
                raise UsageError(
                    f"--{option} does not go with the renderer {self.renderer or self.command}: leave it out"
                )

    def made(self) -> Renderer[Any]:
        """The renderer.

        Raises:
            UsageError: it does not exist, or lacks something that it needs.
            RendererError: the function that makes it raised something.
        """
        if self.renderer == "torch":
            from mipbake.fitting.kernels import TorchRenderer

            return TorchRenderer()
        if self.renderer is None or self.renderer in RENDERERS:
            given = {"timeout": self.timeout, "start_timeout": self.start_timeout}
            limits = {name: value for name, value in given.items() if value is not None}
            if self.command is not None:
                return ProcessRenderer(self.command, **limits)
            renderer = ProcessRenderer(self._shipped(), **limits)
            renderer.start()  # what the user can mend is said before long work
            return renderer
        return _from_module(self.renderer)

    def _shipped(self) -> list[str]:
        """The command of a renderer that comes with mipbake. It finds modules where this process does."""
        if self.renderer == "gl":
            arguments = [self.shader] if self.shader else []
        else:
            arguments = [str(self.three or ""), self.shader or "physical"]
        start = f"import sys; sys.path[:] = {sys.path!r}; from mipbake.fitting.{self.renderer} import main; main()"
        return [sys.executable, "-c", start, *arguments]

    def views_of(
        self, size: tuple[int, int], wrap: tuple[str, str], each: int, seed: int
    ) -> tuple[Sequence[Any], Sequence[Any] | None]:
        """The views of a stack, and views to check with: the views of the file, of which some are later kept for checks
        (None); or `each` of a plane at each level of detail, and a quarter as many others.

        Raises:
            InputError: the file cannot be read.
        """
        if self.views is not None:
            return read_views(self.views), None
        return standard_views(size, wrap, each, seed), standard_views(size, wrap, max(2, each // 4), seed + 1)


def _from_module(given: str) -> Renderer[Any]:
    module, _, factory = given.partition(":")
    folder = str(Path.cwd())
    if folder not in sys.path:
        sys.path.insert(0, folder)  # so that a file beside the user is found, as `python -m` finds it
    try:
        found = getattr(importlib.import_module(module), factory)
    except (Exception, SystemExit) as error:
        raise UsageError(
            f"the renderer {given} cannot be imported ({type(error).__name__}: {error}): expected MODULE:FACTORY, a "
            "function without arguments in a module that Python finds"
        ) from error
    made = _telling(found, given)()
    if not callable(getattr(made, "render", None)):
        raise UsageError(f"{given}() gave a {type(made).__name__}: expected an object with render(levels, view)")
    return _UserRenderer(made, given)


class _UserRenderer:
    """A renderer of the user's. What its methods raise becomes a RendererError, with lines that say where."""

    def __init__(self, renderer: Any, given: str) -> None:
        self._renderer, self._given = renderer, given
        self.called = getattr(renderer, "called", type(renderer).__name__)

    def render(self, levels: Levels, view: Any) -> Frame:
        return _telling(self._renderer.render, self._given)(levels, view)  # type: ignore[no-any-return]

    def __getattr__(self, name: str) -> Any:  # methods that a renderer may have or not
        return _telling(getattr(self._renderer, name), self._given)


def _telling(function: Any, given: str) -> Any:
    @wraps(function)
    def telling(*arguments: Any) -> Any:
        try:
            return function(*arguments)
        except MipbakeError:
            raise
        except (Exception, SystemExit) as error:
            own = None if error.__traceback__ is None else error.__traceback__.tb_next
            lines = traceback.format_exception(type(error), error, own)
            raise RendererError(
                f"the renderer {given} raised {type(error).__name__} ({error}): expected none, so mend it where these "
                "lines say\n" + "".join(lines).rstrip()
            ) from error

    return telling
