"""`mipbake presets`: what each preset chooses."""

from __future__ import annotations

from typing import Annotated

import typer

from mipbake.cli.commands import JSON
from mipbake.cli.session import Session
from mipbake.cli.tables import table
from mipbake.material.aim import SAMPLERS
from mipbake.stack.presets import PRESETS, Preset


def presets(context: typer.Context, json: Annotated[bool, JSON] = False) -> None:
    """Show what each preset of `mipbake bake --preset` chooses. docs/engines says why, and how to import the files."""
    session: Session = context.obj
    session.configure(False, json)
    rows = table("preset", "for", "target", "sampler", "formats", "packing", "normals", "sides")
    for preset in PRESETS.values():
        rows.add_row(*_row(preset))
    rows.columns[3].max_width = max(map(len, SAMPLERS)) + 2  # words of long names below each other
    rows.columns[4].min_width = max(len(output.format) for preset in PRESETS.values() for output in preset.outputs)
    documents = [preset.name for preset in PRESETS.values() if preset.documents]
    session.print(
        rows,
        f"a glTF source becomes a GLB: {', '.join(documents)}",
        "target auto: gltf-anisotropic for sets with an anisotropy map, else gltf",
        *(f"in {preset.engine}: {note}" for preset in PRESETS.values() for note in preset.notes),
    )
    session.dump({"presets": dict(PRESETS)})


def _row(preset: Preset) -> tuple[str, ...]:
    first = preset.outputs[0]
    normals = first.normals.convention + (" xy" if first.normals.channels == 2 else "")
    formats = ", ".join(output.format for output in preset.outputs)
    aimed = preset.target, str(preset.sampler)
    return preset.name, preset.engine, *aimed, formats, first.packing, normals, preset.sides or "any"
