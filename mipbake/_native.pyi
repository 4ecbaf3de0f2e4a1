"""The native core (csrc/bind). Arguments are checked by the modules that call it; see csrc/ops for the kernels."""

from collections.abc import Sequence
from typing import Any

# Arrays: NumPy arrays or torch tensors, exchanged without a copy.
Array = Any

def isa() -> str: ...
def num_threads() -> int: ...
def set_num_threads(count: int) -> None: ...
def cuda_compiled() -> bool: ...
def cuda_available() -> bool: ...
def models() -> list[tuple[str, int]]: ...
def shade(
    model: str, material: Array, light: Array, view: Array, radiance: Array, stream: int = 0, black: bool = False
) -> None: ...
def shade_lit(
    model: str,
    material: Array,
    frame: Array,
    view: Array,
    light: Array,
    radiance: Array,
    out: Array,
    black: bool = False,
) -> None: ...
def shade_backward(
    model: str,
    material: Array,
    light: Array,
    view: Array,
    grad_radiance: Array,
    grad_material: Array,
    stream: int = 0,
    duals: bool = False,
    black: bool = False,
) -> None: ...
def shade_directions_backward(
    model: str,
    material: Array,
    light: Array,
    view: Array,
    grad_radiance: Array,
    grad_light: Array,
    grad_view: Array,
    stream: int = 0,
    black: bool = False,
) -> None: ...
def texture(
    levels: Sequence[Array],
    uv: Array,
    uv_da: Array | None,
    bias: Array | None,
    filter: str,
    boundary_u: str,
    boundary_v: str,
    out: Array,
    stream: int = 0,
) -> None: ...
def texture_backward(
    grad: Array,
    levels: Sequence[Array],
    uv: Array,
    uv_da: Array | None,
    bias: Array | None,
    filter: str,
    boundary_u: str,
    boundary_v: str,
    level_grads: Sequence[Array],
    uv_grad: Array | None,
    uv_da_grad: Array | None,
    bias_grad: Array | None,
    stream: int = 0,
) -> None: ...
def texture_taps(
    height: int, width: int, uv: Array, boundary_u: str, boundary_v: str, texels: Array, fractions: Array
) -> None: ...
def texture_quads(values: Array, texels: Array, fractions: Array, out: Array) -> None: ...
def texture_mip(level: Array, out: Array, stream: int = 0) -> None: ...
def texture_mip_backward(grad_out: Array, grad: Array, stream: int = 0) -> None: ...
def check_mesh(pos: Array | None, tri: Array | None, vertices: int, ranges: Array | None) -> None: ...
def raster_scratch() -> int: ...
def raster_scratch_free(handle: int) -> None: ...
def rasterize_workspace(batch: int, triangles: int, height: int, width: int) -> int: ...
def rasterize(
    pos: Array,
    tri: Array,
    ranges: Array | None,
    previous: Array | None,
    rast: Array,
    rast_db: Array | None,
    scratch: int = 0,
    workspace: Array | None = None,
    stream: int = 0,
) -> None: ...
def rasterize_backward(
    pos: Array, tri: Array, rast: Array, grad_rast: Array, grad_db: Array | None, grad_pos: Array, stream: int = 0
) -> None: ...
def splats(order: Array, centers: Array, conics: Array, paint: Array, image: Array, shown: Array) -> None: ...
def interpolate(
    attr: Array,
    rast: Array,
    tri: Array,
    rast_db: Array | None,
    diff_attrs: Sequence[int],
    out: Array,
    out_da: Array | None,
    stream: int = 0,
) -> None: ...
def interpolate_backward(
    attr: Array,
    rast: Array,
    tri: Array,
    rast_db: Array | None,
    diff_attrs: Sequence[int],
    grad_out: Array,
    grad_da: Array | None,
    grad_attr: Array | None,
    grad_rast: Array | None,
    grad_db: Array | None,
    stream: int = 0,
) -> None: ...
def antialias_topology(tri: Array, vertices: int, next: Array) -> None: ...
def antialias(
    color: Array,
    rast: Array,
    pos: Array,
    tri: Array,
    next: Array,
    out: Array,
    workspace: Array | None = None,
    stream: int = 0,
) -> None: ...
def antialias_backward(
    color: Array,
    rast: Array,
    pos: Array,
    tri: Array,
    next: Array,
    grad: Array,
    boost: float,
    grad_color: Array | None,
    grad_pos: Array | None,
    workspace: Array | None = None,
    stream: int = 0,
) -> None: ...
def encode_blocks(format: str, values: Array, weights: Array | None, blocks: Array) -> None: ...
def decode_blocks(format: str, blocks: Array, values: Array) -> None: ...
def resample(
    image: Array, row_index: Array, row_weights: Array, column_index: Array, column_weights: Array, out: Array
) -> None: ...
def network_counts(kind: str, read: int, made: int) -> tuple[int, int, int, int, int, int, int]: ...

class Network:
    def __init__(
        self,
        kind: str,
        read: int,
        made: int,
        limits: Sequence[float],
        whiten: tuple[Array, Array] | None,
        encoder: Sequence[tuple[Array, Array]],
        project: tuple[Array, Array],
        decoder: Sequence[tuple[Array, Array]],
    ) -> None: ...

class NetworkBake:
    def __init__(
        self,
        network: Network,
        stored: Array,
        wrap_rows: bool,
        wrap_columns: bool,
        sharp: Array,
        plain: Array,
        bias: Array,
        top: Array,
        sinks: Sequence[object],
    ) -> None: ...
    def advance(self) -> int: ...
    def run_on_card(self, device: int) -> None: ...

def pages_supported() -> bool: ...
def resident_bytes() -> int: ...

class Pages:
    """See csrc/core/pages.h."""

    def __init__(self, most: int) -> None: ...
    def map(self, file: int, size: int) -> Any: ...
    def release(self) -> None: ...

def stochastic_perturb(
    values: Array,
    elements: Array | None,
    magnitude: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
    lifted: int,
    step: int,
    seed: int,
    plus: Array,
    minus: Array,
    stream: int = 0,
) -> None: ...
def stochastic_differences(
    plus: Array, minus: Array, reference: Array, weights: Array | None, out: Array, stream: int = 0
) -> None: ...
def stochastic_gradient(
    differences: Array,
    elements: Array,
    starts: Array,
    pixels: Array,
    magnitude: Sequence[float],
    step: int,
    seed: int,
    gradient: Array,
    stream: int = 0,
) -> None: ...
def stochastic_adam(
    values: Array,
    gradient: Array,
    first: Array,
    second: Array,
    steps: Array,
    elements: Array | None,
    rate: Sequence[float],
    low: Sequence[float],
    high: Sequence[float],
    lifted: int,
    beta1: float,
    beta2: float,
    epsilon: float,
    stream: int = 0,
) -> None: ...
def stochastic_count(touched: Array, counts: Array) -> None: ...
def stochastic_fill(touched: Array, cursors: Array, pixels: Array) -> None: ...
def stochastic_touched(
    sizes: Sequence[tuple[int, int]],
    uv: Array,
    lod: Array | None,
    uv_da: Array | None,
    seen: Array | None,
    filter: str,
    boundary_u: str,
    boundary_v: str,
    texels: Array,
    stream: int = 0,
) -> None: ...
