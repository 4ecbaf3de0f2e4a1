"""Texture sets in diffuse and specular colours and glossiness: found by their names, and converted when they are read.

`mipbake.material.specular_glossiness` has the formula.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mipbake.base.colour import canonical_colour_space, default_colour_space
from mipbake.base.errors import UsageError
from mipbake.material.specular_glossiness import metallic_roughness
from mipbake.source.decode import TextureMap
from mipbake.source.images.image import Header
from mipbake.source.images.read import read_header
from mipbake.source.matches import Match, explicit
from mipbake.source.names import Meaning, interpretations
from mipbake.source.options import SPECULAR, LoadOptions
from mipbake.source.sources import IgnoredFile, Log, MapSource

_ALONE = frozenset(
    ["specular", "specularcolor", "specularcolour", "specularmap", "spec", "speccolor", "speccolour", "specmap", "spc"]
)
_WITH_GLOSS = frozenset(["specularsmoothness", "specularglossiness", "specgloss"])
_DIFFUSE = frozenset(["diffuse", "diff", "dif", "diffusecolor", "diffusecolour", "diffusemap", "d"])


def take_specular(
    chosen: dict[str, Match], ignored: Sequence[IgnoredFile], folder: Path, options: LoadOptions
) -> MapSource | None:
    """The specular colours of a set in specular and glossiness; None for any other set. UsageError where a specular map
    is chosen beside a metallic one.

    A set is one where names tell of a diffuse map, of a specular map and of gloss, and of no metallic map: a specular
    map beside a roughness is as often an amount for dielectrics, and is left out. Gloss in the alpha of the specular
    map becomes the roughness of `chosen`, which is role to the file that fills it.
    """
    choice = options.maps.get(SPECULAR)
    if choice is None:
        found = None if SPECULAR in options.maps else _by_name(chosen, ignored, options)
    else:
        if "metallic" in chosen or options.maps.get("metallic") is not None:
            raise UsageError(
                f"map {SPECULAR} is {choice!r} beside a metallic map: a set has one of the two, add "
                "--map metallic=none (maps in Python)"
            )
        found = explicit(SPECULAR, str(choice), folder, options).header
    if found is None:
        return None
    word = _word(found.path)
    if word in _WITH_GLOSS and found.alpha >= 0 and "roughness" not in (*chosen, *options.maps):
        chosen["roughness"] = Match(found, Meaning("roughness", "A", inverted=True), f"named {word}")
    space = options.colour_space or found.colour_space or default_colour_space(found.is_integer)
    of = f" (of {chosen['base_color'].header.path.name})" if "base_color" in chosen else ""
    reason = f"converted from the diffuse and specular colours{of}"
    about = ("metallic", found, "RGB" if found.colours >= 3 else "Y", canonical_colour_space(space), False, reason)
    return MapSource.of_file(*about, converted=True, metadata=options.metadata)


def _by_name(chosen: Mapping[str, Match], ignored: Sequence[IgnoredFile], options: LoadOptions) -> Header | None:
    if {"metallic", "base_color"} & set(options.maps) or "metallic" in chosen or "base_color" not in chosen:
        return None
    if _word(chosen["base_color"].header.path) not in _DIFFUSE:
        return None
    gloss = "roughness" in chosen and chosen["roughness"].meaning.inverted
    for item in ignored:
        word = _word(item.path)
        if word in _ALONE and gloss:
            return read_header(item.path, SPECULAR, options.metadata)
        if word in _WITH_GLOSS and ("roughness" not in chosen or gloss):
            header = read_header(item.path, SPECULAR, options.metadata)
            if gloss or header.alpha >= 0:
                return header
    return None


def _word(path: Path) -> str:
    """The known word that a file's name ends with."""
    return next((match.word for match in interpretations(path.stem)), "")


def as_metallic(maps: dict[str, TextureMap], log: Log) -> None:
    """Converts the base colour and the metallic of maps, of one size, where those are diffuse and specular colours so
    far."""
    diffuse, specular = maps["base_color"], maps["metallic"]
    if not specular.source.converted:
        return
    base, metallic, loss = metallic_roughness(diffuse.pixels, specular.pixels)
    maps |= {"base_color": replace(diffuse, pixels=base), "metallic": replace(specular, pixels=metallic)}
    sentence = "diffuse and specular colours are converted to base colour and metallic"
    if loss.lossless:
        log.notes.append(f"{sentence}, which hold every texel to within 0.01")
    else:
        log.warnings.append(f"{sentence}: {loss}; see docs/conventions.md")
