"""`mipbake.nvdiffrast` against nvdiffrast's documentation: names, arguments, results, contexts, log, and its samples.

No graphics card is needed: what torch says of cards is replaced where there are to be some.
"""

from __future__ import annotations

import copy
import functools
import inspect
import logging
import pickle
import re
import runpy
import shutil
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

import mipbake.nvdiffrast as dr
from mipbake import raster, sampling
from mipbake.base.errors import UsageError

from .example_scripts import EXAMPLES, scripts

DOCUMENTED = {
    "RasterizeCudaContext": "device=None",
    "RasterizeGLContext": "output_db=True, mode='automatic', device=None",
    "rasterize": "glctx, pos, tri, resolution, ranges=None, grad_db=True",
    "DepthPeeler": "glctx, pos, tri, resolution, ranges=None, grad_db=True",
    "interpolate": "attr, rast, tri, rast_db=None, diff_attrs=None",
    "texture": "tex, uv, uv_da=None, mip_level_bias=None, mip=None, filter_mode='auto', boundary_mode='wrap', "
    "max_mip_level=None",
    "texture_construct_mip": "tex, max_mip_level=None, cube_mode=False",
    "antialias": "color, rast, pos, tri, topology_hash=None, pos_gradient_boost=1.0",
    "antialias_construct_topology_hash": "tri",
    "get_log_level": "",
    "set_log_level": "level",
}
"""Signatures of the chapter "PyTorch API reference"; DepthPeeler has the arguments of rasterize."""

POS = torch.tensor(
    [
        *([-0.9, -0.9, 0, 1], [0.9, -0.9, 0, 1], [-0.9, 0.9, 0, 1]),
        *([-0.7, -0.9, 0.5, 1], [0.9, -0.9, 0.5, 1], [0.9, 0.9, 0.5, 1]),
    ]
)
TRI = torch.tensor([[0, 1, 2], [3, 4, 5]], dtype=torch.int32)
RANGES = torch.tensor([[0, 2], [1, 1], [0, 0]], dtype=torch.int32)
SIZE = (6, 8)


