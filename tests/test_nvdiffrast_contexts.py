"""The contexts of `mipbake.nvdiffrast`: their devices, the manual mode, copies, and what they say in the log.

No graphics card is needed: torch's tensors without values stand for tensors of several cards.
"""

from __future__ import annotations

import copy
import logging
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import pytest
import torch
from torch import Tensor
from torch._subclasses.fake_tensor import FakeTensorMode

import mipbake.nvdiffrast as dr
from mipbake.base.errors import UsageError

POS = torch.tensor([[[-0.9, -0.9, 0, 1], [0.9, -0.9, 0, 1], [-0.9, 0.9, 0, 1]]])
TRI = torch.tensor([[0, 1, 2]], dtype=torch.int32)
RANGES = torch.tensor([[0, 1]], dtype=torch.int32)
SIZE = (6, 8)


@pytest.fixture(autouse=True)
def no_graphics_card(monkeypatch: pytest.MonkeyPatch) -> None:
    """Contexts without a device are for tensors on the processor, on machines that have a graphics card too."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


def set_manual() -> dr.RasterizeGLContext:
    context = dr.RasterizeGLContext(mode="manual")
    context.set_context()
    return context


def test_a_manual_context_is_set_in_one_thread() -> None:
    """Other threads can neither use it nor set it before it is released; a thread that has ended holds nothing."""
    context = set_manual()
    context.set_context()  # again
    told: list[str] = []

    def elsewhere(*calls: Callable[[], Any]) -> None:
        def work() -> None:
            for call in calls:
                try:
                    call()
                except UsageError as error:
                    told.append(str(error))

        thread = threading.Thread(target=work)
        thread.start()
        thread.join()

    def draw() -> None:
        dr.rasterize(context, POS, TRI, SIZE)

    elsewhere(draw, context.set_context, context.release_context)
    assert [sentence.split(":")[0] for sentence in told] == [
        "glctx is in manual mode and not set in this thread",
        "glctx is set in another thread",
    ]
    draw()
    with dr.DepthPeeler(context, POS, TRI, SIZE) as peeler:
        peeler.rasterize_next_layer()
        context.release_context()
        with pytest.raises(UsageError, match="not set in this thread"):
            peeler.rasterize_next_layer()
    told.clear()
    elsewhere(context.set_context, draw)  # ends without a release
    context.set_context()
    draw()
    assert not told


def test_copies() -> None:
    """A copy is a context of its own, not set anywhere."""
    for twin in (copy.deepcopy, lambda it: pickle.loads(pickle.dumps(it))):
        assert twin(dr.RasterizeCudaContext()).device == torch.device("cpu")
        copied = twin(dr.RasterizeGLContext(output_db=False))
        assert dr.rasterize(copied, POS, TRI, SIZE)[1].shape[-1] == 0
        with pytest.raises(UsageError, match="not set in this thread"):
            dr.rasterize(twin(set_manual()), POS, TRI, SIZE)


# ---- devices ----


@pytest.fixture
def two_cards(monkeypatch: pytest.MonkeyPatch) -> None:
    """What torch says where there are two graphics cards, the second of them the current one."""
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(torch.cuda, "device_count", lambda: 2)
    monkeypatch.setattr(torch.cuda, "current_device", lambda: 1)
    ones = torch.ones(1)
    monkeypatch.setattr(torch, "ones", lambda *size, device: ones)  # what tries a card


@pytest.mark.parametrize("kind", [dr.RasterizeCudaContext, dr.RasterizeGLContext])
def test_devices_of_contexts(kind: Any, two_cards: None) -> None:
    given = [None, "cuda", 0, 1, "cuda:0", torch.device("cuda:1"), torch.device("cuda"), "cpu", torch.device("cpu")]
    cards = [1, 1, 0, 1, 0, 1, 1, None, None]
    for device, index in zip(given, cards, strict=True):
        want = torch.device("cpu") if index is None else torch.device("cuda", index)
        assert kind(device=device).device == want
    with pytest.raises(UsageError, match="there is no device cuda:2: expected cuda:0 to cuda:1"):
        kind(device=2)
    with pytest.raises(
        UsageError, match=rf"pos is on cpu: expected cuda:0, where glctx is; {kind.__name__}\(device='cpu'\)"
    ):
        dr.rasterize(kind(device=0), POS, TRI, SIZE)
    with pytest.raises(UsageError, match="pos is on cpu: expected cuda:0"):
        dr.rasterize(kind(device=0), POS.numpy(), TRI.numpy(), SIZE)


def test_tensors_of_another_device_than_the_context() -> None:
    meta = POS.to("meta")
    with pytest.raises(UsageError, match="pos is on meta: expected cpu, where glctx is"):
        dr.rasterize(dr.RasterizeCudaContext(device="cpu"), meta, TRI, SIZE)
    with pytest.raises(UsageError, match="pos is on meta: expected cpu, where glctx is"):
        dr.DepthPeeler(dr.RasterizeGLContext(device="cpu"), meta, TRI, SIZE)


@pytest.mark.skipif(torch.cuda.is_available(), reason="two graphics cards are pretended, and there is a real one")
def test_results_lie_where_the_arguments_do(two_cards: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """On two pretended graphics cards, by torch's tensors without values, and nothing mixes the cards."""
    contexts = [dr.RasterizeCudaContext(0), dr.RasterizeGLContext(device=1)]
    monkeypatch.undo()

    def on(card: int, *shape: int, dtype: torch.dtype = torch.float32) -> Tensor:
        return torch.empty(shape, dtype=dtype, device=f"cuda:{card}")

    def mesh(card: int) -> tuple[Tensor, Tensor]:
        return on(card, 1, 6, 4), on(card, 2, 3, dtype=torch.int32)

    with FakeTensorMode():
        for card, context in enumerate(contexts):
            (pos, tri), device = mesh(card), torch.device("cuda", card)
            rast, rast_db = dr.rasterize(context, pos, tri, SIZE)
            with dr.DepthPeeler(context, pos, tri, SIZE) as peeler:
                layer, _ = peeler.rasterize_next_layer()
            uv, uv_da = dr.interpolate(on(card, 1, 6, 2), rast, tri, rast_db, "all")
            color = dr.texture(on(card, 1, 8, 8, 3), uv, uv_da)
            image = dr.antialias(color, rast, pos, tri, dr.antialias_construct_topology_hash(tri))
            assert {each.device for each in (rast, rast_db, layer, uv, uv_da, color, image)} == {device}
            other = 1 - card
            with pytest.raises(UsageError, match=f"pos is on cuda:{other}: expected cuda:{card}, where glctx is"):
                dr.rasterize(context, *mesh(other), SIZE)
            with pytest.raises(UsageError, match=f"tri is on cuda:{other}: expected cuda:{card}, where pos is"):
                dr.rasterize(context, pos, mesh(other)[1], SIZE)
            with pytest.raises(UsageError, match=f"rast is on cuda:{card}: expected cuda:{other}, where attr is"):
                dr.interpolate(on(other, 1, 6, 2), rast, mesh(other)[1])
            with pytest.raises(UsageError, match=f"uv is on cuda:{card}: expected cuda:{other}, where tex is"):
                dr.texture(on(other, 1, 8, 8, 3), uv)
            with pytest.raises(UsageError, match=f"color is on cuda:{other}: expected cuda:{card}"):
                dr.antialias(on(other, 1, *SIZE, 3), rast, pos, tri)


