"""What files are asked for: container, texels, packing, normals and names."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

from mipbake.base.errors import UsageError
from mipbake.source.images.quantise import fits
from mipbake.source.layout import ENCODINGS, LAYOUTS, FileLayout, to_file
from mipbake.source.tiles import name_without, text_of
from mipbake.stack.block_weights import BlockWeights
from mipbake.stack.container import Container
from mipbake.stack.containers import DEFAULT_FORMAT, FORMATS, format_named
from mipbake.stack.map_files import Levels, MapFile, row_blocks
from mipbake.stack.packing import SEPARATE, SOURCE, Normals, pack
from mipbake.stack.stack import MipStack

BLOCK = 4
"""Texels along a side of a block."""


@dataclass(frozen=True)
class Output:
    """One set of files of a stack.

    Args:
        format: `FORMAT` or `FORMAT:TEXELS`, as `mipbake.stack.containers.FORMATS` lists them; the first texels of a
            format are its default.
        packing: a name in `mipbake.stack.packing.PACKINGS`.
        normals: how normal maps are written.
        naming: pattern of file names: {set} is the set's name, {file} the file's.
        names: what {file} is for a file of a packing or a map, where that is not its own name.
    """

    format: str = DEFAULT_FORMAT
    packing: str = SOURCE
    normals: Normals = field(default_factory=Normals)
    naming: str = "{file}"
    names: Mapping[str, str] = field(default_factory=dict)

    @property
    def container(self) -> Container:
        """The container of the files, unless `planned` finds that their values or sides want another one."""
        return format_named(self.format)


GLB = "glb"
"""The name of glTF files for users. They are not a container of single maps."""

GLB_TEXELS = ("uastc", "rgba8")
"""Texels of a GLB's textures, the default first. KHR_texture_basisu allows for no others; some engines load them."""


def check_outputs(outputs: Sequence[Output], model: str) -> None:
    """UsageError where an output cannot hold stacks of a material model, or two would write the same files."""
    for output in outputs:
        container = output.container
        for layout in LAYOUTS[model]:
            if not container.encodings.issuperset(layout.encodings):
                raise UsageError(
                    f"format {container.name}:{container.texels} cannot hold the map {layout.name} of the model "
                    f"{model}: its logarithms do not fit in 8 or 16 bits, use format {DEFAULT_FORMAT} or another target"
                )
    formats = [output.container.name for output in outputs]
    if len(set(formats)) < len(formats):
        raise UsageError(f"{', '.join(formats)}: expected every format once, files would have the same names")


def planned(output: Output, content: MipStack, levels: int | None = None, beside: bool = False) -> list[MapFile]:
    """The files of an output.

    Args:
        output: what is asked for.
        content: what the files are to hold. The name of a file carries the UDIM tile where the name in the source has
            it, else at the end.
        levels: so many of each file; None for all. Containers whose files always hold every level get all.
        beside: whether there are other outputs: then files whose values no texels of the container hold are left to
            them.

    A file with values outside 0 to 1 (emission, heights) takes half floats where its texels would be integers and the
    container has them. Where the format names no texels, a file whose sides are not whole blocks takes texels without
    blocks.
    """
    files = []
    packing = SEPARATE if output.packing == SOURCE and not content.source_files else output.packing
    for packed, chain in pack(content.maps(), packing, content.source_files, output.normals, content.wrap):
        named = replace(packed, name=_name(output, content.name, packed, content.tile))
        container = output.container
        if output.format == container.name and not whole_blocks(chain):
            container = _without_blocks(container)
        container = _fitting(container, named, chain)
        if beside and not packed.shades and container.encodings != ENCODINGS and not _fits(container, named, chain):
            continue
        weights = None
        if not container.exact and packed.shades:
            weights = BlockWeights(content.model, content.levels, packed, container.srgb(packed), {})
        files.append(MapFile(container, named, chain if container.complete else chain[:levels], weights))
    return files


def _name(output: Output, set_name: str, packed: FileLayout, tile: int) -> str:
    file = output.names.get(packed.name, packed.name)
    if not tile:
        return output.naming.format(set=set_name, file=file)
    name = output.naming.format(set=name_without(set_name, tile), file=file)
    return name if text_of(f"{file}.", tile) else f"{name}.{tile}"


def whole_blocks(levels: Levels) -> bool:
    """Whether level 0 is made of whole blocks of 4 x 4 texels, as Direct3D, WebGL and WebGPU want it."""
    return not any(side % BLOCK for side in levels[0].shape[:2])


def block_warnings(outputs: Sequence[Output], content: MipStack, names_texels: bool = True) -> list[str]:
    """A sentence for each output with files of blocks that some sizes do not fill.

    `names_texels`: whether outputs count whose format names their texels.
    """
    odd = [chain[0].shape[1::-1] for _, chain in content.maps() if not whole_blocks(chain)]
    said = []
    for output in outputs if odd else ():
        container = output.container
        size = f"files of {' x '.join(map(str, odd[0]))} texels"
        plain = f"{container.name}:{_without_blocks(container).texels}"
        if container.exact:
            continue
        if output.format == container.name:
            said.append(
                f"{output.format}: {size} are not compressed, because Direct3D, WebGL and WebGPU take blocks only with "
                f"sides that are multiples of {BLOCK}: resize the maps to have them compressed"
            )
        elif names_texels:
            said.append(
                f"{output.format}: {size} are made of blocks, and Direct3D, WebGL and WebGPU take such files only with "
                f"sides that are multiples of {BLOCK}: resize the maps, or use --format {plain}"
            )
    return said


def _without_blocks(container: Container) -> Container:
    """The container with the smallest texels that are not compressed."""
    return next(each for each in FORMATS[container.name].values() if each.exact)


def _fitting(container: Container, layout: FileLayout, levels: Levels) -> Container:
    """The container, or the one of half floats for values that integers cannot hold."""
    if container.encodings == ENCODINGS or _fits(container, layout, levels):
        return container
    return FORMATS[container.name].get("rgba16f") or FORMATS[container.name].get("half") or container


def _fits(container: Container, layout: FileLayout, levels: Levels) -> bool:
    """Whether integers can hold the levels of a file."""
    srgb = container.srgb(layout)
    return all(fits(to_file(block, layout.encodings, srgb)) for level in levels for block in row_blocks(level))
