"""Level 0 of a texture set in another material model: texel by texel and unfiltered, or as a network fits it.

A converted material lies in a folder: `material.json`, which declares every convention, and the maps beside it, one
file each. It is not a MIP stack: there is one level. What is converted to `gltf` or
`gltf-anisotropic` is a texture set again.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mipbake import material
from mipbake.baking.bake import bake
from mipbake.base.errors import InputError, UsageError
from mipbake.base.names import known_name
from mipbake.base.publish import check_place
from mipbake.base.version import __version__
from mipbake.material import MODELS, model_named
from mipbake.material.directions import untangled
from mipbake.source.layout import LAYOUTS, MATERIAL_MANIFEST, MATERIAL_SCHEMA, extra_layout
from mipbake.source.loading import PathLike, as_texture_set
from mipbake.source.texture_set import TextureSet
from mipbake.stack.container import Container
from mipbake.stack.containers import DEFAULT_FORMAT, IMAGE_FORMATS
from mipbake.stack.manifest import declared
from mipbake.stack.map_files import (
    CONVENTIONS,
    MapFile,
    check_same_sources,
    described,
    is_result_folder,
    read_files,
    save_maps,
    write_files,
)
from mipbake.stack.packing import unpacked

MATERIAL_SCHEMA_VERSION = 2

ANALYTIC = "analytic"
"""The rule of `mipbake.material.convert`, texel by texel."""

LEARNED = "neural"
"""The rule that an encoder of one model and a decoder of another make, with the pixel filter in it."""


@dataclass(frozen=True)
class Conversion:
    """How a material was converted. It holds no times and no machine: the same conversion gives the same files.

    Args:
        source_model: material model that it was given in.
        rule: what converted it.
        tool_version: version of mipbake.
        sources: source file name to SHA-256 of its bytes.
        source_hash: one hash of everything that the material was made from.
        warnings: what a user should know, in sentences.
        weights, weights_sha256, pixel_filter: of the learned rule; None for the analytic rule.
    """

    source_model: str
    rule: str = ANALYTIC
    tool_version: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    source_hash: str = ""
    warnings: tuple[str, ...] = ()
    weights: str | None = None
    weights_sha256: str | None = None
    pixel_filter: str | None = None


@dataclass(frozen=True, eq=False)
class Material:
    """A material at full resolution, in one material model.

    Args:
        name: the texture set's name.
        model: a name in `mipbake.material.MODELS`.
        stored: (H, W, C) float32 stored channels.
        extra: the maps that do not shade, by role: (h, w, 1 to 4) float32, at their own sizes.
        wrap: addressing along u and v, each "wrap" or "clamp".
        provenance: how it was converted.

    Raises:
        UsageError: on construction, when model or shapes are not as described, or a value is not finite.
    """

    name: str
    model: str
    stored: NDArray[np.float32]
    extra: Mapping[str, NDArray[np.float32]]
    wrap: tuple[str, str]
    provenance: Conversion

    def __post_init__(self) -> None:
        """Checks the shapes."""
        channels = model_named(self.model).channels
        for what, image in (("the material", self.stored), *self.extra.items()):
            expected = (channels,) if image is self.stored else (1, 2, 3, 4)
            if image.ndim != 3 or image.dtype != np.float32 or image.shape[-1] not in expected or not image.size:
                raise UsageError(f"{what} is {image.dtype} {image.shape}: expected float32 (H, W, {channels})")
            if not np.isfinite(image).all():
                raise UsageError(f"{what} holds values that are not finite: expected none")

    def __repr__(self) -> str:
        """A description in one line."""
        height, width = self.stored.shape[:2]
        beside = f", {', '.join(self.extra)} beside" if self.extra else ""
        return f"Material({self.name!r}, {self.model}, {width} x {height}{beside})"

    def save(
        self,
        path: str | Path,
        format: str = DEFAULT_FORMAT,
        progress: Callable[[float], None] = lambda _share: None,
    ) -> list[Path]:
        """Writes the material into the folder `path` and reads every map back to compare.

        The folder appears under its name when it is complete. An earlier material of the same source files is replaced;
        a folder that holds anything else is left alone. Missing parent folders are made.

        Args:
            path: the folder; its last part need not be the material's name.
            format: a name in `mipbake.stack.containers.IMAGE_FORMATS`. Values are rounded to what it stores.
            progress: gets the finished share, from 0 to 1.

        Returns:
            The files, material.json first.

        Raises:
            UsageError: an unknown format, or one that cannot hold this material.
            OutputError: the folder cannot be written, or holds the material of other source files.
        """
        place, container = Path(path), image_container(self.model, format)
        check_material_output(place, self.provenance.sources)
        images = [(layout, self.stored[..., layout.channels]) for layout in LAYOUTS[self.model]]
        images += [(extra_layout(role, image.shape[-1]), image) for role, image in self.extra.items()]
        maps = [MapFile(container, layout.alone, [image]) for layout, image in images]
        write = write_files(maps, self.wrap, json.dumps({"model": self.model, "rule": self.provenance.rule}), progress)
        files = save_maps(place, MATERIAL_MANIFEST, self._manifest(maps), write, is_material_folder)
        progress(1.0)
        return files

    def _manifest(self, files: Sequence[MapFile]) -> dict[str, Any]:
        height, width = self.stored.shape[:2]
        return {
            "schema": MATERIAL_SCHEMA,
            "schema_version": MATERIAL_SCHEMA_VERSION,
            "name": self.name,
            "model": self.model,
            "width": width,
            "height": height,
            "wrap": {"u": self.wrap[0], "v": self.wrap[1]},
            "parametrisation": MODELS[self.model].formula,
            "format": files[0].container.name,
            "conventions": {**CONVENTIONS, "normal_convention": "OpenGL"},
            "maps": described(files),
            "provenance": {**asdict(self.provenance), "sources": dict(self.provenance.sources)},
        }


def convert(
    source: TextureSet | Material | PathLike, target: str, weights: str | None = None, device: str | None = None
) -> Material:
    """Converts level 0 to another material model.

    By default a formula converts texel by texel, and nothing is filtered: what the models share is kept to rounding,
    and what the target cannot represent becomes the nearest that it can; see `mipbake.material`. With weights, a
    decoder of the target makes level 0 from the encoded source (Kemppinen et al. 2023, section 3.5): it is fitted to
    how the surface reflects under the pixel filter, which is then in it. Maps that do not shade are kept as they are.

    Args:
        source: from `mipbake.load`, or what it takes, such as a folder; or, without weights, a material that was
            converted before.
        target: a material model in `mipbake.material.MODELS`.
        weights: trained weights that read the source's model and make the target; None for the analytic rule.
        device: where the network of the weights runs, as `mipbake.bake` takes it; None for the processor.

    Raises:
        UsageError: an unknown target or weights, weights that do not make it, weights with a converted material, a
            device that cannot be used, or a device without weights.
    """
    model_named(target)
    check_device(weights, device)
    if not isinstance(source, Material):
        source = as_texture_set(source)
    if isinstance(source, Material):
        if weights is not None:
            raise UsageError(
                f"weights can convert texture sets only, and {source.name} is a material that was converted"
            )
        given, extra, stored = source.provenance, source.extra, source.stored
        made = Conversion(source.model, ANALYTIC, __version__, given.sources, given.source_hash, given.warnings)
    else:
        extra = {role: texture.pixels for role, texture in source.plain_maps.items()}
        sources = {t.source.path.name: t.source.sha256 for t in source.maps.values() if t.source.path is not None}
        model = source.source_model
        made = Conversion(model, ANALYTIC, __version__, sources, source.source_hash, source.warnings)
        if weights is not None:
            stack = bake(source, LEARNED, target, weights=weights, device=device)
            by = stack.provenance
            made = replace(made, rule=LEARNED, weights=by.weights, weights_sha256=by.weights_sha256)
            made = replace(made, pixel_filter=by.pixel_filter)
            return Material(source.name, target, stack.levels[0], extra, source.wrap, made)
        stored = source.material(model)
    converted = material.convert(stored, made.source_model, target)
    if target != made.source_model:
        converted = material.regularise(converted, target)
    lines = MODELS[target].lines
    if lines is not None:
        converted[..., lines.channels] = untangled(converted[..., lines.channels], source.wrap)
    return Material(source.name, target, np.ascontiguousarray(converted, np.float32), extra, source.wrap, made)


def check_device(weights: str | None, device: str | None) -> None:
    """UsageError where a device is given and no network: a formula converts on the processor."""
    if device is not None and weights is None:
        raise UsageError("a conversion without weights takes no device: name weights, or leave the device out")


def image_container(model: str, format: str) -> Container:
    """The container of that name for maps of one level; UsageError when there is none or it cannot hold the model."""
    container = IMAGE_FORMATS[known_name("format", format, IMAGE_FORMATS)]
    for layout in LAYOUTS[model]:
        if not container.encodings.issuperset(layout.encodings):
            raise UsageError(
                f"format {format} cannot hold the map {layout.name} of the model {model}: its logarithms do not fit in "
                f"{container.texels} bits, use format {DEFAULT_FORMAT} or another model"
            )
    return container


def is_material_folder(path: Path) -> bool:
    """Whether a folder holds a converted material and nothing else."""
    return is_result_folder(path, [path / MATERIAL_MANIFEST], MATERIAL_SCHEMA)


def check_material_output(path: str | Path, sources: Mapping[str, str] | None = None) -> None:
    """Raises OutputError when a material cannot be saved to the folder `path`; leaves nothing there.

    Args:
        path: the folder that `Material.save` would be given.
        sources: source file name to SHA-256, empty where the file has not been read yet: a material that shares no
            source file with them is in the way. None leaves that to `Material.save`.
    """
    place = Path(path)
    check_place(place, is_material_folder)
    if sources is not None and is_material_folder(place):
        check_same_sources([place / MATERIAL_MANIFEST], "material", sources)


def open_material(path: str | Path) -> Material:
    """Reads a material that `Material.save` wrote, whatever its format.

    Raises:
        InputError: no material there, a map that is missing or broken, or a schema of a later version.
    """
    folder = Path(path)
    file = folder / MATERIAL_MANIFEST
    manifest = declared(file, "material", "convert", MATERIAL_SCHEMA, MATERIAL_SCHEMA_VERSION)
    try:
        title = str(manifest["name"])
        if title in ("", ".", "..") or any(mark in title for mark in "/\\\0"):  # the name of its own folder
            raise ValueError(f"{title!r} is not the name of a material")
        model = model_named(manifest["model"]).name
        container = image_container(model, manifest["format"])
        found = read_files({container.texels: container}.__getitem__, folder, manifest["maps"])
        images = {name: level for name, (level,) in unpacked([(f.layout, f.levels) for f in found], model).items()}
        provenance = manifest["provenance"]
        made = Conversion(**{**provenance, "warnings": tuple(provenance["warnings"])})
        wrap = (str(manifest["wrap"]["u"]), str(manifest["wrap"]["v"]))
        stored = np.concatenate([images.pop(layout.name) for layout in LAYOUTS[model]], -1)
        if not {*wrap} <= {"wrap", "clamp"}:
            raise ValueError(f"wrap is {wrap}: expected wrap or clamp along u and v")
        return Material(title, model, stored, images, wrap, made)
    except (KeyError, TypeError, ValueError, AttributeError, UsageError) as error:
        raise InputError(f"{file} does not describe a material ({error}): convert it again") from error


TARGETS = tuple(MODELS)
"""The material models that can be converted to."""
