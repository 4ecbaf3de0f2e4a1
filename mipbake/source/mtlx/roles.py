"""The roles of a texture set out of the inputs of a MaterialX surface shader."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field

from mipbake.base.colour import LINEAR, SRGB, canonical_colour_space
from mipbake.base.errors import InputError, UsageError
from mipbake.source.images.colours import RAW, spelt_space
from mipbake.source.mtlx.document import Element, Link, Scope, UnreadError
from mipbake.source.mtlx.shaders import SHADERS, Shader
from mipbake.source.mtlx.trace import Channel, Signal, Texture, Tracer
from mipbake.source.options import COLOUR_ROLES, ROLES, SHADING_ROLES, LoadOptions, MapChoice
from mipbake.source.sources import Log, spoken

_CLOSE = 1e-4  # decimals of a document

_NEARLY_SRGB = ("g22_rec709", "g18_rec709", "gamma22", "gamma18", "gamma24", "rec709_display")
_INTEGER_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".bmp", ".tga")


@dataclass
class _Roles:
    """The roles of one material as they are read, out of a shader node, what that is, and a node that displaces; a text
    where there is none."""

    tracer: Tracer
    node: Element
    scope: Scope
    shader: Shader
    displaced: Link | str
    log: Log
    maps: dict[str, MapChoice] = field(default_factory=dict)
    factors: dict[str, float] = field(default_factory=dict)
    textures: dict[str, Texture] = field(default_factory=dict)
    unread: dict[str, str] = field(default_factory=dict)
    is_gloss: bool = False
    convention: str | None = None

    def input(self, name: str) -> Signal | None:
        """What an input of the shader holds; None where it is left at its default."""
        return self.tracer.input(self.node, name, self.scope)

    def number(self, name: str, default: float) -> float | None:
        """The value of a constant input; None where the input is not constant."""
        try:
            signal = self.input(name)
        except UnreadError:
            return None
        values = (default,) if signal is None else signal.numbers
        return values[0] if values else None

    def _signal(self, role: str) -> Signal | None:
        """What a role holds; None where it is left at its default."""
        height, by = None, self.displaced
        if role == "height" and isinstance(by, Link) and by.node.tag == "displacement":
            height = self.tracer.input(by.node, "displacement", by.scope)
        return self.input(self.shader.inputs[role]) if height is None and role in self.shader.inputs else height

    def fill(self, role: str) -> None:
        """Fills one role."""
        default = self.shader.defaults.get(role)
        self.maps[role] = default
        try:
            signal = self._signal(role)
            if signal is None:
                return
            if signal.numbers is not None:
                self._constant(role, signal.numbers)
            elif signal.texture is None:
                raise UnreadError("channels of several textures together")
            elif role == "normal":
                self._normal(signal, signal.texture)
            elif role in COLOUR_ROLES:
                self._colour(role, signal, signal.texture)
            else:
                self._scalar(role, signal.channels[0], signal.texture)
        except UnreadError as error:
            self.unread[role] = str(error)
            instead = "a flat one is used" if role == "normal" else "it is left out"
            if default is not None:
                instead = f"the shader's default {default:g} is used"
            self.log.warnings.append(
                f"{spoken(role)} cannot be read ({error}), {instead}; bake it to a texture to have it used"
            )

    def _constant(self, role: str, values: tuple[float, ...]) -> None:
        if role == "anisotropy" and values[0]:
            self.log.notes.append(f"anisotropy is the constant {values[0]:g}: it is not read, only maps are")
        if role not in self.shader.defaults:
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

    def _scalar(self, role: str, first: Channel, texture: Texture) -> None:
        if role == "anisotropy" and texture.node.endswith("(gltf_anisotropy_image)"):
            self._take(role, texture, "")  # KHR_materials_anisotropy: direction and strength in one file
            return
        gain, inverted = first.gain, first.gain < 0
        if abs(first.offset - (-gain if inverted else 0)) > _CLOSE:
            raise UnreadError(f"{gain:g} times {texture.path.name} plus {first.offset:g}")
        if inverted and role != "roughness":
            raise UnreadError(f"one minus {texture.path.name}")
        if abs(abs(gain) - 1) > _CLOSE:
            if role in ("height", "anisotropy"):
                self.log.notes.append(f"{role} is {abs(gain):g} times {texture.path.name}: the map is left as it is")
            else:
                self.factors[role] = abs(gain)
        if role == "roughness":
            self.is_gloss = inverted
        if role == "anisotropy":
            self.log.warnings.append(
                f"{texture.path.name}: the anisotropy of {self.node.tag} is taken as the strength of "
                "KHR_materials_anisotropy along +X, which stretches highlights otherwise"
            )
        self._take(role, texture, first.letter)

    def _colour(self, role: str, signal: Signal, texture: Texture) -> None:
        channels = (signal.channels * 3)[:3] if len(signal.channels) == 1 else signal.channels[:3]
        letters = "".join(c.letter for c in channels)
        if letters != "RGB" and len(set(letters)) > 1:
            raise UnreadError(f"the channels {letters} of {texture.path.name}")
        if any(abs(c.offset) > _CLOSE or c.gain <= 0 for c in channels):
            raise UnreadError(f"{texture.path.name}, inverted or shifted")
        if any(abs(c.gain - 1) > _CLOSE for c in channels):
            gains = ", ".join(f"{c.gain:g}" for c in channels)
            self.log.notes.append(
                f"{spoken(role)} is {gains} times {texture.path.name}: that factor is not baked in, keep it"
            )
        self._take(role, texture, "" if letters == "RGB" else letters[0])

    def _normal(self, signal: Signal, texture: Texture) -> None:
        channels = signal.channels
        if "".join(c.letter for c in channels) != "RGB":
            raise UnreadError(f"the channels {''.join(c.letter for c in channels)} of {texture.path.name}")
        stored = [(c.gain, c.offset) for c in channels]
        decoded = any(abs(abs(gain) - 2) <= _CLOSE for gain, _ in stored)
        up, down = ((2, -1), (-2, 1)) if decoded else ((1, 0), (-1, 1))
        green = next((s for s in (up, down) if math.dist(stored[1], s) <= _CLOSE), None)
        if green is None or any(math.dist(stored[c], up) > _CLOSE for c in (0, 2)):
            raise UnreadError(f"{texture.path.name}, scaled or shifted")
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
            raise UnreadError(f"{texture.path.name} with the scale {mean:g}")
        if abs(mean - 1) > _CLOSE:
            self.factors["normal"] = mean
        self._take("normal", texture, "")

    def _take(self, role: str, texture: Texture, letter: str) -> None:
        path = os.path.abspath(texture.path)  # noqa: PTH100  Path.resolve would follow links
        self.maps[role] = f"{path}:{letter}" if letter else path
        self.textures[role] = texture
        if role not in COLOUR_ROLES and texture.type.startswith("color"):
            space = _decoding(texture.colour_space) if texture.colour_space else LINEAR
            if space is not None and not space.lower().startswith("linear"):
                self.log.warnings.append(
                    f"{texture.path.name}: {spoken(role)} is read as data, though the document would decode it from "
                    f"{texture.colour_space}"
                )

    def drop(self, role: str, why: str) -> None:
        """Leaves a role out."""
        texture = self.textures.pop(role, None)
        self.maps[role] = None
        self.factors.pop(role, None)
        if texture is not None:
            self.log.notes.append(f"{texture.path.name}: {spoken(role)} is left out, {why}")


def read_roles(tracer: Tracer, surface: Link, displaced: Link | str, where: str, log: Log) -> LoadOptions:
    """What fills every role of a material; InputError where neither normal nor roughness comes from a file, or the
    shader is not known, or is used in a way that is not read. `surface`: the shader's node. `displaced`: the node that
    displaces the surface; a text for none. `where`: document and material, for errors."""
    shader = SHADERS.get(surface.node.tag)
    if shader is None:
        raise InputError(f"{where} is made of {surface.node.tag}: expected one of {', '.join(SHADERS)}")
    roles = _Roles(tracer, surface.node, surface.scope, shader, displaced, log)
    if roles.number("useSpecularWorkflow", 0):
        raise InputError(
            f"{where} uses the specular workflow: expected metallic, export it with metallic and roughness"
        )
    for role in ROLES:
        roles.fill(role)
    if not {"normal", "roughness"} & roles.textures.keys():
        unread = "; ".join(f"{spoken(role)}: {why}" for role, why in roles.unread.items())
        raise InputError(
            f"{where} is procedural or constant: neither its normal nor its roughness comes from a file"
            + (f" ({unread})" if unread else "")
            + "; bake it to textures first"
        )
    cutoff = _opacity(roles)
    _check_weights(roles)
    _note_unused(roles)
    _check_placement(roles)
    return LoadOptions(
        maps=roles.maps,
        colour_space=_colour_space(roles),
        normal_convention=roles.convention,
        roughness_is_gloss=roles.is_gloss if "roughness" in roles.textures else None,
        wrap=_wrap(roles),
        factors=roles.factors,
        alpha_cutoff=cutoff,
        origin="document",
    )


def _opacity(roles: _Roles) -> float | None:
    """What opacity is tested against; drops it where the shader ignores it."""
    if roles.node.tag == "gltf_pbr":
        mode = roles.number("alpha_mode", 0)
        if mode == 0:
            roles.drop("opacity", "the shader's alpha_mode is opaque")
        cutoff = roles.number("alpha_cutoff", 0.5) if mode == 1 else None
    else:
        cutoff = roles.number("opacityThreshold", 0) or None
    if cutoff is None or "opacity" not in roles.textures:
        return None
    if not 0 < cutoff <= 1:
        roles.log.warnings.append(f"no opacity lies on either side of the cutoff {cutoff:g}: it is left out")
        return None
    return cutoff


def _check_weights(roles: _Roles) -> None:
    """Inputs that multiply a colour: they stay in the shader."""
    for role, (name, default) in roles.shader.weights.items():
        if role not in roles.textures:
            continue
        weight = roles.number(name, default)
        if weight == 0:
            roles.drop(role, f"the shader's {name} is 0")
        elif weight is None:
            roles.log.warnings.append(
                f"{spoken(role)} is multiplied by {name}, which is not a constant and is not read"
            )
        elif abs(weight - 1) > _CLOSE:
            roles.log.notes.append(
                f"{spoken(role)} is multiplied by {name} = {weight:g}, which is not baked in: keep it"
            )


def _note_unused(roles: _Roles) -> None:
    """Textures of inputs that no role stands for."""
    used = {*roles.shader.inputs.values(), *(name for name, _ in roles.shader.weights.values())}
    for name in [entry.get("name", "") for entry in roles.node.iterfind("input")]:
        try:
            signal = None if name in used else roles.input(name)
        except UnreadError:
            continue
        texture = None if signal is None else signal.texture
        if texture is not None and texture not in roles.textures.values():
            roles.log.notes.append(f"{texture.path.name}: fills {name}, which is not read")


def _check_placement(roles: _Roles) -> None:
    """Maps that shade are filtered together, texel by texel."""
    shading = {role: t for role, t in roles.textures.items() if role in SHADING_ROLES}
    first = next(iter(shading.values()))
    for role, texture in shading.items():
        if texture.placement != first.placement:
            roles.log.warnings.append(
                f"{texture.path.name}: {spoken(role)} lies differently on the surface than {first.path.name} (its "
                "tiling, offset or coordinates differ), but they are filtered as if they lay on each other"
            )


def _wrap(roles: _Roles) -> tuple[str, str]:
    leading = roles.textures.get("normal") or roles.textures["roughness"]
    if any(texture.wrap != leading.wrap for texture in roles.textures.values()):
        roles.log.warnings.append(
            f"maps are addressed differently beyond their borders: all are addressed as {leading.path.name} is"
        )
    for axis, mode in zip("uv", leading.wrap, strict=True):
        if mode in ("mirror", "constant"):
            roles.log.warnings.append(
                f"{leading.path.name}: is addressed as {mode} along {axis}, clamp is used instead"
            )
    u, v = ("wrap" if mode == "wrap" else "clamp" for mode in leading.wrap)
    return u, v


def _colour_space(roles: _Roles) -> str | None:
    """The colour space of the colours, as `LoadOptions` takes it; None leaves it to the type of the file."""
    spaces: dict[str, str | None] = {}
    log = roles.log
    for role in [role for role in COLOUR_ROLES if role in roles.textures]:
        texture = roles.textures[role]
        named, label = texture.colour_space, texture.path.name
        spaces[role] = None if named is None else _decoding(named)
        if named is None:
            log.notes.append(f"{label}: the document names no colour space, its type decides")
        elif named.lower() in _NEARLY_SRGB:
            log.warnings.append(f"{label}: {named} is decoded as sRGB, which is close to it")
        elif spaces[role] is None:
            log.warnings.append(f"{label}: the colour space {named} is not known, the file's type decides")
        elif texture.inherited and spaces[role] == LINEAR and texture.path.suffix.lower() in _INTEGER_SUFFIXES:
            log.warnings.append(
                f"{label}: is linear by the document's colour space {named}, which its file input does not change; "
                'if it is sRGB, say colorspace="srgb_texture" there'
            )
    chosen = next(iter(spaces.values()), None)
    if len(set(spaces.values())) > 1:
        log.warnings.append(
            f"base colour and emissive are in different colour spaces: both are decoded as "
            f"{chosen or 'their types say'}"
        )
    return chosen


def _decoding(name: str) -> str | None:
    """The name under which decoding knows a colour space; None where it does not."""
    lowered = name.strip().lower()
    if lowered.removesuffix("_scene") in _NEARLY_SRGB:
        return SRGB
    space = RAW if lowered in ("none", "data") else spelt_space(lowered.removesuffix("_scene"))
    if space is None:
        try:
            return canonical_colour_space(name)
        except UsageError:
            return None
    return LINEAR if space == RAW else f"linear {space}" if space in ("ACEScg", "ACES2065-1") else space
