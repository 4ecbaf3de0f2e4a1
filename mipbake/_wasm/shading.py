"""Shading in the core as WebAssembly."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from mipbake._wasm.given import checked, filled, number_of, real_dtype
from mipbake._wasm.machine import Machine, Strided, run


@cache
def _models() -> dict[str, int]:
    machine = Machine()
    names = [machine.text(machine.call("model_name", index)) for index in range(machine.call("model_count"))]
    return {name: machine.call("model_channels", index) for index, name in enumerate(names)}


def models() -> list[tuple[str, int]]:
    return list(_models().items())


def shade(
    model: str, material: Any, light: Any, view: Any, radiance: Any, stream: int = 0, black: bool = False
) -> None:
    del stream
    words, kind, (B, K, N, _) = _shading(model, material, light, view, black)
    run("shade", words, filled("radiance", radiance, kind, (B, K, N, 3)))


def shade_backward(
    model: str,
    material: Any,
    light: Any,
    view: Any,
    grad_radiance: Any,
    grad_material: Any,
    stream: int = 0,
    duals: bool = False,
    black: bool = False,
) -> None:
    del stream
    words, kind, (B, K, N, C) = _shading(model, material, light, view, black)
    if duals and np.ndim(light) != 3:
        raise ValueError("duals are for the CPU and for shared directions")
    grad = checked("grad_radiance", grad_radiance, kind, (B, K, N, 3))
    run("shade_backward", words, grad, filled("grad_material", grad_material, kind, (B, N, C)), duals)


def shade_directions_backward(
    model: str,
    material: Any,
    light: Any,
    view: Any,
    grad_radiance: Any,
    grad_light: Any,
    grad_view: Any,
    stream: int = 0,
    black: bool = False,
) -> None:
    del stream
    words, kind, (B, K, N, _) = _shading(model, material, light, view, black)
    grad = checked("grad_radiance", grad_radiance, kind, (B, K, N, 3))
    made = [
        filled(name, value, kind, (B, K, N, 3))
        for name, value in (("grad_light", grad_light), ("grad_view", grad_view))
    ]
    run("shade_directions_backward", words, grad, made)


def _shading(
    model: str, material: Any, light: Any, view: Any, black: bool
) -> tuple[list[Any], np.dtype[Any], tuple[int, int, int, int]]:
    """Words of ShadeArgs, the dtype, and B, K, N and C."""
    index, kind, C = number_of("model", model, list(_models())), real_dtype(material), _models()[model]
    (B, N), K = np.shape(material)[:2], np.shape(light)[1]
    shape = (B, K, 3) if np.ndim(light) == 3 else (B, K, N, 3)
    places: list[Any] = [Strided(checked("material", material, kind, (B, N, C)), 3)]
    for name, value in (("light", light), ("view", view)):
        vectors = checked(name, value, kind, shape)
        places.append(Strided(vectors[:, :, None] if vectors.ndim == 3 else vectors, 4))
    return [index, kind == np.float64, B, K, N, *places, black], kind, (B, K, N, C)


def shade_lit(
    model: str,
    material: Any,
    frame: Any,
    view: Any,
    light: Any,
    radiance: Any,
    out: Any,
    black: bool = False,
) -> None:
    index, kind, C = number_of("model", model, list(_models())), real_dtype(material), _models()[model]
    (B, N), K = np.shape(material)[:2], np.shape(light)[1]
    run(
        "shade_lit",
        [index, kind == np.float64, B, N, K],
        Strided(checked("material", material, kind, (B, N, C)), 3),
        Strided(checked("frame", frame, kind, (B, N, 3, 3)), 4),
        Strided(checked("view", view, kind, (B, N, 3)), 3),
        [checked(name, value, kind, (B, K, 3)) for name, value in (("light", light), ("radiance", radiance))],
        [black, filled("out", out, kind, (B, N, 3))],
    )
