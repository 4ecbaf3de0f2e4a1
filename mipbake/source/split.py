"""A folder with several texture sets, such as an export of Substance Painter: which file belongs to which set."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from mipbake.base.errors import InputError, UsageError
from mipbake.base.messages import listed
from mipbake.source.images.read import IMAGE_SUFFIXES
from mipbake.source.names import Meaning, NameMatch, asset_words, classify
from mipbake.source.options import SHADING_ROLES, LoadOptions, MapChoice
from mipbake.source.tiles import CHANNELS, PLACEHOLDER

_STAR = "*"


def divided(
    files: Sequence[Path], options: LoadOptions, tiles: Mapping[Path, str] | None = None
) -> Mapping[str, tuple[Path, ...]]:
    """The several sets that files of a folder belong to, by the words that their names begin with: these words, empty
    for names of roles alone, to files. Empty where all are one set. Files that are left out belong to none of the sets.
    `tiles`: file to the text of its UDIM tile, which is not a part of a set's name.

    They are several where two of them are complete, with a normal and a roughness map each, and two files would fill
    one role. `--map ROLE=PATTERN` says the roles of files whose names do not; UsageError where it has more than one *.
    """
    images = [file for file in files if file.suffix.lower() in IMAGE_SUFFIXES]
    texts = tiles or {}
    stems = {file: file.stem.replace(texts.get(file, ""), "") for file in images}
    patterns = {role: _expression(role, str(choice)) for role, choice in options.maps.items() if _is_pattern(choice)}
    groups: dict[str, dict[Path, NameMatch]] = {}
    for file, by_name in zip(images, classify([stems[file] for file in images]), strict=True):
        by_pattern = (
            NameMatch(role, (Meaning(role),), asset_words(found["name"].replace(texts.get(file, ""), "")))
            for role, expression in patterns.items()
            if (found := expression.fullmatch(file.name))
        )
        match = next(by_pattern, by_name)
        if match is not None:
            groups.setdefault(_key(match.asset, stems[file]), {})[file] = match
    decided = {role for role in options.maps if role not in patterns}
    own_roles = {
        asset: {meaning.role for match in group.values() for meaning in match.meanings}
        for asset, group in groups.items()
    }
    complete = [asset for asset, roles in own_roles.items() if roles and {"normal", "roughness"} <= roles | decided]
    if len(complete) < 2 or not _compete([groups[asset].values() for asset in complete], decided):
        return {}
    # A set that lacks one of the two is an error when its turn comes; what has neither may be anybody's.
    sets = {a: list(groups[a]) for a, roles in own_roles.items() if {"normal", "roughness"} & (roles - decided)}
    taken = {file for several in sets.values() for file in several}
    for file in images:
        if file not in taken:
            words = _key(asset_words(stems[file]), stems[file])
            asset = max((a for a in sets if a and words.startswith(a)), key=len, default=None)
            if asset is not None:
                sets[asset].append(file)
    shown = {_shown(asset, [stems[file] for file in groups[asset]]): tuple(sorted(own)) for asset, own in sets.items()}
    return dict(sorted(shown.items(), key=lambda each: each[0].casefold()))


def resolved(options: LoadOptions, files: Sequence[Path], what: str) -> LoadOptions:
    """Options with the file in place of every pattern, for one set, which messages call `what`; a role whose pattern
    matches none of its files is left to the names of the others. InputError where a pattern matches several of them."""
    maps: dict[str, MapChoice] = {}
    for role, choice in options.maps.items():
        if not _is_pattern(choice):
            maps[role] = choice
            continue
        text = str(choice)
        channels = CHANNELS.search(text)
        found = [file for file in files if _expression(role, text).fullmatch(file.name)]
        if len(found) > 1:
            raise InputError(
                f"--map {role}={text} matches {listed(file.name for file in found)} of {what}: expected one file for "
                "each set"
            )
        if found:
            maps[role] = f"{found[0]}{channels[0] if channels else ''}"
    return replace(options, maps=maps)


def _is_pattern(choice: MapChoice) -> bool:
    return isinstance(choice, (str, os.PathLike)) and _STAR in os.fspath(choice) and not Path(choice).exists()


def _expression(role: str, text: str) -> re.Pattern[str]:
    """A regular expression for the names of files that a pattern stands for."""
    bare = CHANNELS.sub("", text)
    if bare.count(_STAR) != 1 or "/" in bare:
        raise UsageError(f"--map {role}={text} is not a pattern of files: expected the name of a file with * once")
    before, after = (re.escape(part) for part in bare.split(_STAR))
    # Of tiles the name holds <UDIM>, as elsewhere.
    return re.compile(PLACEHOLDER.sub(r"(?:1\\d{3}|u\\d+_v\\d+)", f"{before}(?P<name>.*){after}"), re.IGNORECASE)


def _key(words: str, stem: str) -> str:
    """Equal for files of one set: its words, and the letters of other scripts, which are in no word."""
    return "".join(letter for letter in stem.lower() if letter.isalnum() and not letter.isascii()) + words


def _compete(groups: Sequence[Iterable[NameMatch]], decided: set[str]) -> bool:
    """Whether files of two groups would fill one role of a set, none of them preferred."""
    for role in set(SHADING_ROLES) - decided:
        several = ([m.rank for match in group for m in match.meanings if m.role == role] for group in groups)
        best = [min(ranks) for ranks in several if ranks]
        if best and best.count(min(best)) > 1:
            return True
    return False


def _shown(asset: str, stems: Sequence[str]) -> str:
    """The name of a set as its files have it, with capitals and separators; empty for files of a role's name alone."""
    for stem in stems:
        for end in range(1, len(stem) + 1):
            found = "".join(re.findall(r"[A-Za-z0-9]", stem[:end])).lower()
            if _key(found, stem[:end]) == asset:
                return stem[:end]
    return asset
