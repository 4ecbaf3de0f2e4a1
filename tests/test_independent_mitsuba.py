"""The supersampled reference against Mitsuba 3: its rasterisation, texture filter, rough conductor and pixel filter.

Mitsuba's rough conductor masks separably (Walter et al. 2007), ours height-correlated: a twin that can do both says how
much of a difference that explains. Its reflectance is the same at every angle, where ours grows towards grazing ones
unless it is white; the twin knows that too.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from . import independent_scenes as scenes
from .mesh_renders import candidate, reference

pytestmark = pytest.mark.independent

FINER = 9  # odd, so that texels of the finer textures fall on texels of the coarser
LLVM = [Path(f"/usr/lib/{machine}-linux-gnu/libLLVM-19.so") for machine in ("x86_64", "aarch64")]


@pytest.fixture(scope="module")
def mitsuba() -> Any:
    """Mitsuba with its fastest variant. No LLVM but 19 is looked for: 15 and 16 abort the process on AVX-512."""
    module = pytest.importorskip("mitsuba", reason="mitsuba is not installed (the extra `checks`)")
    found = [path for path in LLVM if path.exists()]
    if found:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", str(found[0]))
    module.set_variant("llvm_ad_rgb" if "DRJIT_LIBLLVM_PATH" in os.environ else "scalar_rgb")
    return module


class Case(NamedTuple):
    model: str
    white: bool
    pixel_filter: str


CASES = [Case("gltf", True, "gaussian"), Case("gltf", False, "box"), Case("ggx", False, "box")]


def rendered(mi: Any, case: Case) -> np.ndarray:
    """(H, W, 3) of one render for each light and each lobe: a light at random would be noise."""
    texture = scenes.stored(case.model, case.white)
    height, width = texture.shape[:2]
    v, u = np.meshgrid(*((np.arange(FINER * n) + 0.5) / (FINER * n) for n in (height, width)), indexing="ij")
    # Bilinear patches are bilinear in the finer texture too; what is made of them there changes little between texels.
    fine = scenes.surface(case.model, scenes.bilinear(texture.astype(np.float64), np.stack([u, v], -1)))
    transform = mi.ScalarTransform4f()

    def bitmap(values: np.ndarray) -> dict[str, Any]:
        return {
            "type": "bitmap",
            "bitmap": mi.Bitmap(np.ascontiguousarray(values, np.float32)),  # the first row at v = 0
            "raw": True,
            "filter_type": "bilinear",
            "wrap_mode": "repeat",
            # The rectangle's v runs upwards, towards -z where it lies: a mesh's v downwards.
            "to_uv": transform.scale([scenes.REPEAT[0], -scenes.REPEAT[1], 1]),
        }

    lobes = [
        {
            "type": "roughconductor",
            "material": "none",
            "distribution": "ggx",
            "alpha_u": bitmap(fine.alpha_t),
            "alpha_v": bitmap(fine.alpha_b),
            "specular_reflectance": bitmap(fine.f0),
        }
    ]
    if fine.albedo.any():
        lobes.append({"type": "diffuse", "reflectance": bitmap(fine.albedo)})
    image = np.zeros((*scenes.RESOLUTION, 3))
    for index, (direction, irradiance) in enumerate(zip(scenes.LIGHTS, scenes.IRRADIANCE, strict=True)):
        for lobe in lobes:
            surface = {
                "type": "normalmap",
                "normalmap": bitmap((fine.normal + 1) / 2),
                "use_shadowing_function": False,
                "flip_invalid_normals": False,
                "bsdf": lobe,
            }
            scene = mi.load_dict(
                {
                    "type": "scene",
                    "integrator": {"type": "direct", "bsdf_samples": 0, "emitter_samples": 1},
                    "sensor": _sensor(mi, case.pixel_filter),
                    "plane": {
                        "type": "rectangle",
                        "to_world": transform.rotate([1, 0, 0], -90).scale(scenes.SIDE / 2),
                        "bsdf": surface,
                    },
                    "light": {
                        "type": "directional",
                        "direction": [float(-each) for each in direction],
                        "irradiance": {"type": "rgb", "value": [float(each) for each in irradiance]},
                    },
                }
            )
            image += np.array(mi.render(scene, seed=index))
    return image


def _sensor(mi: Any, pixel_filter: str) -> dict[str, Any]:
    height, width = scenes.RESOLUTION
    samples = 256 if mi.variant().startswith("scalar") else 1024
    return {
        "type": "perspective",
        "fov": scenes.FIELD_OF_VIEW,
        "fov_axis": "y",
        "to_world": mi.ScalarTransform4f().look_at(scenes.POSITION, scenes.TARGET, [0, 1, 0]),
        "sampler": {"type": "multijitter", "sample_count": samples},
        "film": {
            "type": "hdrfilm",
            "width": width,
            "height": height,
            "rfilter": {"type": "box"} if pixel_filter == "box" else {"type": "gaussian", "stddev": 0.5},
            "sample_border": True,
            "pixel_format": "rgb",
            "component_format": "float32",
        },
    }


@pytest.mark.parametrize("case", CASES, ids=str)
def test_mitsuba_and_the_reference_differ_by_masking_alone(mitsuba: Any, case: Case) -> None:
    """With LLVM's 1024 samples a pixel, twins agree to 47 dB and more, and masking explains all but -53 dB."""
    view, where = (scenes.PLANE, scenes.CAMERA, scenes.LIGHTING), (case.model, scenes.WRAP, scenes.RESOLUTION)
    material = scenes.stored(case.model, case.white)
    frame = candidate(*view, [material], *where)
    assert frame.coverage.all()
    made = reference(*view, material, *where, case.pixel_filter, 0, [frame], min_passes=1024, max_passes=1024)
    theirs, ours = rendered(mitsuba, case), made.image.astype(np.float64)
    twin, masked = scenes.twins(case.model, material, case.pixel_filter)
    assert scenes.decibels(twin, ours) > 43
    assert scenes.decibels(masked, theirs) > 40
    explained, direct = scenes.decibels(ours * masked / twin, theirs), scenes.decibels(ours, theirs)
    assert explained > 40 and direct > 35
    assert explained > direct + 3
    if case.white:  # nothing but masking: Schlick's reflectance is 1 at every angle
        assert 0.98 < theirs.sum() / ours.sum() < 1
        assert 0.94 < (theirs / ours).min() < 0.98 and (theirs / ours).max() < 1.03  # 0.96 to 1, and noise
