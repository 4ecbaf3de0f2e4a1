"""Material models: their descriptions, and the conversions between them.

A texel of a model is a vector of *stored channels*: what an engine samples, bilinearly and trilinearly, before it
shades. Arrays are `(..., C)` of float32 or float64; every function is pure and keeps dtype and leading shape.

| model | channels |
|---|---|
| `gltf` | base colour r, g, b (linear Rec.709); metallic; perceptual roughness; normal x, y, z |
| `gltf-anisotropic` | the channels of `gltf`; anisotropy direction x, y; anisotropy strength |
| `ggx` | diffuse albedo r, g, b; specular F0 r, g, b; normal x, y; log-roughness tensor a, b, c |
| `beckmann` | the channels of `ggx`; g = ln(gamma) |

`model.py` says what a description holds, and `kinds.py` what a channel can be. Each model has a file of its own,
which two models may share where they share formulas; `models.py` lists them.
"""

from mipbake.material.beckmann import beckmann_to_ggx, ggx_to_beckmann
from mipbake.material.gltf import (
    DIELECTRIC_F0,
    base_and_metallic,
    gltf_to_ggx,
)
from mipbake.material.kinds import (
    COLOUR,
    FACTS,
    LEAST_STRENGTH,
    LOG,
    MAX_LOG_ALPHA2,
    MAX_LOG_GAMMA,
    MIN_HEIGHT,
    MIN_LOG_ALPHA2,
    MIN_ROUGHNESS,
    SIGNED,
    UNIT,
    Facts,
    Kind,
    unknown,
)
from mipbake.material.model import (
    GGX_LOBE,
    Lines,
    MaterialModel,
    ModelMap,
    rgb,
    with_unit_length,
)
from mipbake.material.models import (
    COMMON,
    GLTF_MODELS,
    MODELS,
    convert,
    least_alpha2,
    losses,
    model_named,
    most_roughness,
    regularise,
)
from mipbake.material.tensors import (
    MIN_NORMAL_Z,
    Array,
    axes_to_tensor,
    full_tensor,
    lift_normal,
    mean_eigenvalue,
    positive_definite,
    tensor_exp,
    tensor_log,
)

__all__ = [
    "COLOUR",
    "COMMON",
    "DIELECTRIC_F0",
    "FACTS",
    "GGX_LOBE",
    "GLTF_MODELS",
    "LEAST_STRENGTH",
    "LOG",
    "MAX_LOG_ALPHA2",
    "MAX_LOG_GAMMA",
    "MIN_HEIGHT",
    "MIN_LOG_ALPHA2",
    "MIN_NORMAL_Z",
    "MIN_ROUGHNESS",
    "MODELS",
    "SIGNED",
    "UNIT",
    "Array",
    "Facts",
    "Kind",
    "Lines",
    "MaterialModel",
    "ModelMap",
    "axes_to_tensor",
    "base_and_metallic",
    "beckmann_to_ggx",
    "convert",
    "full_tensor",
    "ggx_to_beckmann",
    "gltf_to_ggx",
    "least_alpha2",
    "lift_normal",
    "losses",
    "mean_eigenvalue",
    "model_named",
    "most_roughness",
    "positive_definite",
    "regularise",
    "rgb",
    "tensor_exp",
    "tensor_log",
    "unknown",
    "with_unit_length",
]
