"""MaterialX documents: reading the XML safely, and following an input to what it is connected to.

MaterialX 1.38 and 1.39, specification (https://materialx.org/Specification.html): elements, inputs, node graphs,
interface names, file prefixes and colour spaces.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeAlias
from xml.etree import ElementTree

from mipbake.base import disk
from mipbake.base.errors import InputError

Element: TypeAlias = "ElementTree.Element[str]"

MAX_BYTES = 16 << 20
"""Far more than a document that points at textures needs."""

_MOST = 64  # connections, or node graphs, in a row

_INCLUDE = "{http://www.w3.org/2001/XInclude}include"
_SHARED = ("colorspace", "fileprefix")


@dataclass(frozen=True)
class Scope:
    """Where names are looked up: the document or a node graph, and for a custom node what its inputs are given."""

    container: Element
    instance: Element | None = None
    outside: Scope | None = None


@dataclass(frozen=True)
class Value:
    """An input with a value: its text, and the element that gives it."""

    text: str
    element: Element


@dataclass(frozen=True)
class Link:
    """An input that is connected to a node: its output by name, if any, and swizzles in the order they apply in."""

    node: Element
    scope: Scope
    output: str = ""
    channels: tuple[str, ...] = ()


class UnreadError(Exception):
    """What an input is connected to is not there, or cannot be read; the sentence says why."""


@dataclass(frozen=True)
class Document:
    """A parsed document with its includes.

    Args:
        root: its top element, which also holds the elements of included files. parents: of every element.
        folders: folders that names in an element are relative to, of the top elements that came from included files.
        notes: what was found, in sentences.
        within: folder that everything which it names has to lie in; None for any.
    """

    path: Path
    root: Element
    parents: dict[Element, Element] = field(default_factory=dict)
    folders: dict[Element, Path] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    within: Path | None = None

    @property
    def scope(self) -> Scope:
        """The scope of the document itself."""
        return Scope(self.root)

    def lineage(self, element: Element) -> Iterator[Element]:
        """The element and all that it lies in, outwards."""
        current: Element | None = element
        while current is not None:
            yield current
            current = self.parents.get(current)

    def attribute(self, name: str, element: Element) -> tuple[str, Element] | None:
        """An attribute that elements inherit from those around them: its value and who has it."""
        return next(((e.attrib[name], e) for e in self.lineage(element) if name in e.attrib), None)

    def file_of(self, value: Value) -> Path:
        """The path that a filename input means, with the nearest prefix around it; relative to the document that holds
        it, else to the main one. InputError where it lies elsewhere than it may."""
        prefix = self.attribute("fileprefix", value.element)
        name = (prefix[0] if prefix else "") + value.text.strip()
        folders = [folder for e in self.lineage(value.element) if (folder := self.folders.get(e)) is not None]

        def allowed(text: str) -> list[Path]:
            places = (folder / text for folder in (*folders, self.path.parent))
            return [path for path in places if self.within is None or disk.lies_in(path, self.within)]

        # Exporters on Windows write backslashes, which elsewhere are letters of a name.
        slashed = allowed(name.replace("\\", "/"))
        if not slashed:
            raise self.outside(name)
        return next((path for path in (*allowed(name), *slashed) if disk.exists(path)), slashed[0])

    def outside(self, name: str) -> InputError:
        """What is said of a file outside the folder that all has to lie in."""
        return InputError(f"{self.path} names {name!r}, which is outside {self.within}: do not trust it")

    def given(self, node: Element, name: str, scope: Scope) -> Value | Link | None:
        """What an input of a node is given; None where it is left at its default. UnreadError where it is connected to
        what is not there."""
        entry = _named(node, name, ("input",))
        return None if entry is None else self._resolved(entry, scope)

    def source_of(self, link: Link) -> Link:
        """A link to a node graph, or to a node that the document itself defines by one, followed to the node inside."""
        for _ in range(_MOST):
            graph, scope = link.node, Scope(link.node, None, link.scope)
            if graph.tag != "nodegraph":
                definition = self._definition(link.node)
                if definition is None:
                    return link
                graph, scope = definition, Scope(definition, link.node, link.scope)
            outputs = [e for e in graph if e.tag == "output"]
            chosen = [e for e in outputs if e.get("name") == link.output] or (outputs[:1] if not link.output else [])
            if not chosen:
                lacking = f"the output {link.output or '(none)'} of {graph.get('name')}"
                raise UnreadError(f"{lacking}, which it does not have")
            inner = self._resolved(chosen[0], scope)
            if not isinstance(inner, Link):
                raise UnreadError(f"an empty output of {graph.get('name')}")
            link = Link(inner.node, inner.scope, inner.output, inner.channels + link.channels)
        raise UnreadError("a loop of node graphs")

    def _definition(self, node: Element) -> Element | None:
        """The node graph in this document that implements a node of its own; None for nodes of the library."""
        wanted = node.get("nodedef")
        for definition in self.root.iterfind("nodedef"):
            name = definition.get("name")
            if definition.get("node") == node.tag and wanted in (None, name):
                return next((g for g in self.root.iterfind("nodegraph") if g.get("nodedef") == name), None)
        return None

    def _resolved(self, entry: Element, scope: Scope, depth: int = 0) -> Value | Link | None:
        """What an input or output element is given."""
        if depth > _MOST:
            raise UnreadError("a loop of connections")
        if "interfacename" in entry.attrib:
            return self._interface(entry.attrib["interfacename"], scope, depth)
        wanted = entry.get("nodename") or entry.get("nodegraph")
        output = entry.get("output", "")
        if wanted:
            # A graph's own inputs may be fed by nodes beside the graph; names may carry the document's namespace.
            place: Scope | None = scope
            while place is not None:
                node = _named(place.container, wanted, None)
                if node is not None:
                    channels = entry.get("channels")
                    return Link(node, place, output, (channels,) if channels else ())
                place = place.outside
            raise UnreadError(f"{wanted}, which is not there")
        if output:  # an output of the document
            shared = _named(self.root, output, ("output",))
            if shared is None:
                raise UnreadError(f"the output {output}, which is not there")
            return self._resolved(shared, self.scope, depth + 1)
        return Value(entry.attrib["value"], entry) if "value" in entry.attrib else None

    def _interface(self, name: str, scope: Scope, depth: int) -> Value | Link | None:
        """What an input of the node graph or custom node around is given: there, or by its definition."""
        wanted = scope.container.get("nodedef")
        definitions = [d for d in self.root.iterfind("nodedef") if wanted is not None and d.get("name") == wanted]
        holders = [e for e in (scope.instance, scope.container, *definitions) if e is not None]
        entry = next((e for holder in holders if (e := _named(holder, name, ("input",))) is not None), None)
        if entry is None:
            raise UnreadError(f"the interface {name}, which is not there")
        return self._resolved(entry, scope.outside or self.scope, depth + 1)


def read_document(path: Path, within: Path | None = None) -> Document:
    """A MaterialX document with the documents that it includes, one level deep, each once. `within`: see `Document`.
    InputError where it cannot be read, is too large or no MaterialX of 1.38 or 1.39, or an include is missing."""
    root = _parsed(path)
    document = Document(path, root, within=within)
    read = {disk.resolved(path)}
    for include in [e for e in root if e.tag == _INCLUDE]:
        at = list(root).index(include)
        root[at : at + 1] = _included(document, include.get("href", ""), read)
    document.parents.update((child, parent) for parent in root.iter() for child in parent)
    return document


def _included(document: Document, href: str, read: set[Path]) -> list[Element]:
    """The elements of an included document, which keep its folder, prefix and colour space; none where it was `read`
    before."""
    name = href.replace("\\", "/")
    path = document.path.parent / name
    if not name or "://" in name or Path(name).is_absolute():
        raise InputError(f"{document.path} includes {href!r}: expected the relative path of a .mtlx file")
    if document.within is not None and not disk.lies_in(path, document.within):
        raise document.outside(href)
    if not disk.is_file(path):
        raise InputError(f"{document.path} includes {href}, which is not there: expected {path}")
    if disk.resolved(path) in read:
        return []
    read.add(disk.resolved(path))
    inner = _parsed(path)
    document.notes.append(f"{document.path.name}: includes {href}")
    elements = []
    for element in inner:
        if element.tag == _INCLUDE:
            document.notes.append(f"{href}: what it includes itself ({element.get('href')}) is not followed")
            continue
        document.folders[element] = path.parent
        for shared in _SHARED:
            if shared in inner.attrib:
                element.attrib.setdefault(shared, inner.attrib[shared])
        elements.append(element)
    return elements


class _NoDoctype(ElementTree.TreeBuilder):
    """Refuses document types: they are of no use in MaterialX, and the entities that they define can fill memory."""

    def doctype(self, *_: object) -> None:
        raise UnreadError


def _parsed(path: Path) -> Element:
    with disk.opened(path, "a MaterialX document") as file:
        data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise InputError(f"{path} is larger than {MAX_BYTES >> 20} MiB: expected a MaterialX document")
    try:
        root: Element = ElementTree.fromstring(data, ElementTree.XMLParser(target=_NoDoctype()))
    except ElementTree.ParseError as error:
        reason = str(error).split(":")[0]
        raise InputError(
            f"{path} is damaged in line {error.position[0]} ({reason}): expected XML of MaterialX; export it again"
        ) from error
    except UnreadError:
        raise InputError(f"{path} declares a document type, which MaterialX does not have: remove <!DOCTYPE>") from None
    except (LookupError, ValueError) as error:  # encodings that Python does not know
        raise InputError(f"{path} is in an encoding that cannot be read ({error}): save it as UTF-8") from error
    if root.tag != "materialx":
        raise InputError(f"{path} holds <{root.tag}>: expected a MaterialX document")
    version = root.get("version", "")
    if version and not version.startswith(("1.38", "1.39")):
        raise InputError(f"{path} is MaterialX {version}: expected 1.38 or 1.39, save it again with a newer version")
    return root


def _named(parent: Element, name: str, tags: tuple[str, ...] | None) -> Element | None:
    """The child of that name, with or without its namespace; of some tags, or anything but an input or output."""
    for wanted in (name, name.rpartition(":")[2]):
        for child in parent:
            kind = child.tag in tags if tags else child.tag not in ("input", "output", "nodedef")
            if kind and child.get("name") == wanted:
                return child
    return None
