"""KTX 2 and DDS files that are none, are incomplete or count wrongly: told in a sentence that names the file."""

from __future__ import annotations

import errno
import struct
import tracemalloc
from pathlib import Path

import pytest

from mipbake.base.errors import InputError, OutputError
from mipbake.base.publish import replaced_file
from mipbake.source.images import dds, ktx2
from mipbake.source.images.gpu_format import GPU_FORMATS

from .gpu_textures import texture

GIVEN = texture(GPU_FORMATS["R8G8B8A8_SRGB"], 12, 5)


def told(data: bytes, name: str = "a.ktx2") -> str:
    """What is said of it."""
    reader = ktx2.decoded if name.endswith("ktx2") else dds.decoded
    with pytest.raises(InputError) as caught:
        reader(data, name)
    assert name in str(caught.value) and "\n" not in str(caught.value)
    return str(caught.value)


def changed(data: bytes, place: int, value: int, kind: str = "<I") -> bytes:
    copy = bytearray(data)
    struct.pack_into(kind, copy, place, value)
    return bytes(copy)


@pytest.mark.parametrize("supercompress", [False, True])
def test_no_part_of_a_file_is_a_file(supercompress: bool) -> None:
    whole = ktx2.encoded(GIVEN, supercompress)
    for end in range(0, len(whole), 3):
        told(whole[:end])
    whole = dds.encoded(GIVEN)
    for end in range(0, len(whole), 3):
        told(whole[:end], "a.dds")


@pytest.mark.parametrize(
    ("place", "value", "part"),
    [
        (12, 24, "Vulkan format 24"),
        (20, 0, "0 x 5 texels: expected a texture of two dimensions"),
        (24, 0, "12 x 0 texels: expected a texture of two dimensions"),
        (28, 2, "holds a 3D texture of 2 slices: extract one slice as an image of its own (ktx extract --depth 0)"),
        (32, 2, "holds an array of 2 layers: extract one layer as an image of its own (ktx extract --layer 0)"),
        (36, 6, "holds a cube map of 6 faces: extract one face as an image of its own (ktx extract --face 0)"),
        (40, 0, "0 levels: 12 x 5 texels have 1 to 4"),
        (40, 5, "5 levels"),
        (40, 2**32 - 1, "levels"),
        (20, 65540, "65540 x 5 texels"),
        (24, 2**31, "65536 along a side"),
        (44, 1, "supercompression scheme BasisLZ"),
        (44, 3, "is not a zlib stream"),
        (44, 7, "supercompression scheme 7"),
        (20, 16, "level 0"),
        (48, 2**31, "ends within its header"),
    ],
)
def test_fields_of_ktx2(place: int, value: int, part: str) -> None:
    assert part in told(changed(ktx2.encoded(GIVEN, False), place, value))


@pytest.mark.parametrize("supercompress", [False, True])
@pytest.mark.parametrize("field", [0, 8, 16], ids=["offset", "length", "inflated"])
def test_index_of_levels(supercompress: bool, field: int) -> None:
    data = ktx2.encoded(GIVEN, supercompress)
    for level in range(4):
        for value in (2**63, 2**64 - 1):
            assert f"level {level}" in told(changed(data, 80 + 24 * level + field, value, "<Q"))


def test_streams_of_levels() -> None:
    data = bytearray(ktx2.encoded(GIVEN, True))
    (at,) = struct.unpack_from("<Q", data, 80)
    data[at : at + 4] = b"none"
    assert "level 0 of a.ktx2 is not a Zstandard stream" in told(bytes(data))


@pytest.mark.parametrize("told_size", [False, True])
def test_streams_that_inflate_to_more_are_not_inflated(told_size: bool) -> None:
    """A stream of 2 GiB in the place of level 0: no such amount of memory is asked for."""
    zstandard = pytest.importorskip("zstandard")
    packer = zstandard.ZstdCompressor(1, write_content_size=told_size)
    writer = packer.compressobj(2**31 if told_size else -1)
    block = bytes(2**24)
    stream = b"".join(writer.compress(block) for _ in range(2**7)) + writer.flush()
    data = ktx2.encoded(GIVEN, True)
    data = changed(changed(data, 80, len(data), "<Q"), 88, len(stream), "<Q") + stream
    tracemalloc.start()
    sentence = told(data)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert ("2147483648 bytes" if told_size else "more than 240 bytes") in sentence
    assert most < 2**22


def test_key_value_data() -> None:
    data = ktx2.encoded(GIVEN, False)
    values_at, length = struct.unpack_from("<2I", data, 56)
    assert "key-value data" in told(changed(data, values_at, 2**31))  # an entry longer than all of them
    assert "key-value data" in told(changed(data, 60, length - 8))  # cut within the last
    without_end = bytearray(data)
    without_end[values_at + 4 : values_at + 4 + len(b"KTXorientation\0rd\0")] = b"x" * len(b"KTXorientation\0rd\0")
    assert "key-value data" in told(bytes(without_end))


@pytest.mark.parametrize(
    ("place", "value", "part"),
    [
        (12, 0, "4 levels of 12 x 0 texels"),
        (16, 0, "4 levels of 0 x 5 texels"),
        (28, 5, "5 levels of 12 x 5 texels"),
        (112, 0xFE00, "holds a cube map: extract one face as an image of its own"),
        (112, 0x200000, "holds a 3D texture: extract one slice as an image of its own"),
        (84, int.from_bytes(b"DXT1", "little"), "older DDS header"),
        (128, 95, "DXGI format 95"),
        (128, 0, "DXGI format 0"),
        (132, 4, "holds a 3D texture: extract one slice"),
        (136, 4, "holds a cube map: extract one face"),
        (140, 6, "holds an array of 6 layers: extract one layer"),
        (16, 4096, "ends within level 0"),
    ],
)
def test_fields_of_dds(place: int, value: int, part: str) -> None:
    assert part in told(changed(dds.encoded(GIVEN), place, value), "a.dds")


@pytest.mark.parametrize(
    ("number", "part"),
    [(errno.EFBIG, "larger than"), (errno.EDQUOT, "quota"), (errno.ENOSPC, "disk is full"), (errno.EIO, "permissions")],
)
def test_reasons_have_sentences_of_their_own(tmp_path, monkeypatch, number: int, part: str) -> None:
    def refuse(*_: object) -> None:
        raise OSError(number, "no")

    monkeypatch.setattr(Path, "write_bytes", refuse)
    with pytest.raises(OutputError, match=part):
        replaced_file(tmp_path / "a.ktx2", b"")
