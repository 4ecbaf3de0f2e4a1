"""`mipbake fit`: what it writes, what it goes on from, and what it says of renderers that do not work."""

import json
import sys
import textwrap
from pathlib import Path

import numpy as np
import pytest

from mipbake import open_stack
from mipbake.cli.main import main
from mipbake.fitting.viewing import _EFFORTS

from .command_line import fails, write_set

QUICK = ["--views", "2", "--budget", "best", "--steps", "6"]
AVERAGED = ["--start", "linear"]


@pytest.fixture(autouse=True)
def few_renders(monkeypatch):
    """References of few renders, and no rounds of least squares: what commands say does not hang on them."""
    monkeypatch.setattr("mipbake.fitting.shared.Rounds.run", lambda _rounds, values: (values, 0))
    monkeypatch.setattr("mipbake.fitting.viewing._EFFORTS", dict.fromkeys(_EFFORTS, (4, 4, 1.0)))


@pytest.fixture
def module(tmp_path, monkeypatch):
    """Makes a module of a renderer, and returns what --renderer takes."""

    def make(name, body):
        (tmp_path / f"{name}.py").write_text(textwrap.dedent(body))
        monkeypatch.syspath_prepend(str(tmp_path))
        return f"{name}:make"

    yield make
    for name in [name for name in sys.modules if name.startswith("own_renderer")]:
        del sys.modules[name]


def run(folder, out, *arguments):
    start = [] if "--start" in arguments else AVERAGED
    return main(["fit", str(folder), "-o", str(out), *QUICK, *start, *arguments])


