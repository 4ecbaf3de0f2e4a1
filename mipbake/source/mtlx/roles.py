"""The roles of a texture set out of the inputs of a MaterialX surface shader."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping
from dataclasses import dataclass, field

from mipbake.base.colour import LINEAR
from mipbake.base.errors import InputError
from mipbake.source.mtlx.colour import colour_space_of, decoding
from mipbake.source.mtlx.document import Element, Scope
from mipbake.source.mtlx.shaders import Shader
from mipbake.source.mtlx.signal import Channel, Signal, Texture
from mipbake.source.mtlx.trace import Tracer
from mipbake.source.options import COLOUR_ROLES, PLAIN_ROLES, ROLES, SHADING_ROLES, LoadOptions, MapChoice
from mipbake.source.sources import Log, spoken

_CLOSE = 1e-4  # decimals of a document


@dataclass(frozen=True)
class Sources:
    """A shader node of a document, what it is, and the height that displaces its surface."""

    tracer: Tracer
    node: Element
    scope: Scope
    shader: Shader
    height: Signal | None

    def input(self, name: str) -> Signal | None:
        """What one of its inputs holds; None where it is left at its default."""
        return self.tracer.input(self.node, name, self.scope)

    def number(self, name: str, default: float) -> float | None:
        """The value of a constant input; None where the input is not constant."""
        signal = self.input(name)
        values = (default,) if signal is None else signal.numbers
        return values[0] if values else None


@dataclass(frozen=True)
class Filled:
    """What was found, to load it with, and the texture that every role is from."""

    options: LoadOptions
    textures: Mapping[str, Texture]


class _UnreadError(Exception):
    """Why a role cannot be read."""


@dataclass
class _Reading:
    """The roles of one material as they are read."""

    sources: Sources
    log: Log
    maps: dict[str, MapChoice] = field(default_factory=dict)
    factors: dict[str, float] = field(default_factory=dict)
    textures: dict[str, Texture] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)
    is_gloss: bool = False
    convention: str | None = None

    def role(self, role: str, signal: Signal | None) -> None:
        """Fills one role."""
        self.maps[role] = self._default(role)
        if signal is None:
            return
        try:
            if signal.reason:
                raise _UnreadError(signal.reason)
            if signal.numbers is not None:
                self._constant(role, signal.numbers)
            elif signal.texture is None:
                raise _UnreadError("channels of several textures together")
            elif role == "normal":
                self._normal(signal, signal.texture)
            elif role in COLOUR_ROLES:
                self._colour(role, signal, signal.texture)
            else:
                self._scalar(role, signal.channels, signal.texture)
        except _UnreadError as error:
            self.unread[role] = str(error)
            self.log.warnings.append(
                f"{spoken(role)} cannot be read ({error}), {self._instead(role)}; bake it to a texture to have it used"
            )

    def _default(self, role: str) -> MapChoice:
        return self.sources.shader.defaults.get(role)

    def _instead(self, role: str) -> str:
        default = self._default(role)
        if default is not None:
            return f"the shader's default {default:g} is used"
        return "a flat one is used" if role == "normal" else "it is left out"

    def _constant(self, role: str, values: tuple[float, ...]) -> None:
        if role == "anisotropy" and values[0]:
            self.log.notes.append(f"anisotropy is the constant {values[0]:g}: it is not read, only maps are")
        if role not in self.sources.shader.defaults:
            return
        if role == "base_color":
            r, g, b = (max(0.0, v) for v in (values * 3)[:3])
            grey = 0.2126 * r + 0.7152 * g + 0.0722 * b
            if max(r, g, b) - min(r, g, b) > _CLOSE:
                self.log.notes.append(
                    f"base colour is the constant {r:g}, {g:g}, {b:g}: its luminance {grey:.3g} stands for it, keep "
                    "the constant in the shader"
                )
            self.maps[role] = min(1.0, grey)
        else:
            self.maps[role] = min(1.0, max(0.0, values[0]))

    def _scalar(self, role: str, channels: tuple[Channel, ...], texture: Texture) -> None:
        first = channels[0]
        if role == "anisotropy" and texture.node.endswith("(gltf_anisotropy_image)"):
            self._take(role, texture, "")  # KHR_materials_anisotropy: direction and strength in one file
            return
        gain, inverted = first.gain, first.gain < 0
        if abs(first.offset - (-gain if inverted else 0)) > _CLOSE:
            raise _UnreadError(f"{gain:g} times {texture.path.name} plus {first.offset:g}")
        if inverted and role != "roughness":
            raise _UnreadError(f"one minus {texture.path.name}")
        if abs(abs(gain) - 1) > _CLOSE:
            if role in ("height", "anisotropy"):
                self.log.notes.append(f"{role} is {abs(gain):g} times {texture.path.name}: the map is left as it is")
            else:
                self.factors[role] = abs(gain)
        if role == "roughness":
            self.is_gloss = inverted
        if role == "anisotropy":
            self.log.warnings.append(
                f"{texture.path.name}: the anisotropy of {self.sources.node.tag} is taken as the strength of "
                "KHR_materials_anisotropy along +X, which stretches highlights otherwise"
            )
        self._take(role, texture, first.letter)

    def _colour(self, role: str, signal: Signal, texture: Texture) -> None:
        channels = (signal.channels * 3)[:3] if len(signal.channels) == 1 else signal.channels[:3]
        letters = "".join(c.letter for c in channels)
        if letters != "RGB" and len(set(letters)) > 1:
            raise _UnreadError(f"the channels {letters} of {texture.path.name}")
        if any(abs(c.offset) > _CLOSE or c.gain <= 0 for c in channels):
            raise _UnreadError(f"{texture.path.name}, inverted or shifted")
        if any(abs(c.gain - 1) > _CLOSE for c in channels):
            gains = ", ".join(f"{c.gain:g}" for c in channels)
            self.log.notes.append(
                f"{spoken(role)} is {gains} times {texture.path.name}: that factor is not baked in, keep it"
            )
        self._take(role, texture, "" if letters == "RGB" else letters[0])

    def _normal(self, signal: Signal, texture: Texture) -> None:
        channels = signal.channels
        if "".join(c.letter for c in channels) != "RGB":
            raise _UnreadError(f"the channels {''.join(c.letter for c in channels)} of {texture.path.name}")
        stored = [(c.gain, c.offset) for c in channels]
        decoded = any(abs(abs(gain) - 2) <= _CLOSE for gain, _ in stored)
        up, down = ((2, -1), (-2, 1)) if decoded else ((1, 0), (-1, 1))
        green = next((s for s in (up, down) if math.dist(stored[1], s) <= _CLOSE), None)
        if green is None or any(math.dist(stored[c], up) > _CLOSE for c in (0, 2)):
            raise _UnreadError(f"{texture.path.name}, scaled or shifted")
        self.convention = "directx" if green == down else "opengl"
        if not decoded and signal.normal_scale is None:
            self.log.warnings.append(
                f"{texture.path.name}: no normalmap node stands before the normal; it is read as a tangent-space map"
            )
        scale = signal.normal_scale or (1.0,)
        if max(scale) - min(scale) > _CLOSE:
            self.log.warnings.append(f"{texture.path.name}: its scale differs along u and v, the mean is used")
        mean = sum(scale) / len(scale)
        if mean < 0:
            raise _UnreadError(f"{texture.path.name} with the scale {mean:g}")
        if abs(mean - 1) > _CLOSE:
            self.factors["normal"] = mean
        self._take("normal", texture, "")

    def _take(self, role: str, texture: Texture, letter: str) -> None:
        path = os.path.abspath(texture.path)  # noqa: PTH100  Path.resolve would follow links
        self.maps[role] = f"{path}:{letter}" if letter else path
        self.textures[role] = texture
        if role not in COLOUR_ROLES and texture.type.startswith("color"):
            space = decoding(texture.colour_space) if texture.colour_space else LINEAR
            if space is not None and not space.lower().startswith("linear"):
                self.log.warnings.append(
                    f"{texture.path.name}: {spoken(role)} is read as data, though the document would decode it from "
                    f"{texture.colour_space}"
                )


def read_roles(sources: Sources, where: str, log: Log) -> Filled:
    """What fills every role of a material.

    Args:
        sources: its shader.
        where: document and material, for errors.
        log: takes notes and warnings.

    Raises:
        InputError: neither normal nor roughness comes from a file, or the shader is used in a way that is not read.
    """
    if sources.number("useSpecularWorkflow", 0):
        raise InputError(
            f"{where} uses the specular workflow: expected metallic, export it with metallic and roughness"
        )
    reading = _Reading(sources, log)
    for role in ROLES:
        name = sources.shader.inputs.get(role)
        signal = sources.height if role == "height" and sources.height is not None else None
        reading.role(role, sources.input(name) if name and signal is None else signal)
    if not {"normal", "roughness"} & reading.textures.keys():
        unread = "; ".join(f"{spoken(role)}: {why}" for role, why in reading.unread.items())
        raise InputError(
            f"{where} is procedural or constant: neither its normal nor its roughness comes from a file"
            + (f" ({unread})" if unread else "")
            + "; bake it to textures first"
        )
    cutoff = _opacity(sources, reading, log)
    _weights(sources, reading, log)
    _unused(sources, reading, log)
    _check_placement(reading, log)
    options = LoadOptions(
        maps=reading.maps,
        colour_space=colour_space_of(reading.textures, log),
        normal_convention=reading.convention,
        roughness_is_gloss=reading.is_gloss if "roughness" in reading.textures else None,
        wrap=_wrap(reading, log),
        factors=reading.factors,
        alpha_cutoff=cutoff,
        origin="document",
    )
    return Filled(options, reading.textures)


def _drop(reading: _Reading, role: str, why: str, log: Log) -> None:
    texture = reading.textures.pop(role, None)
    reading.maps[role] = None
    reading.factors.pop(role, None)
    if texture is not None:
        log.notes.append(f"{texture.path.name}: {spoken(role)} is left out, {why}")


def _opacity(sources: Sources, reading: _Reading, log: Log) -> float | None:
    """What opacity is tested against; drops it where the shader ignores it."""
    if sources.node.tag == "gltf_pbr":
        mode = sources.number("alpha_mode", 0)
        if mode == 0:
            _drop(reading, "opacity", "the shader's alpha_mode is opaque", log)
        cutoff = sources.number("alpha_cutoff", 0.5) if mode == 1 else None
    else:
        cutoff = sources.number("opacityThreshold", 0) or None
    if cutoff is None or "opacity" not in reading.textures:
        return None
    if not 0 < cutoff <= 1:
        log.warnings.append(f"no opacity lies on either side of the cutoff {cutoff:g}: it is left out")
        return None
    return cutoff


def _weights(sources: Sources, reading: _Reading, log: Log) -> None:
    """Inputs that multiply a colour: they stay in the shader."""
    for role, (name, default) in sources.shader.weights.items():
        if role not in reading.textures:
            continue
        weight = sources.number(name, default)
        if weight == 0:
            _drop(reading, role, f"the shader's {name} is 0", log)
        elif weight is None:
            log.warnings.append(f"{spoken(role)} is multiplied by {name}, which is not a constant and is not read")
        elif abs(weight - 1) > _CLOSE:
            log.notes.append(f"{spoken(role)} is multiplied by {name} = {weight:g}, which is not baked in: keep it")


def _unused(sources: Sources, reading: _Reading, log: Log) -> None:
    """Textures of inputs that no role stands for."""
    used = {*sources.shader.inputs.values(), *(name for name, _ in sources.shader.weights.values())}
    for entry in sources.node.iterfind("input"):
        name = entry.get("name", "")
        signal = None if name in used else sources.input(name)
        texture = None if signal is None or signal.reason else signal.texture
        if texture is not None and texture not in reading.textures.values():
            log.notes.append(f"{texture.path.name}: fills {name}, which is not read")


def _check_placement(reading: _Reading, log: Log) -> None:
    """Maps that shade are filtered together, texel by texel."""
    shading = {role: t for role, t in reading.textures.items() if role in SHADING_ROLES}
    first = next(iter(shading.values()))
    for role, texture in shading.items():
        if texture.placement != first.placement:
            log.warnings.append(
                f"{texture.path.name}: {spoken(role)} lies differently on the surface than {first.path.name} (its "
                "tiling, offset or coordinates differ), but they are filtered as if they lay on each other"
            )


def _wrap(reading: _Reading, log: Log) -> tuple[str, str]:
    shading = [reading.textures[r] for r in (*SHADING_ROLES, *PLAIN_ROLES) if r in reading.textures]
    leading = reading.textures.get("normal") or reading.textures["roughness"]
    if any(t.wrap != leading.wrap for t in shading):
        log.warnings.append(
            f"maps are addressed differently beyond their borders: all are addressed as {leading.path.name} is"
        )
    modes = []
    for axis, mode in zip("uv", leading.wrap, strict=True):
        if mode in ("mirror", "constant"):
            log.warnings.append(f"{leading.path.name}: is addressed as {mode} along {axis}, clamp is used instead")
        modes.append("wrap" if mode == "wrap" else "clamp")
    return modes[0], modes[1]
