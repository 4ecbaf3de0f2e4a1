"""What integrations/unreal uses of the module `unreal`, by the names of Epic's Python API 5.1 to 5.7, and no others.

Assets are records of the properties that are set. A name that the API does not have raises, as the engine would.
"""

from __future__ import annotations

import struct
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any

_ENUMS = {
    "TextureMipGenSettings": ["TMGS_FROM_TEXTURE_GROUP", "TMGS_LEAVE_EXISTING_MIPS"],
    "CompositeTextureMode": ["CTM_DISABLED"],
    "TextureCompressionSettings": ["TC_DEFAULT", "TC_NORMALMAP", "TC_MASKS", "TC_HDR", "TC_BC7"],
    "TextureAddress": ["TA_WRAP", "TA_CLAMP", "TA_MIRROR"],
    "MaterialSamplerType": ["SAMPLERTYPE_COLOR", "SAMPLERTYPE_NORMAL", "SAMPLERTYPE_MASKS", "SAMPLERTYPE_LINEAR_COLOR"],
    "BlendMode": ["BLEND_OPAQUE", "BLEND_MASKED", "BLEND_TRANSLUCENT"],
    "MaterialProperty": [
        "MP_EMISSIVE_COLOR",
        "MP_OPACITY",
        "MP_OPACITY_MASK",
        "MP_BASE_COLOR",
        "MP_METALLIC",
        "MP_ROUGHNESS",
        "MP_NORMAL",
        "MP_AMBIENT_OCCLUSION",
    ],
}
_PROPERTIES = {
    "Texture2D": "address_x address_y composite_texture composite_texture_mode compression_settings flip_green_channel "
    "lod_bias mip_gen_settings srgb",
    "Material": "blend_mode opacity_mask_clip_value",
    "MaterialExpressionTextureSampleParameter2D": "parameter_name sampler_type texture",
    "AssetImportTask": "automated destination_path filename imported_object_paths replace_existing",
}


class Record:
    """An object of the engine: its editor properties, and for materials what feeds their inputs."""

    def __init__(self) -> None:
        self.properties: dict[str, Any] = {}
        self.feeds: dict[str, tuple[Record, str]] = {}
        self.material: Record | None = None
        self.saved = self.compiled = False

    def set_editor_property(self, name: str, value: object) -> None:
        assert name in _PROPERTIES[type(self).__name__].split(), name
        self.properties[name] = value

    def get_editor_property(self, name: str) -> Any:
        assert name in _PROPERTIES[type(self).__name__].split(), name
        return self.properties.get(name, [] if name == "imported_object_paths" else None)


def stand_in() -> Any:
    """A new module: `assets` by path, and `said`, lines of its log. It imports the DDS files that Unreal Engine can."""
    unreal: Any = ModuleType("unreal")
    unreal.assets, unreal.said = {}, []
    for name, members in _ENUMS.items():
        setattr(unreal, name, Enum(name, members))
    for name in _PROPERTIES:
        setattr(unreal, name, type(name, (Record,), {}))
    unreal.MaterialFactoryNew = type("MaterialFactoryNew", (), {})
    unreal.EditorAssetSubsystem = type("EditorAssetSubsystem", (), {})

    class Assets:
        def does_asset_exist(self, asset_path: str) -> bool:
            return asset_path in unreal.assets

        def save_loaded_asset(self, asset_to_save: Record, only_if_is_dirty: bool = True) -> bool:
            asset_to_save.saved = True
            return True

    class Tools:
        def import_asset_tasks(self, import_tasks: list[Record]) -> None:
            for task in import_tasks:
                file = Path(task.properties["filename"])
                if _dxgi(file) in (10, 28, 29):  # half floats, RGBA8, and RGBA8 with sRGB: what its importer takes
                    path = f"{task.properties['destination_path']}/{file.stem}".replace(".", "_")
                    unreal.assets.setdefault(path, unreal.Texture2D())
                    task.properties["imported_object_paths"] = [path]

        def create_asset(self, asset_name: str, package_path: str, asset_class: type, factory: object) -> Any:
            assert isinstance(factory, unreal.MaterialFactoryNew)
            return unreal.assets.setdefault(f"{package_path}/{asset_name}", asset_class())

    class Editing:
        @staticmethod
        def create_material_expression(
            material: Record, expression_class: type, node_pos_x: int, node_pos_y: int
        ) -> Any:
            node = expression_class()
            node.material = material
            return node

        @staticmethod
        def connect_material_property(from_expression: Record, from_output_name: str, property_: Enum) -> bool:
            assert from_output_name in ("RGB", "R", "G", "B", "A", "RGBA")
            assert isinstance(property_, unreal.MaterialProperty) and from_expression.material is not None
            from_expression.material.feeds[property_.name] = (from_expression, from_output_name)
            return True

        @staticmethod
        def recompile_material(material: Record) -> None:
            material.compiled = True

    unreal.get_editor_subsystem = lambda subsystem: {unreal.EditorAssetSubsystem: Assets()}[subsystem]
    unreal.AssetToolsHelpers = type("AssetToolsHelpers", (), {"get_asset_tools": staticmethod(Tools)})
    unreal.MaterialEditingLibrary = Editing
    unreal.load_asset = lambda name: unreal.assets[name]
    unreal.log = unreal.said.append
    unreal.log_error = lambda message: unreal.said.append(f"error: {message}")
    return unreal


def _dxgi(file: Path) -> int:
    """The format of the texels in a DDS file with the header of Direct3D 10."""
    data = file.read_bytes()
    assert data[:4] == b"DDS " and data[84:88] == b"DX10"
    return int(struct.unpack_from("<I", data, 128)[0])