def test_a_stack_is_fitted_and_says_so(folder, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(folder, out, "--renderer", "torch", "--json", "--format", "png") == 0
    (result,) = json.loads(capsys.readouterr().out)["results"]
    assert result["ok"] and "levels were fitted in the renderer torch to " in result["fitted"]
    assert {"fit", "write"} <= set(result["seconds"])
    stack = open_stack(out / "metal")
    assert stack.provenance.method == "linear" and stack.provenance.adjustments[-1] == result["fitted"]
    assert [path.name for path in out.iterdir()] == ["metal"]  # the state of the fit is gone
    assert any(path.suffix == ".png" for path in (out / "metal").iterdir())


@pytest.mark.long
def test_a_baked_stack_is_where_a_fit_starts(folder, tmp_path):
    assert main(["bake", str(folder), "-o", str(tmp_path / "baked"), "--method", "lean"]) == 0
    start = str(tmp_path / "baked" / "metal")
    assert run(folder, tmp_path / "out", "--renderer", "torch", "--start", start) == 0
    assert open_stack(tmp_path / "out" / "metal").provenance.method == "lean"


def test_a_stack_of_another_set_is_refused(folder, tmp_path, capsys):
    other = write_set(tmp_path / "other" / "metal", roughness=np.full((16, 16), 99, np.uint8))
    assert main(["bake", str(other), "-o", str(tmp_path / "baked"), "--method", "linear", "--quiet"]) == 0
    start = tmp_path / "baked" / "metal"
    err = fails(
        capsys, 2, "fit", folder, "-o", tmp_path / "out", "--quiet", *QUICK, "--renderer", "torch", "--start", start
    )
    assert "was not baked from metal" in err


FAILING = """
    from mipbake.fitting.kernels import TorchRenderer
    from mipbake.base.errors import RendererError

    class Failing(TorchRenderer):
        calls = 0
        broken = {broken}

        def render(self, levels, view):
            type(self).calls += 1
            if self.broken and self.calls > {after}:
                raise RendererError("the renderer stopped: expected a frame\\nfirst printed line\\nsecond printed line")
            return super().render(levels, view)

    def make():
        return Failing()
"""


DARKER = """
    from dataclasses import replace

    def darker(frame):
        return replace(frame, image=frame.image ** 3)
"""


@pytest.mark.long
def test_a_renderer_that_fails_loses_nothing(folder, tmp_path, module, capsys):
    """The state is kept, what the renderer printed is shown, and the same command goes on from there. Another renderer
    does not."""
    whole = tmp_path / "whole"
    assert run(folder, whole, "--renderer", module("own_renderer_whole", FAILING.format(broken=False, after=0))) == 0
    out = tmp_path / "out"
    capsys.readouterr()
    # What is before the last check: views and references; then the failure comes within the steps.
    sys.modules["own_renderer_whole"].Failing.broken = False
    calls = sys.modules["own_renderer_whole"].Failing.calls
    name = module("own_renderer_failing", FAILING.format(broken=True, after=calls - 140))
    assert run(folder, out, "--renderer", name, "--quiet") == 6
    err = capsys.readouterr().err.splitlines()
    assert err[0].startswith("mipbake: the renderer stopped: expected a frame")
    assert err[1:3] == ["first printed line", "second printed line"]
    assert [path.name for path in out.iterdir()] == ["metal.fit"]
    darker = FAILING.replace("super().render(levels, view)", "darker(super().render(levels, view))", 1)
    body = darker.format(broken=False, after=0) + DARKER
    assert run(folder, out, "--renderer", module("own_renderer_darker", body), "--quiet") == 3
    assert "metal.fit is of another fit: " in capsys.readouterr().err
    sys.modules["own_renderer_failing"].Failing.broken = False
    assert run(folder, out, "--renderer", name, "--quiet") == 0
    assert [path.name for path in out.iterdir()] == ["metal"]
    for one, other in zip(open_stack(whole / "metal").levels, open_stack(out / "metal").levels, strict=True):
        assert np.array_equal(one, other)


STOPPED = """
    from mipbake.fitting.kernels import TorchRenderer

    class Stopped(TorchRenderer):
        steps = 0

        def render(self, levels, view):
            if len(levels.sizes) > 1 and type(self).steps > {after}:
                raise KeyboardInterrupt
            type(self).steps += len(levels.sizes) > 1
            return super().render(levels, view)

    def make():
        return Stopped()
"""


def test_a_fit_that_is_stopped_writes_what_it_has(folder, tmp_path, module, capsys):
    """The state is kept beside the stack, and the same command goes on from it."""
    assert run(folder, tmp_path / "whole", "--renderer", module("own_renderer_whole", STOPPED.format(after=10**9))) == 0
    steps = sys.modules["own_renderer_whole"].Stopped.steps  # the last ones judge the result
    capsys.readouterr()
    name, out = module("own_renderer_stopped", STOPPED.format(after=steps - 10)), tmp_path / "out"
    assert run(folder, out, "--renderer", name) == 130
    told = capsys.readouterr()
    assert f"wrote {out / 'metal'}, as far as it was fitted" in told.out
    assert f"the same command goes on from {out / 'metal.fit'}" in told.err
    assert open_stack(out / "metal").provenance.adjustments[-1].endswith("the fit was stopped")
    sys.modules["own_renderer_stopped"].Stopped.steps = -(10**9)
    assert run(folder, out, "--renderer", name) == 0
    assert [path.name for path in out.iterdir()] == ["metal"]
    assert "views that nothing was learned from" in open_stack(out / "metal").provenance.adjustments[-1]


def test_lines_in_a_pipe_say_how_long_it_takes(folder, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("mipbake.base.progress.EVERY", 0.05)
    assert run(folder, tmp_path / "out", "--renderer", "torch", "--budget", "1h") == 0
    lines = [line for line in capsys.readouterr().err.splitlines() if "fitting texels" in line]
    assert any("left" in line for line in lines)
    assert all("left" in line or "98%" in line for line in lines)  # with 98% the phase is over


RAISING = """
    class Raising:
        def render(self, levels, view):
            {raises}

    def make():
        {made}
        return Raising()
"""


@pytest.mark.parametrize(
    ("where", "raises"), [("raises", 'raise RuntimeError("no licence")'), ("made", 'raise SystemExit("no licence")')]
)
def test_an_exception_of_a_renderer_is_told_with_its_place(folder, tmp_path, module, capsys, where, raises):
    parts = {"raises": "pass", "made": "pass"} | {where: raises}
    assert run(folder, tmp_path / "out", "--renderer", module("own_renderer_raising", RAISING.format(**parts))) == 6
    first, *lines = capsys.readouterr().err.splitlines()
    kind = raises.split()[1].split("(")[0]
    said = f"the renderer own_renderer_raising:make raised {kind} (no licence): expected none"
    assert first.startswith(f"mipbake: {said}")
    assert lines[0].startswith("Traceback") and raises in "".join(lines) and "mipbake" not in "".join(lines)
    assert lines[-1] == f"{kind}: no licence"


def test_a_program_renders(folder, tmp_path):
    program = tmp_path / "program.py"
    program.write_text(
        textwrap.dedent(
            """
            import numpy as np
            from mipbake.fitting.program import Frame, serve

            def render(maps, view):
                (height, width), (right, up) = view["size"], view.get("offset", (0, 0))
                x, y = (np.arange(width) + 0.5 + right) / width, (np.arange(height) + 0.5 - up) / height
                uv = np.stack(np.meshgrid(x, y), -1).astype(np.float32)
                level = maps.maps["base_color"][0]
                column, row = np.floor(uv * len(level)).astype(int).transpose(2, 0, 1) % len(level)
                return Frame(level[row, column], uv, lod=np.zeros((height, width), np.float32))

            serve(render)
            """
        )
    )
    views = tmp_path / "views.json"
    views.write_text(json.dumps([{"name": f"view {k}", "scale": "near", "size": [16, 16]} for k in range(5)]))
    command = f"{sys.executable} {program}"
    given = ["--renderer-command", command, "--views-file", str(views), "--renderer-timeout", "60"]
    assert run(folder, tmp_path / "out", *given) == 0


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ((), "--renderer-command"),
        (("--renderer", "torch", "--renderer-command", "true"), "not both"),
        (("--renderer", "cinema"), "unknown renderer 'cinema'"),
        (("--renderer", "torch", "--shader", "ramp"), "--shader does not go with"),
        (("--renderer", "torch", "--renderer-timeout", "9"), "--renderer-timeout does not go with"),
        (("--renderer-command", "true", "--renderer-timeout", "0"), "a renderer cannot have 0.0 seconds"),
        (("--renderer", "nowhere_at_all:make"), "cannot be imported"),
        (("--renderer", "torch", "--views", "1000000000"), "views is 1000000000: expected 1 to 4096"),
        (("--renderer", "torch", "--steps", "-1"), "steps is -1"),
        (("--renderer", "torch", "--start", "nothing"), "no method and no stack nothing"),
        (("--renderer", "torch", "--budget", "soon"), "budget is 'soon'"),
    ],
)
def test_what_cannot_be_is_said_in_one_sentence(folder, tmp_path, capsys, arguments, said):
    err = fails(capsys, 2, "fit", folder, "-o", tmp_path / "out", "--quiet", *QUICK, *AVERAGED, *arguments)
    assert said in err
    assert not (tmp_path / "out").exists() or not list(Path(tmp_path / "out").iterdir())
