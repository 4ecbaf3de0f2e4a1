"""Meshes that users name, and renders that are kept."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from mipbake.base.errors import InputError, OutputError, UsageError
from mipbake.comparing.meshes import render_file, shapes
from mipbake.comparing.meshes.camera import orbit
from mipbake.comparing.meshes.mesh_file import read_mesh
from mipbake.comparing.meshes.mesh_render import Frame, Reference
from mipbake.quality import environment

from .mesh_files import Gltf, attributes_of, obj_text
from .mesh_renders import candidate


def test_a_mesh_from_a_file_renders_as_the_one_in_memory(tmp_path: Path) -> None:
    mesh = shapes.material_ball(4)
    made = Gltf()
    attributes = attributes_of(mesh)
    made.primitive(attributes, mesh.triangles.astype(np.uint32).ravel())
    rng = np.random.default_rng(4)
    level = np.tile(np.array([0.5, 0.4, 0.3, 0.5, 0.4, 0, 0, 1], np.float32), (8, 8, 1))
    level[..., :5] *= rng.uniform(0.3, 1, (8, 8, 5))
    level[..., 5:7] = rng.uniform(-0.4, 0.4, (8, 8, 2))
    level[..., 7] = np.sqrt(1 - (level[..., 5:7] ** 2).sum(-1))
    scene = (orbit(4, 30, 20), environment.studio(8), [level], "gltf", ("wrap", "wrap"), (48, 64))
    expected = candidate(mesh, *scene).image
    (tmp_path / "x.obj").write_text(obj_text(mesh))
    for path in (made.write(tmp_path / "x"), tmp_path / "x.obj"):
        found = candidate(read_mesh(path), *scene).image
        assert np.abs(found - expected).mean() < 1e-3 * expected.mean()


def test_files_that_are_no_meshes_are_refused_in_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.obj cannot be read \(No such file or directory\): expected a mesh"):
        read_mesh(tmp_path / "none.obj")
    (tmp_path / "folder.glb").mkdir()
    with pytest.raises(InputError, match=r"folder\.glb is a folder"):
        read_mesh(tmp_path / "folder.glb")
    (tmp_path / "mesh.fbx").write_text("")
    with pytest.raises(InputError, match=r"ends in \.obj, \.gltf, \.glb, so convert it to glTF"):
        read_mesh(tmp_path / "mesh.fbx")
    (tmp_path / "noise.obj").write_bytes(bytes(range(256)) * 4)
    with pytest.raises(InputError, match="no triangles"):
        read_mesh(tmp_path / "noise.obj")


def rendered(seed: int = 0) -> tuple[Frame, Reference]:
    """Random renders, with rows turned over as `mesh_render` turns them."""
    rng = np.random.default_rng(seed)

    def image(*channels: int) -> Any:
        return rng.normal(0.3, 1, (20, 30, *channels)).astype(np.float32)[::-1]

    frame = Frame(image(3), image() > 0, image(2), image())
    return frame, Reference(image(3), image(3), image() > 0.4, 64, 1.25e-3, 2e-2, True)


def write(path: Path, frame: Frame, reference: Reference, **attributes: str) -> None:
    names = {"method": "linear (box)", "pixel_filter": "gaussian", "source_hash": "0a" * 32}
    render_file.write_render(path, frame, reference, **names, attributes=attributes)


EXPECTED = {
    "candidate": lambda frame, reference: {**rgb(frame.image), "A": frame.coverage},
    "reference": lambda frame, reference: rgb(reference.image),
    "error": lambda frame, reference: {**rgb(frame.image - reference.image), "interior": reference.interior},
    "lod": lambda frame, reference: {"lod": frame.lod},
    "uv": lambda frame, reference: {"u": frame.uv[..., 0], "v": frame.uv[..., 1]},
}
SAID = {"method": "linear (box)", "pixel_filter": "gaussian", "source_hash": "0a" * 32, "passes": 64, "converged": 1}
SAID |= {"lighting": "studio"}


def rgb(image: Any) -> dict[str, Any]:
    return dict(zip("RGB", np.moveaxis(image, -1, 0), strict=True))


def test_a_render_comes_back_from_its_file_part_by_part(tmp_path: Path) -> None:
    import OpenEXR

    frame, reference = rendered()
    write(tmp_path / "render.exr", frame, reference, lighting="studio")
    assert [path.name for path in tmp_path.iterdir()] == ["render.exr"]
    with OpenEXR.File(str(tmp_path / "render.exr"), separate_channels=True) as file:
        assert [part.name() for part in file.parts] == list(EXPECTED)
        for part in file.parts:
            expected = EXPECTED[part.name()](frame, reference)
            assert set(part.channels) == set(expected)
            for name, channel in part.channels.items():
                assert channel.pixels.dtype == np.float32 and np.array_equal(channel.pixels, expected[name])
            header = part.header
            assert {name: header[f"mipbake:{name}"] for name in SAID} == SAID
            assert header["mipbake:standard_error"] == pytest.approx(1.25e-3)
            assert header["compression"] == OpenEXR.ZIP_COMPRESSION
            if part.name() in ("lod", "uv"):
                assert "chromaticities" not in header
            else:
                assert header["chromaticities"] == pytest.approx((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329))


def test_openimageio_sees_every_part_of_a_render(tmp_path: Path) -> None:
    import OpenImageIO

    frame, reference = rendered(1)
    write(tmp_path / "render.exr", frame, reference)
    assert OpenImageIO.ImageBuf(str(tmp_path / "render.exr")).nsubimages == len(EXPECTED)
    for index, (name, parts) in enumerate(EXPECTED.items()):
        image = OpenImageIO.ImageBuf(str(tmp_path / "render.exr"), index, 0)
        spec, pixels = image.spec(), image.get_pixels(OpenImageIO.FLOAT).reshape(20, 30, -1)
        assert spec.get_string_attribute("oiio:subimagename") == name
        space = "data" if name in ("lod", "uv") else "lin_rec709_scene"
        assert spec.get_string_attribute("oiio:ColorSpace") == space
        expected = parts(frame, reference)
        assert set(spec.channelnames) == set(expected)
        for channel, at in zip(spec.channelnames, range(spec.nchannels), strict=True):
            assert np.array_equal(pixels[..., at], expected[channel])


def test_equal_renders_give_equal_files_and_replace_earlier_ones(tmp_path: Path) -> None:
    write(tmp_path / "a.exr", *rendered(0))
    write(tmp_path / "b.exr", *rendered(1))
    assert (tmp_path / "a.exr").read_bytes() != (tmp_path / "b.exr").read_bytes()
    write(tmp_path / "b.exr", *rendered(0))
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_a_render_that_cannot_be_written_says_why_and_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(OutputError, match=r"none/render\.exr: No such file or directory, check"):
        write(tmp_path / "none" / "render.exr", *rendered())
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match=r"render\.exr: Not a directory"):
        write(tmp_path / "file" / "render.exr", *rendered())
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(OutputError, match=r"folder\.exr: Is a directory"):
        write(tmp_path / "folder.exr", *rendered())
    frame, reference = rendered()
    with pytest.raises(UsageError, match="the candidate is 30 x 20 pixels: expected the reference's 30 x 10"):
        write(tmp_path / "x.exr", frame, Reference(reference.first[:10], reference.second[:10], reference.interior[:10],
                                                   64, 0, 0, True))  # fmt: skip

    import OpenEXR

    # A library that cuts files off, and one that stores something else: an earlier file stays as it is.
    write(tmp_path / "earlier.exr", frame, reference)
    earlier = (tmp_path / "earlier.exr").read_bytes()
    part, file = OpenEXR.Part, OpenEXR.File

    def cut_off(parts: Any) -> Any:
        def write(path: str) -> None:
            file(parts).write(path)
            Path(path).write_bytes(Path(path).read_bytes()[:-100])

        return SimpleNamespace(write=write)

    def without(parts: Any) -> Any:
        return file([each for each in parts if each.name() != "uv"])

    def other(header: Any, channels: Any, name: str) -> Any:
        return part(header, {"lod": channels["lod"] + 1} if name == "lod" else channels, name)

    def silent(header: Any, channels: Any, name: str) -> Any:
        return part({key: value for key, value in header.items() if not key.startswith("mipbake:")}, channels, name)

    def when_written(spoilt: Any) -> Any:
        return lambda given, **settings: spoilt(given) if isinstance(given, list) else file(given, **settings)

    faults = [("Part", other), ("Part", silent), *(("File", when_written(spoilt)) for spoilt in (cut_off, without))]
    for name, fault in faults:
        monkeypatch.undo()
        monkeypatch.setattr(OpenEXR, name, fault)
        with pytest.raises(OutputError, match=r"earlier\.exr \("):
            write(tmp_path / "earlier.exr", *rendered(5))
        assert (tmp_path / "earlier.exr").read_bytes() == earlier
    assert sorted(path.name for path in tmp_path.iterdir()) == ["earlier.exr", "file", "folder.exr"]
