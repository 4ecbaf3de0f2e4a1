"""What was found in a texture set: its sources, and the facts that are told of it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from mipbake.source.jobs import Job
from mipbake.source.sources import Discovery, IgnoredFile, MapSource, NormalConvention
from mipbake.source.texture_set import TextureSet, source_model


@dataclass(frozen=True)
class SetReport:
    """The facts about a texture set, without its pixels.

    Args:
        name, width, height: of the set, in texels.
        model: the material model that its maps fill.
        maps: role to source. The path of a file in an archive begins with the path of the archive, as in `ignored`.
        normal_convention: of its normal map, and how that was decided.
        notes, warnings: what was assumed and what to look at, in sentences.
        ignored: what was left out.
    """

    name: str
    width: int
    height: int
    model: str
    maps: Mapping[str, MapSource]
    normal_convention: NormalConvention
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    ignored: tuple[IgnoredFile, ...]


def sources_of(found: Discovery | TextureSet) -> dict[str, MapSource]:
    """Role to source."""
    if isinstance(found, TextureSet):
        return {role: texture.source for role, texture in found.maps.items()}
    return dict(found.sources)


def file_hashes(found: Discovery | TextureSet) -> dict[str, str]:
    """Source file name to SHA-256, which is empty before the file is read."""
    return {source.path.name: source.sha256 for source in sources_of(found).values() if source.path}


def set_report(found: Discovery | TextureSet, job: Job | None = None) -> SetReport:
    """The facts about a texture set. `job`: that it is of, which knows the archive."""
    archive = job.archive if job else None
    sources, ignored = sources_of(found), found.ignored
    if archive is not None:
        sources = {r: replace(s, path=Path(archive.told(str(s.path)))) if s.path else s for r, s in sources.items()}
        ignored = tuple(replace(each, path=Path(archive.told(str(each.path)))) for each in ignored)
    return SetReport(
        name=found.name,
        width=found.width,
        height=found.height,
        model=source_model(found.anisotropic),
        maps=sources,
        normal_convention=found.convention,
        notes=found.notes,
        warnings=found.warnings,
        ignored=ignored,
    )
