"""Writes MaterialX documents and their textures for tests."""

from __future__ import annotations

from pathlib import Path

from mipbake.source.mtlx.materials import MtlxMaterial, read_materialx

from .input_files import pixels_for, write_image

ROLES_OF_FILES = {
    "color": "base_color",
    "normal": "normal",
    "rough": "roughness",
    "orm": "packed",
    "rgba": "packed_alpha",
}
ROLES_OF_FILES |= {"metal": "metallic", "height": "height", "mask": "opacity", "glow": "emissive"}


def write_textures(folder: Path) -> Path:
    """A texture of every kind, beside where the document goes."""
    for stem, role in ROLES_OF_FILES.items():
        write_image(folder / f"{stem}.png", pixels_for(role, 16))
    return folder


def document(folder: Path, body: str, attributes: str = 'version="1.38"', name: str = "wood.mtlx") -> Path:
    path = folder / name
    path.write_text(f'<?xml version="1.0"?>\n<materialx {attributes}>\n{body}\n</materialx>\n', encoding="utf-8")
    return path


def image(name: str, kind: str, file: str, attributes: str = "", tag: str = "image", inputs: str = "") -> str:
    return (
        f'<{tag} name="{name}" type="{kind}"><input name="file" type="filename" value="{file}" {attributes}/>'
        f"{inputs}</{tag}>"
    )


def link(name: str, node: str, kind: str = "float", rest: str = "") -> str:
    return f'<input name="{name}" type="{kind}" nodename="{node}" {rest}/>'


def value(name: str, text: str, kind: str = "float") -> str:
    return f'<input name="{name}" type="{kind}" value="{text}"/>'


def node(tag: str, name: str, kind: str, *inputs: str) -> str:
    return f'<{tag} name="{name}" type="{kind}">{"".join(inputs)}</{tag}>'


def material(shader: str, *inputs: str, name: str = "Wood", rest: str = "") -> str:
    return (
        f'<{shader} name="SR_{name}" type="surfaceshader">{"".join(inputs)}</{shader}>'
        f'<surfacematerial name="{name}" type="material">'
        f'<input name="surfaceshader" type="surfaceshader" nodename="SR_{name}"/>{rest}</surfacematerial>'
    )


def surface(*nodes: str, **inputs: str) -> str:
    """A standard_surface whose roughness is rough.png, and nodes whose outputs fill further inputs."""
    linked = [link(key, target) for key, target in ({"specular_roughness": "rough"} | inputs).items()]
    return image("rough", "float", "rough.png") + "".join(nodes) + material("standard_surface", *linked)


def only(path: Path) -> MtlxMaterial:
    (found,) = read_materialx(path).materials
    return found


def short(found: MtlxMaterial, folder: Path) -> dict[str, object]:
    """The maps that are filled, names relative to the folder."""
    prefix = f"{folder}/"
    return {
        role: choice.removeprefix(prefix) if isinstance(choice, str) else choice
        for role, choice in found.options.maps.items()
        if choice is not None
    }
