"""Renderers by the names that the command line takes, and the views that go with them."""

from __future__ import annotations

import importlib
import sys
import traceback
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mipbake.base.errors import MipbakeError, RendererError, UsageError
from mipbake.fitting.process import TIMEOUT, ProcessRenderer
from mipbake.fitting.program import Frame
from mipbake.fitting.protocol import read_views
from mipbake.fitting.renderer import Levels, Renderer
from mipbake.fitting.views import standard_views

RENDERERS = ("gl", "three", "torch")


@dataclass(frozen=True)
class RendererChoice:
    """Which renderer a fit has, as the command line takes it.

    Args:
        renderer: a name in RENDERERS, or MODULE:FACTORY, a function without arguments that makes a renderer; None for
            `command`.
        shader: for `gl` the name of a shader that comes with mipbake, or a file of GLSL; for `three` the name of a
            material; None for the default.
        command: a program that speaks the protocol of docs/fit-protocol.md.
        timeout: seconds that a program or a browser may take to start, and for a render; None for 120.
        views: a JSON file with a list of views for `command` or MODULE:FACTORY; None for views of a plane.

    Raises:
        UsageError: none or two renderers, or an option that the renderer does not have.
    """

    renderer: str | None
    shader: str | None = None
    command: str | None = None
    timeout: float | None = None
    views: Path | None = None

    def __post_init__(self) -> None:
        if (self.renderer is None) == (self.command is None):
            raise UsageError("expected a renderer, by --renderer or by --renderer-command, and not both")
        if self.renderer is not None and self.renderer not in RENDERERS and ":" not in self.renderer:
            raise UsageError(f"unknown renderer {self.renderer!r}: expected {', '.join(RENDERERS)} or MODULE:FACTORY")
        shipped = self.renderer in ("gl", "three")
        for option, value, fits in (
            ("--shader", self.shader, shipped),
            ("--renderer-timeout", self.timeout, shipped or self.command is not None),
            ("--views-file", self.views, self.renderer not in RENDERERS),
        ):
            if value is not None and not fits:
                raise UsageError(
                    f"{option} does not go with the renderer {self.renderer or self.command}: leave it out"
                )

    def made(self) -> Renderer[Any]:
        """The renderer. UsageError: it does not exist, or lacks something. RendererError: what makes it failed."""
        timeout = TIMEOUT if self.timeout is None else self.timeout
        if self.command is not None:
            return ProcessRenderer(self.command, timeout=timeout)
        if self.renderer == "torch":
            from mipbake.fitting.kernels import TorchRenderer

            return TorchRenderer()
        assert self.renderer is not None
        if self.renderer not in RENDERERS:
            return _UserRenderer(self.renderer)
        # It finds modules where this process does.
        start = f"import sys; sys.path[:] = {sys.path!r}; from mipbake.fitting.{self.renderer} import main; main()"
        renderer = ProcessRenderer([sys.executable, "-c", start, *filter(None, [self.shader])], timeout=timeout)
        renderer.start()  # what the user can mend is said before long work
        return renderer

    def views_of(
        self, size: tuple[int, int], wrap: tuple[str, str], each: int, seed: int
    ) -> tuple[Sequence[Any], Sequence[Any] | None, Sequence[Any] | None]:
        """Views of a stack to learn from, to choose by, and to judge the result with.

        They are the views of the file, of which `fit` keeps some for the other uses (None); or `each` of a plane at
        each level of detail, and a quarter as many others for each of the other uses. InputError: the file cannot be
        read.
        """
        if self.views is not None:
            return read_views(self.views), None, None
        fewer = max(2, each // 4)
        checked, apart = (standard_views(size, wrap, fewer, seed + more) for more in (1, 2))
        return standard_views(size, wrap, each, seed), checked, apart


class _UserRenderer:
    """A renderer of the user's, MODULE:FACTORY. What it raises becomes a RendererError, with lines that say where."""

    def __init__(self, given: str) -> None:
        self._given = given
        module, _, factory = given.partition(":")
        folder = str(Path.cwd())
        if folder not in sys.path:
            sys.path.insert(0, folder)  # so that a file beside the user is found, as `python -m` finds it
        try:
            found = getattr(importlib.import_module(module), factory)
        except (Exception, SystemExit) as error:
            raise UsageError(
                f"the renderer {given} cannot be imported ({type(error).__name__}: {error}): expected MODULE:FACTORY, "
                "a function without arguments in a module that Python finds"
            ) from error
        self._renderer = self._of(found)
        if not callable(getattr(self._renderer, "render", None)):
            raise UsageError(
                f"{given}() gave a {type(self._renderer).__name__}: expected an object with render(levels, view)"
            )
        self.called = getattr(self._renderer, "called", type(self._renderer).__name__)

    def render(self, levels: Levels, view: Any) -> Frame:
        frame: Frame = self._of(self._renderer.render, levels, view)
        return frame

    def close(self) -> None:
        if hasattr(self._renderer, "close"):
            self._of(self._renderer.close)

    def _of(self, function: Callable[..., Any], *arguments: Any) -> Any:
        """What a function of the user's returns."""
        try:
            return function(*arguments)
        except MipbakeError:
            raise
        except (Exception, SystemExit) as error:
            own = None if error.__traceback__ is None else error.__traceback__.tb_next
            lines = traceback.format_exception(type(error), error, own)
            raise RendererError(
                f"the renderer {self._given} raised {type(error).__name__} ({error}): expected none, so mend it where "
                "these lines say\n" + "".join(lines).rstrip()
            ) from error
