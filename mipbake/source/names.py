"""What a file's name says about the map it holds.

A name is split at separators; trailing words about resolution, format, colour space or variant are dropped; what
remains must END in a known word, so that `rusty_metal_02_diff_1k.jpg` is a base colour and `Metal007.png` is nothing.
Words may be joined by separators, by capitals or not at all: `base_color`, `BaseColor` and `basecolor` are one word. A
long word counts even where nothing sets it off: `woodcolor.png` is a base colour unless another file's name says so
more clearly. What browsers and file managers add to the name of a copy, ` (1)` or ` - Copy`, says nothing.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from itertools import product

from mipbake.source.images.colours import split_colour_space


@dataclass(frozen=True)
class Meaning:
    """One role that a file fills.

    Args:
        role: see `mipbake.source.options.ROLES`.
        channels: letters of the file's channels that hold it; empty for all that the role has.
        inverted: the file stores one minus the value.
        rank: preference among files of one role, 0 first. Files of the same rank are a conflict.
        convention: "opengl" or "directx" where a normal map's name says so.
        variant: of files of one role and rank the one with the smallest number is taken (`color_VAR1`); 0 for none.
            Copies of a file (`color (1)`) come after all its variants.
    """

    role: str
    channels: str = ""
    inverted: bool = False
    rank: int = 0
    convention: str | None = None
    variant: int = 0


@dataclass(frozen=True)
class NameMatch:
    """A recognised name: the word that matched, what it means (nothing for maps not used), and the words before."""

    word: str
    meanings: tuple[Meaning, ...]
    asset: str


_INVERTED = _DERIVED = 1
_PACKED = 2
_GLUED = 3

_PLAIN_WORDS = {
    "base_color": "basecolor basecolour basecol base color colour col albedo alb diffuse diff dif diffusecolor "
    "diffusecolour basemap maintex colormap colourmap diffusemap albedomap basecolormap basecolourmap bc d",
    "roughness": "roughness rough rgh roughnessmap roughmap r",
    "metallic": "metallic metalness metal met mtl metallicmap metalnessmap m",
    "anisotropy": "anisotropy anisotropic aniso anisotropymap",
    "occlusion": "ambientocclusion occlusion occ ao mixedao ambientocclusionmap occlusionmap aomap",
    "height": "height displacement displ disp dsp hgt heightmap displacementmap parallax parallaxmap disp16 "
    "displacement16 height16 h",
    "emissive": "emissive emission emit emis emissivecolor emissivecolour emissioncolor emissioncolour emissivemap "
    "emissionmap e",
    "opacity": "opacity alpha transparency opac cutout opacitymap alphamap alphamask opacitymask",
}
_GLOSS_WORDS = "gloss glossiness smoothness smooth gls glossmap glossinessmap smoothnessmap"
_NORMAL_WORDS = "normal normals nor norm nrm nml nmp nmap nrm16 normal16 normalmap normalsmap bumpmap ddn"
_CONVENTIONS = {
    "": None,
    **dict.fromkeys(("gl", "ogl", "opengl"), "opengl"),
    **dict.fromkeys(("dx", "directx", "d3d"), "directx"),
}
_PACKED_LETTERS = {"a": "occlusion", "o": "occlusion", "r": "roughness", "m": "metallic", "d": "height"}
_PACKED_WORDS = {
    **{word: word for word in ["arm", "orm", "rma", "rmo", "mra", "mro", "ord"]},
    **{"ordp": "ord", "mrao": "mra"},  # displacement and ambient occlusion, in two letters
}
"""Word to what its channels hold, by letter."""

# Recognised, so that `specular_color` is not a base colour and `coat_roughness` not a roughness.
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
    for word, letters in _PACKED_WORDS.items():
        words[word] = tuple(Meaning(_PACKED_LETTERS[w], c, rank=_PACKED) for w, c in zip(letters, "RGB", strict=True))
    for long_word in ("occlusionroughnessmetallic", "aoroughnessmetallic", "aoroughmetal"):
        words[long_word] = words["orm"]
    for long_word in ("metallicroughness", "roughnessmetallic", "metalroughness", "roughnessmetalness", "metalrough"):
        words[long_word] = words["orm"][1:]
    smoothness = Meaning("roughness", "A", inverted=True, rank=_PACKED)
    for metal, gloss in product(("metallic", "metal"), ("smoothness", "smooth", "gloss", "glossmap", "glossiness")):
        words[metal + gloss] = (Meaning("metallic", "R", rank=_PACKED), smoothness)
    # Blue holds a detail mask, or a displacement: the name does not say which.
    mask = (Meaning("metallic", "R", rank=_PACKED), Meaning("occlusion", "G", rank=_PACKED), smoothness)
    words.update(dict.fromkeys(("maskmap", "mads"), mask))
    words["ddna"] = (Meaning("normal", "RGB"), smoothness)  # CryEngine's
    for colour in ("albedo", "basecolor", "color", "diffuse"):
        for alpha in ("transparency", "opacity", "alpha"):
            words[colour + alpha] = (Meaning("base_color", "RGB"), Meaning("opacity", "A", rank=_PACKED))
    return words


# Words this short are only trusted behind a separator: the D of Concrete044D is part of the asset's name.
_NEEDS_SEPARATOR = frozenset({"d", "n", "r", "m", "h", "e", "bc", "id", "mads", "ddn", "nmp", *_PACKED_WORDS})

# Words that name materials and pictures as often as maps are only trusted where something sets them off: `gunmetal`.
_LOOSE = frozenset({"smooth", "cutout", "id", "mask"})
_LEAST_GLUED = 6  # letters; shorter words end too many others, except for `color`

_TRAILING = re.compile(
    r"\d{1,2}k|\d{2,5}x\d{2,5}|128|256|512|1024|2048|4096|8192|16384|lod\d|[uv]\d{1,3}|(8|16|32)bit|1\d{3}"
    r"|(var|variant|variation)(?P<variant>\d{0,3})|jpe?g|png|exr|tiff?|tga|hdr|webp|avif|ktx2|bmp",
    re.IGNORECASE,
)
_GLUED_RESOLUTION = re.compile(r"(?<=[A-Za-z])\d{1,2}k$", re.IGNORECASE)
_CAMEL = re.compile(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+|\d+")
_CHUNK = re.compile(r"[A-Za-z0-9]+")
_COPY = re.compile(r" ?\((?P<bracketed>\d{1,2})\)$| - copy$| copy( (?P<number>\d{1,2}))?$", re.IGNORECASE)
_MOST_VARIANTS = 1000
# Poliigon ends the names of all maps so, even the name of the metalness map.
_WORKFLOW = re.compile(r"(?P<bare>.+)[ _-]\d{1,2}K[ _-]METALNESS", re.IGNORECASE)


@lru_cache(maxsize=4096)
def _stripped(stem: str) -> tuple[str, str | None, int]:
    """A stem without what trails it, its colour space, and the number of its variant."""
    space, variant, copies = None, 0, 0
    while copied := _COPY.search(stem):
        stem, copies = stem[: copied.start()], copies + int(copied["bracketed"] or copied["number"] or 1)
    while True:
        bare, found = split_colour_space(stem)
        if found is not None:
            stem, space = bare, space or found
            continue
        chunks = list(_CHUNK.finditer(stem))
        match = _TRAILING.fullmatch(chunks[-1][0]) if len(chunks) > 1 else None
        if match is None:
            return stem, space, variant + _MOST_VARIANTS * copies
        if match["variant"] is not None:
            variant = int(match["variant"] or 1)
        stem = stem[: chunks[-1].start()]


def colour_space_of(stem: str) -> str | None:
    """The colour space at the end of a stem, as `split_colour_space` has it, wherever the resolution stands."""
    return _stripped(stem)[1]


def _split(stem: str) -> list[tuple[str, bool]]:
    """Words of a stem in lower case, each with whether a separator precedes it."""
    return [
        (word.lower(), i == 0)
        for chunk in _CHUNK.findall(_stripped(stem)[0])
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
        if separated or word not in _NEEDS_SEPARATOR or (len(word) >= 3 and start == 0):
            found.append(NameMatch(word, meanings, "".join(w for w, _ in words[:start])))
    if not found and words:
        found = _glued([w for w, _ in words])
    bare, _, variant = _stripped(stem)
    if workflow := _WORKFLOW.fullmatch(bare):
        found += interpretations(workflow["bare"])
    if not variant:
        return found
    return [replace(m, meanings=tuple(replace(each, variant=variant) for each in m.meanings)) for m in found]


def _glued(words: Sequence[str]) -> list[NameMatch]:
    """What the last of several words means by how it ends: the longest known word, and only a long one."""
    whole = words[-1]
    for start in range(1, len(whole)):
        word = whole[start:]
        meanings = _words().get(word)
        if meanings is not None and (len(word) >= _LEAST_GLUED or word == "color") and word not in _LOOSE:
            ranked = tuple(replace(meaning, rank=meaning.rank + _GLUED) for meaning in meanings)
            return [NameMatch(word, ranked, "".join([*words[:-1], whole[:start]]))]
    return []


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
