"""What the URIs of a glTF file lead to: data within them, and files beside it (specification, section 2.8)."""

from __future__ import annotations

import base64
import binascii
import contextlib
import posixpath
import re
import urllib.parse
from pathlib import Path

from mipbake.base import disk
from mipbake.base.errors import InputError

_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:")  # longer than a letter: C: is a drive


def is_remote(uri: str) -> bool:
    """Whether a URI names a scheme other than data, so that it is not a file beside the document."""
    return bool(_SCHEME.match(uri)) and not _is_data(uri)


def read_uri(uri: str, document: Path, what: str, within: bool = True) -> bytes:
    """The bytes that a URI of a document stands for: a data URI, or a path relative to the document's folder,
    percent-encoded. InputError for damaged data, a missing file, a path out of the folder or an address in a network.

    Args:
        what: what it should be, for messages ("image 3 (bark)").
        within: whether the file must lie within the document's folder. Exporters write ../textures, and what is not an
            image is refused later; other bytes of files elsewhere must not get into what is written.
    """
    if _is_data(uri):
        return _data(uri, document, what)
    if is_remote(uri) or any(_leaves(text, within) for text in spellings(uri)):
        raise InputError(
            f"{what} of {document} lies at {_short(uri)}: expected a path relative to the file, within its folder, so "
            "put the file beside the document, and name it by that path"
        )
    named = _existing(uri, document)
    if named is None:
        raise InputError(
            f"{what} of {document} is the file {_short(urllib.parse.unquote(uri))}, which does not exist beside it: "
            "copy it there too, or export as GLB"
        )
    return disk.read_bytes(named)


def file_of(uri: object, document: Path, within: Path, what: str) -> Path | None:
    """The file that a URI leads to; None where it leads to none. InputError where it leads out of the folder `within`;
    nothing there is looked at."""
    if not isinstance(uri, str) or _is_data(uri) or is_remote(uri):
        return None
    if not all(disk.lies_in(document.parent / text, within) for text in spellings(uri)):
        raise InputError(f"{what} of {document} lies at {_short(uri)}, which is outside {within}: do not trust it")
    return _existing(uri, document)


def _is_data(uri: str) -> bool:
    return uri[:5].lower() == "data:"


def spellings(uri: str) -> tuple[str, ...]:
    """The paths that a URI can mean, the likeliest first: decoded, and as it stands, because some exporters forget to
    encode; then both with slashes for the backslashes that exporters on Windows write."""
    literal = (urllib.parse.unquote(uri), uri)
    return tuple(dict.fromkeys((*literal, *(text.replace("\\", "/") for text in literal))))


def _leaves(path: str, within: bool) -> bool:
    """Whether a path is absolute, or leads out of the folder that it is relative to where it shall lie `within`."""
    steps = posixpath.normpath(path.replace("\\", "/"))
    out = within and steps.split("/", 1)[0] == ".."
    return out or steps.startswith("/") or bool(re.match(r"[A-Za-z]:[\\/]", path))


def _existing(uri: str, document: Path) -> Path | None:
    """The file of the first spelling that is one."""
    for text in spellings(uri):
        path = document.parent / text
        with contextlib.suppress(InputError):  # a name that is too long, as a data URI would be that lost its start
            if disk.is_file(path):
                return path
    return None


def _data(uri: str, document: Path, what: str) -> bytes:
    header, comma, body = uri[5:].partition(",")
    if not comma:
        raise InputError(f"{what} of {document} is a data URI without data: expected data:TYPE;base64,...")
    if not header.lower().endswith(";base64"):
        return urllib.parse.unquote_to_bytes(body)
    try:
        # Some writers percent-encode the padding.
        return base64.b64decode(urllib.parse.unquote_to_bytes(body), validate=True)
    except binascii.Error as error:
        raise InputError(
            f"{what} of {document} is a data URI whose base64 is damaged ({error}): export or download it again"
        ) from error


def _short(text: str) -> str:
    return repr(text if len(text) <= 120 else text[:117] + "...")