@pytest.fixture(autouse=True)
def no_graphics_card(monkeypatch: pytest.MonkeyPatch) -> None:
    """Contexts without a device are for tensors on the processor, on machines that have a graphics card too."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def test_contexts_of_opengl_are_contexts() -> None:
    assert isinstance(dr.RasterizeGLContext(), dr.RasterizeCudaContext)


def manual() -> dr.RasterizeGLContext:
    context = dr.RasterizeGLContext(mode="manual")
    context.set_context()
    return context


CONTEXTS: dict[str, Callable[[], Any]] = {
    "cuda": dr.RasterizeCudaContext,
    "gl": dr.RasterizeGLContext,
    "gl without derivatives": lambda: dr.RasterizeGLContext(output_db=False),
    "manual": manual,
}


def test_names_and_signatures_are_the_documented_ones() -> None:
    assert set(dr.__all__) == set(DOCUMENTED)
    for name, expected in DOCUMENTED.items():
        found = inspect.signature(getattr(dr, name)).parameters.values()
        assert ", ".join(str(each.replace(annotation=inspect.Parameter.empty)) for each in found) == expected
        if name.startswith(("antialias", "texture")):
            assert getattr(dr, name) is getattr(raster, name, None) or getattr(dr, name) is getattr(sampling, name)


# ---- shapes and meanings of results ----


@pytest.mark.parametrize("batch", [None, 3])
@pytest.mark.parametrize("kind", CONTEXTS)
def test_rasterize(kind: str, batch: int | None) -> None:
    """Every context gives the results of `mipbake.raster`; both modes of geometry, by name and by place."""
    context = CONTEXTS[kind]()
    pos = POS if batch is None else POS.repeat(batch, 1, 1)
    ranges = RANGES if batch is None else None
    want, want_db = raster.rasterize(None, pos, TRI, SIZE, ranges)
    rast, rast_db = dr.rasterize(glctx=context, pos=pos, tri=TRI, resolution=SIZE, ranges=ranges, grad_db=True)
    assert torch.equal(rast, want) and rast.shape == (batch or 3, *SIZE, 4)
    if kind == "gl without derivatives":
        want_db = want_db.new_empty((*want.shape[:3], 0))
    assert torch.equal(rast_db, want_db)
    for resolution in (list(SIZE), np.array(SIZE), torch.tensor(SIZE)):
        again = dr.rasterize(context, pos, TRI, resolution, ranges)
        assert torch.equal(again[0], rast) and torch.equal(again[1], rast_db)


@pytest.mark.parametrize("grad_db", [True, False])
@pytest.mark.parametrize("kind", CONTEXTS)
def test_gradients_of_derivatives(kind: str, grad_db: bool) -> None:
    """They are 0 on request, and where the context does not output derivatives."""
    pos = POS[None].clone().requires_grad_()
    _, rast_db = dr.rasterize(CONTEXTS[kind](), pos, TRI, SIZE, grad_db=grad_db)
    (gradient,) = torch.autograd.grad(rast_db.sum(), pos)
    assert gradient.any() == (grad_db and kind != "gl without derivatives")


@pytest.mark.parametrize("kind", CONTEXTS)
def test_depth_peeler(kind: str) -> None:
    """The first layer is what `rasterize` gives, the second lies behind it, and the third is empty."""
    context = CONTEXTS[kind]()
    with dr.DepthPeeler(context, POS[None], TRI, resolution=SIZE) as peeler:
        layers = [peeler.rasterize_next_layer() for _ in range(3)]
        inside = dr.rasterize(context, POS[None], TRI, SIZE)  # the context is not reserved
    for got, want in zip(layers[0], inside, strict=True):
        assert torch.equal(got, want)
    ids = [sorted(layer[..., 3].unique().tolist()) for layer, _ in layers]
    assert ids == [[0, 1, 2], [0, 2], [0]]
    assert all(db.shape == (1, *SIZE, 0 if kind == "gl without derivatives" else 4) for _, db in layers)


def test_a_context_without_derivatives_serves_interpolation_without_them() -> None:
    rast, rast_db = dr.rasterize(dr.RasterizeGLContext(output_db=False), POS[None], TRI, SIZE)
    assert dr.interpolate(POS, rast, TRI, rast_db)[1].shape == (1, *SIZE, 0)
    with pytest.raises(UsageError, match=r"rast_db has shape \(1, 6, 8, 0\) and diff_attrs is .all.: expected"):
        dr.interpolate(POS, rast, TRI, rast_db, diff_attrs="all")


def test_compiled_equals_eager() -> None:
    contexts = [dr.RasterizeCudaContext(), dr.RasterizeGLContext(output_db=False)]

    def both(pos: Tensor) -> Tensor:
        color, _ = dr.interpolate(pos, dr.rasterize(contexts[0], pos, TRI, SIZE)[0], TRI)
        with dr.DepthPeeler(contexts[1], pos, TRI, SIZE) as peeler:
            behind, _ = peeler.rasterize_next_layer()
        return color + behind

    assert torch.equal(torch.compile(both, fullgraph=True, backend="aot_eager")(POS[None]), both(POS[None]))


# ---- what is refused ----

WRONG: dict[str, Callable[[], Any]] = {
    "glctx is a NoneType: expected a": lambda: dr.rasterize(None, POS[None], TRI, SIZE),
    "glctx is a Tensor: expected": lambda: dr.DepthPeeler(POS, TRI, SIZE, None),
    "mode is 'auto': expected 'automatic' or 'manual'": lambda: dr.RasterizeGLContext(mode="auto"),
    "output_db is 1: expected True or False": lambda: dr.RasterizeGLContext(output_db=1),
    "unknown device 'tpu': expected cpu, cuda, or cuda:1": lambda: dr.RasterizeCudaContext("tpu"),
    "device is 1.5: expected a torch.device, a name": lambda: dr.RasterizeGLContext(device=1.5),
    "set_context was called on a context in automatic mode": lambda: dr.RasterizeGLContext().set_context(),
    "release_context was called on a context in auto": lambda: dr.RasterizeGLContext().release_context(),
    "glctx is in manual mode and not set in this thread: expected a call of set_context() before": lambda: dr.rasterize(
        dr.RasterizeGLContext(mode="manual"), POS[None], TRI, SIZE
    ),
    "resolution is tensor([4]): expected (height, width)": lambda: dr.rasterize(
        dr.RasterizeCudaContext(), POS[None], TRI, torch.tensor([4])
    ),
    "pos is on meta: expected cpu, where glctx is": lambda: dr.rasterize(
        dr.RasterizeCudaContext(device="cpu"), POS.to("meta"), TRI, SIZE
    ),
    "level is 4: expected 0 (info), 1 (warning), 2 (error) or 3 (fatal)": lambda: dr.set_log_level(4),
    "level is 'info': expected 0 (info)": lambda: dr.set_log_level("info"),
}


@pytest.mark.parametrize("sentence", WRONG)
def test_wrong_use(sentence: str) -> None:
    with pytest.raises(UsageError, match=re.escape(sentence.replace("tensor([4])", "(tensor(4),)"))):
        WRONG[sentence]()


# ---- contexts ----


def test_a_manual_context_is_set_in_one_thread() -> None:
    """Other threads can neither use it nor set it before it is released; a thread that has ended holds nothing."""
    context = manual()
    context.set_context()  # again
    refused: list[str] = []

    def elsewhere(*calls: Callable[[], Any]) -> None:
        def work() -> None:
            for call in calls:
                try:
                    call()
                except UsageError as error:
                    refused.append(str(error))

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()

    def draw() -> None:
        dr.rasterize(context, POS[None], TRI, SIZE)

    elsewhere(draw, context.set_context, context.release_context)
    assert [sentence.split(":")[0] for sentence in refused] == [
        "glctx is in manual mode and not set in this thread",
        "glctx is set in another thread",
    ]
    with dr.DepthPeeler(context, POS[None], TRI, SIZE) as peeler:
        peeler.rasterize_next_layer()
        context.release_context()
        with pytest.raises(UsageError, match="not set in this thread"):
            peeler.rasterize_next_layer()
    refused.clear()
    elsewhere(context.set_context, draw)  # ends without a release
    context.set_context()
    draw()
    assert not refused


def test_copies() -> None:
    """A copy is a context of its own, not set anywhere."""
    for twin in (copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))):
        assert twin(dr.RasterizeCudaContext()).device == torch.device("cpu")
        copied = twin(dr.RasterizeGLContext(output_db=False))
        assert dr.rasterize(copied, POS[None], TRI, SIZE)[1].shape[-1] == 0
        with pytest.raises(UsageError, match="not set in this thread"):
            dr.rasterize(twin(manual()), POS[None], TRI, SIZE)


@pytest.mark.parametrize("kind", [dr.RasterizeCudaContext, dr.RasterizeGLContext])
def test_devices_of_contexts(kind: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where there are two graphics cards, the second of them the current one."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)
    ones = torch.ones(1)
    monkeypatch.setattr(torch, "ones", lambda *size, device: ones)  # what tries a card
    given = [None, "cuda", 0, 1, "cuda:0", torch.device("cuda:1"), torch.device("cuda"), "cpu", torch.device("cpu")]
    cards = [1, 1, 0, 1, 0, 1, 1, None, None]
    for device, index in zip(given, cards, strict=True):
        want = torch.device("cpu") if index is None else torch.device("cuda", index)
        assert kind(device=device).device == want
    with pytest.raises(UsageError, match="there is no device cuda:2: expected cuda:0 to cuda:1"):
        kind(device=2)
    sentence = rf"pos is on cpu: expected cuda:0, where glctx is; {kind.__name__}\(device='cpu'\)"
    for pos, tri in ((POS, TRI), (POS.numpy(), TRI.numpy())):
        with pytest.raises(UsageError, match=sentence):
            dr.rasterize(kind(device=0), pos, tri, SIZE)


# ---- the log ----


@pytest.fixture
def log_level() -> Iterator[None]:
    """Brings the level back."""
    before = dr.get_log_level()
    yield
    dr.set_log_level(before)


def test_log_levels(log_level: None, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]) -> None:
    """Each shows messages of its severity and of higher ones; handlers of the program get the messages."""
    logger = logging.getLogger("mipbake.nvdiffrast")
    severities = logging.INFO, logging.WARNING, logging.ERROR, logging.CRITICAL
    for level, severity in enumerate(severities):
        dr.set_log_level(level)
        assert dr.get_log_level() == level
        assert [logger.isEnabledFor(each) for each in severities] == [each >= severity for each in severities]
    for severity, level in ((logging.DEBUG, 0), (logging.WARNING + 5, 2), (logging.CRITICAL + 5, 3)):
        logger.setLevel(severity)
        assert dr.get_log_level() == level
    dr.set_log_level(0)
    dr.RasterizeGLContext(device="cpu")
    assert [each.getMessage() for each in caplog.records] == ["RasterizeGLContext rasterises on cpu, without OpenGL"]
    assert capsys.readouterr().err == ""


WARNING = "mipbake.nvdiffrast: warning: torch finds no graphics card, so RasterizeGLContext rasterises on the processor"
INFO = "mipbake.nvdiffrast: info: RasterizeCudaContext rasterises on cpu, without OpenGL"


@pytest.mark.long
@pytest.mark.parametrize(
    ("program", "said"),
    [
        (
            "dr.RasterizeGLContext(); dr.RasterizeCudaContext(); dr.RasterizeGLContext()\n"
            "dr.set_log_level(0); dr.RasterizeCudaContext()",
            [WARNING, INFO],
        ),
        ("dr.set_log_level(2); dr.RasterizeCudaContext(); dr.set_log_level(1); dr.RasterizeGLContext()", [WARNING]),
    ],
)
def test_the_processor_is_named_once(program: str, said: list[str]) -> None:
    """In a process where torch has CUDA and finds no card."""
    start = "import torch, mipbake.nvdiffrast as dr; torch.cuda.is_available = lambda: False; torch.version.cuda = '12'"
    run = subprocess.run([sys.executable, "-c", f"{start}\n{program}"], capture_output=True, text=True, check=True)
    lines = run.stderr.splitlines()
    assert len(lines) == len(said) and all(map(str.startswith, lines, said)), run.stderr
    assert run.stdout == ""


def test_the_module_loads_without_torch() -> None:
    """A context needs it, and says what to type where it is not installed."""
    script = "import sys; sys.modules['torch'] = None; import mipbake.nvdiffrast as dr; dr.RasterizeGLContext()"
    run = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=False)
    assert run.stderr.splitlines()[-1].startswith("mipbake.base.errors.UsageError: RasterizeGLContext needs torch")


# ---- samples of the documentation, as programs for nvdiffrast ----

FITTING = EXAMPLES / "fitting"
OURS, THEIRS = "import mipbake.nvdiffrast as dr", "import nvdiffrast.torch as dr"
SMALL = {
    "triangle": ["--cuda"],
    "capture": ["--frames", "2", "--cameras", "2", "--resolution", "24", "--texture-size", "8", "--iterations", "4"],
    "cube": ["--resolutions", "8", "--runs", "2", "--iterations", "4"],
    "earth": ["--texture-size", "8", "--resolution", "16", "--supersampling", "2", "--iterations", "4"],
    "envphong": ["--texture-size", "8", "--resolution", "24", "--iterations", "4"],
    "pose": ["--trials", "2", "--resolution", "16", "--iterations", "4"],
    "minimal": [],
}
"""The samples, and arguments with which they take no time."""

HELPERS = sorted(path.stem for path in FITTING.glob("*.py") if path.stem not in (*SMALL, "several"))
"""What the samples share. `several.py` is run by torchrun, in tests of the examples."""

FILTERS = "auto", "nearest", "linear", "linear-mipmap-nearest", "linear-mipmap-linear"


def check_documented(name: str, given: Mapping[str, Any]) -> None:
    """What nvdiffrast's documentation restricts: contiguous tensors of its types, sizes that halve, equal batches."""
    tensors = {key: value for key, value in given.items() if isinstance(value, Tensor)}
    for key, tensor in tensors.items():
        assert tensor.is_contiguous(), f"{key} is not contiguous"
        assert tensor.dtype == (torch.int32 if key in ("tri", "ranges") else torch.float32), f"{key} is {tensor.dtype}"
    if name in ("rasterize", "DepthPeeler"):
        assert type(given["glctx"]) in (dr.RasterizeCudaContext, dr.RasterizeGLContext)
        assert all(isinstance(side, int) for side in given["resolution"])
        assert given["pos"].ndim == 3 or given["ranges"] is not None
    if name == "texture":
        assert given["filter_mode"] in FILTERS and given["boundary_mode"] in ("wrap", "clamp", "zero", "cube")
        assert given["tex"].shape[0] in (1, given["uv"].shape[0])
        with_levels = "mipmap" in given["filter_mode"] or (given["uv_da"], given["mip_level_bias"]) != (None, None)
    if name == "texture_construct_mip" or (name == "texture" and given["mip"] is None and with_levels):
        height, width = given["tex"].shape[-3:-1]
        assert height & (height - 1) == width & (width - 1) == 0 or given["max_mip_level"] is not None


