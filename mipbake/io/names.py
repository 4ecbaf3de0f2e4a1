"""What a file's name says about the map it holds.

A name is split at separators; trailing words about resolution, format or encoding are dropped; what remains must END
in a known word, so that `rusty_metal_02_diff_1k.jpg` is a base colour and `Metal007.png` is nothing. Words may be
joined by separators, by capitals or not at all: `base_color`, `BaseColor` and `basecolor` are one word.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import product


@dataclass(frozen=True)
class Meaning:
    """One role that a file fills.

    Args:
        role: see `mipbake.io.options.ROLES`.
        channels: letters of the file's channels that hold it; empty for all that the role has.
        inverted: the file stores one minus the value.
        rank: preference among files of one role, 0 first. Files of the same rank are a conflict.
        convention: "opengl" or "directx" where a normal map's name says so.
    """

    role: str
    channels: str = ""
    inverted: bool = False
    rank: int = 0
    convention: str | None = None


@dataclass(frozen=True)
class NameMatch:
    """A recognised name: the word that matched, what it means (nothing for maps not used), and the words before."""

    word: str
    meanings: tuple[Meaning, ...]
    asset: str


_INVERTED = _DERIVED = 1
_PACKED = 2

_PLAIN_WORDS = {
    "base_color": "basecolor basecolour basecol base color colour col albedo alb diffuse diff dif diffusecolor "
    "diffusecolour basemap maintex colormap colourmap diffusemap albedomap basecolormap basecolourmap bc d",
    "roughness": "roughness rough rgh roughnessmap roughmap r",
    "metallic": "metallic metalness metal met mtl metallicmap metalnessmap m",
    "anisotropy": "anisotropy anisotropic aniso anisotropymap",
    "occlusion": "ambientocclusion occlusion occ ao mixedao ambientocclusionmap occlusionmap aomap",
    "height": "height displacement disp dsp hgt heightmap displacementmap parallax parallaxmap disp16 "
    "displacement16 height16 h",
    "emissive": "emissive emission emit emis emissivecolor emissivecolour emissioncolor emissioncolour emissivemap "
    "emissionmap e",
    "opacity": "opacity alpha transparency opac cutout opacitymap alphamap alphamask opacitymask",
}
_GLOSS_WORDS = "gloss glossiness smoothness smooth gls glossmap glossinessmap smoothnessmap"
_NORMAL_WORDS = "normal normals nor norm nrm nml nmap nrm16 normal16 normalmap normalsmap bumpmap"
_CONVENTIONS = {
    "": None,
    "gl": "opengl",
    "ogl": "opengl",
    "opengl": "opengl",
    "dx": "directx",
    "directx": "directx",
    "d3d": "directx",
}
_PACKED_LETTERS = {"a": "occlusion", "o": "occlusion", "r": "roughness", "m": "metallic"}
_PACKED_WORDS = "arm orm rma rmo mra mro"

# Recognised, so that `specular_color` is no base colour and `coat_roughness` no roughness.
_UNUSED_OF = "specular spec sheen coat clearcoat subsurface sss transmission detail bent worldspace objectspace"
_UNUSED_MAPS = "color colour normal normals roughness rough gloss map mask albedo"
_UNUSED_WORDS = (
    f"{_UNUSED_OF} spc specularlevel specularsmoothness specularglossiness specgloss refl reflection cavity cav "
    "curvature translucency translucent thickness fuzz ior mask id position anisotropylevel "
    "anisotropyangle anisotropyrotation"
)


@cache
def _words() -> dict[str, tuple[Meaning, ...]]:
    words: dict[str, tuple[Meaning, ...]] = {}
    words.update((w, ()) for w in _UNUSED_WORDS.split())
    words.update((a + b, ()) for a, b in product(_UNUSED_OF.split(), _UNUSED_MAPS.split()))
    for role, names in _PLAIN_WORDS.items():
        words.update((w, (Meaning(role),)) for w in names.split())
    words["bump"] = (Meaning("height", rank=_DERIVED),)
    words.update((w, (Meaning("roughness", inverted=True, rank=_INVERTED),)) for w in _GLOSS_WORDS.split())
    for base, (suffix, convention) in product((*_NORMAL_WORDS.split(), "n"), _CONVENTIONS.items()):
        words[base + suffix] = (Meaning("normal", convention=convention),)
    for word in _PACKED_WORDS.split():
        words[word] = tuple(Meaning(_PACKED_LETTERS[w], c, rank=_PACKED) for w, c in zip(word, "RGB", strict=True))
    occlusion, roughness, metallic = (
        Meaning(role, c, rank=_PACKED) for role, c in zip(("occlusion", "roughness", "metallic"), "RGB", strict=True)
    )
    for long_word in ("occlusionroughnessmetallic", "aoroughnessmetallic", "aoroughmetal"):
        words[long_word] = (occlusion, roughness, metallic)
    for long_word in ("metallicroughness", "roughnessmetallic", "metalroughness", "roughnessmetalness", "metalrough"):
        words[long_word] = (roughness, metallic)
    smoothness = Meaning("roughness", "A", inverted=True, rank=_PACKED)
    for metal, gloss in product(("metallic", "metal"), ("smoothness", "smooth", "gloss", "glossmap", "glossiness")):
        words[metal + gloss] = (Meaning("metallic", "R", rank=_PACKED), smoothness)
    words["maskmap"] = (Meaning("metallic", "R", rank=_PACKED), Meaning("occlusion", "G", rank=_PACKED), smoothness)
    for colour in ("albedo", "basecolor", "diffuse"):
        for alpha in ("transparency", "opacity", "alpha"):
            words[colour + alpha] = (Meaning("base_color", "RGB"), Meaning("opacity", "A", rank=_PACKED))
    return words


# Words this short are only trusted behind a separator: the D of Concrete044D is part of the asset's name.
_NEEDS_SEPARATOR = frozenset({"d", "n", "r", "m", "h", "e", "bc", "id", *_PACKED_WORDS.split()})

_TRAILING = re.compile(
    r"\d{1,2}k|\d{2,5}x\d{2,5}|128|256|512|1024|2048|4096|8192|16384|lod\d|[uv]\d{1,3}|(8|16|32)bit|1\d{3}"
    r"|srgb|linear|lin|raw|jpe?g|png|exr|tiff?|tga|hdr|webp|bmp",
    re.IGNORECASE,
)
_GLUED_RESOLUTION = re.compile(r"(?<=[A-Za-z])\d{1,2}k$", re.IGNORECASE)
_CAMEL = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")


def _split(stem: str) -> list[tuple[str, bool]]:
    """Words of a stem in lower case, each with whether a separator precedes it."""
    chunks = [c for c in re.split(r"[^A-Za-z0-9]+", stem) if c]
    while len(chunks) > 1 and _TRAILING.fullmatch(chunks[-1]):
        chunks.pop()
    return [
        (word.lower(), i == 0)
        for chunk in chunks
        for i, word in enumerate(_CAMEL.findall(_GLUED_RESOLUTION.sub("", chunk)))
    ]


def asset_words(stem: str) -> str:
    """The words of a stem without resolution, format and encoding, joined: for comparing names."""
    return "".join(w for w, _ in _split(stem))


def interpretations(stem: str) -> list[NameMatch]:
    """What the name of a file, without its extension, can mean: the longest known word at its end first.

    More than one where known words end in others: `brushed_metal_rough` may be a packed `metal_rough` of a set called
    brushed, or the roughness of a set called brushed metal. Which one it is, the other files of the set tell.
    """
    words = _split(stem)
    found = []
    for start in range(max(0, len(words) - 5), len(words)):
        word = "".join(w for w, _ in words[start:])
        meanings = _words().get(word)
        if meanings is None:
            continue
        separated = words[start][1] and start > 0
        if separated or word not in _NEEDS_SEPARATOR or (len(word) == 3 and start == 0):
            found.append(NameMatch(word, meanings, "".join(w for w, _ in words[:start])))
    return found


_OPPOSITE = {"gl": "DX", "ogl": "DX", "opengl": "DirectX", "dx": "GL", "directx": "OpenGL", "d3d": "GL"}
_CONVENTION = re.compile(rf"(?:{'|'.join(sorted(_OPPOSITE, key=len, reverse=True))})(?![A-Za-z])", re.IGNORECASE)


def with_convention(stem: str, convention: str) -> str:
    """The name of a normal map's file as it is where the map is of a convention; as it was where it tells none."""

    def tells(name: str) -> set[str | None]:
        return {m.convention for match in interpretations(name) for m in match.meanings if m.role == "normal"}

    found = list(_CONVENTION.finditer(stem))
    if not found or not tells(stem) - {None, convention}:
        return stem
    word = found[-1][0]
    other = _OPPOSITE[word.lower()]
    other = other.lower() if word.islower() else other.upper() if word.isupper() else other
    renamed = stem[: found[-1].start()] + other + stem[found[-1].end() :]
    return renamed if convention in tells(renamed) else stem


def classify(stems: Sequence[str]) -> list[NameMatch | None]:
    """What the files of one folder mean, by the names of all: of several interpretations of a name the one that leaves
    what most other names leave, then one that is of use, then the longest word. None for names without a known word.
    """
    possible = [interpretations(stem) for stem in stems]
    shared = Counter(asset for several in possible for asset in {m.asset for m in several})
    return [max(s, key=lambda m: (shared[m.asset], bool(m.meanings), len(m.word)), default=None) for s in possible]