def test_ranges_lie_on_the_processor() -> None:
    with pytest.raises(UsageError, match="ranges is on meta: expected the CPU"):
        dr.rasterize(dr.RasterizeCudaContext(), POS[0], TRI, SIZE, ranges=RANGES.to("meta"))


# ---- the log ----


@pytest.fixture
def log_level() -> Iterator[None]:
    """Brings the level back."""
    before = dr.get_log_level()
    yield
    dr.set_log_level(before)


def test_log_levels(log_level: None) -> None:
    """Each shows messages of its severity and of higher ones; levels of `logging` are understood."""
    logger = logging.getLogger("mipbake.nvdiffrast")
    severities = logging.INFO, logging.WARNING, logging.ERROR, logging.CRITICAL
    for level, severity in enumerate(severities):
        dr.set_log_level(level)
        assert dr.get_log_level() == level
        assert [logger.isEnabledFor(each) for each in severities] == [each >= severity for each in severities]
    for severity, level in ((logging.DEBUG, 0), (logging.WARNING + 5, 2), (logging.CRITICAL + 5, 3)):
        logger.setLevel(severity)
        assert dr.get_log_level() == level


def test_handlers_of_the_program_get_the_messages(
    log_level: None, caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str]
) -> None:
    dr.set_log_level(0)
    dr.RasterizeGLContext(device="cpu")
    assert [(each.levelname, each.getMessage()) for each in caplog.records] == [
        ("INFO", "RasterizeGLContext rasterises on cpu, without OpenGL")
    ]
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
        ("assert dr.get_log_level() == 1; dr.RasterizeCudaContext(device='cpu')", []),  # it was asked for
        ("dr.set_log_level(2); dr.RasterizeCudaContext(); dr.set_log_level(1); dr.RasterizeGLContext()", [WARNING]),
    ],
)
def test_the_processor_is_told_of_once(program: str, said: list[str]) -> None:
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
    assert run.stderr.splitlines()[-1] == (
        "mipbake.base.errors.UsageError: RasterizeGLContext needs torch, which mipbake's extra `train` brings: "
        'python -m pip install "mipbake[train]"'
    )