def as_documented() -> ModuleType:
    """`nvdiffrast.torch` as its documentation describes it: the restrictions are checked, and mipbake computes."""
    module = ModuleType("nvdiffrast.torch")
    for name in dr.__all__:
        function = getattr(dr, name)

        @functools.wraps(function)
        def call(*args: Any, _name: str = name, _function: Any = function, **kwargs: Any) -> Any:
            bound = inspect.signature(_function).bind(*args, **kwargs)
            bound.apply_defaults()
            check_documented(_name, bound.arguments)
            return _function(*args, **kwargs)

        setattr(module, name, function if name.endswith("Context") else call)
    return module


@pytest.mark.parametrize("name", SMALL)
def test_samples_run_where_one_line_is_nvdiffrasts(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """On a stand-in that has what nvdiffrast documents, and refuses what its documentation does not allow."""
    text = (FITTING / f"{name}.py").read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if "mipbake" in line] == [OURS]
    monkeypatch.chdir(tmp_path)
    for helper in HELPERS:
        shutil.copy(FITTING / f"{helper}.py", tmp_path)
        assert "mipbake" not in (tmp_path / f"{helper}.py").read_text(encoding="utf-8")
    few = text.replace(OURS, THEIRS).replace("range(200)", "range(4)")  # the iterations of minimal.py
    (tmp_path / f"{name}.py").write_text(few, encoding="utf-8")
    package = ModuleType("nvdiffrast")
    package.torch = as_documented()
    monkeypatch.setitem(sys.modules, "nvdiffrast", package)
    monkeypatch.setitem(sys.modules, "nvdiffrast.torch", package.torch)
    with scripts(tmp_path) as load:
        if name == "minimal":
            runpy.run_path("minimal.py", run_name="__main__")
        else:
            load(name).main(SMALL[name])
