"""The project file of a library, `mipbake.toml`: where it lies, and how its sets are read and baked.

Every option of `mipbake bake` that is about sets stands in it under the name that it has there, without the dashes.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import Path, PurePosixPath
from typing import Any

from mipbake.baking.options import BakeOptions
from mipbake.base import disk, memory, toml_text
from mipbake.base.errors import UsageError
from mipbake.base.messages import listed
from mipbake.base.names import unknown
from mipbake.base.options import options_of
from mipbake.source.layout import PROJECT
from mipbake.source.options import LoadOptions

COMMAND_LINE = "command line"

_TOPS = frozenset(map(PurePosixPath, (".", "/")))
"""Folders around everything: a pattern such as [!m]* is not about them."""

_BAKE, _READ = ({each.name: name for name, each in options_of(of).items()} for of in (BakeOptions, LoadOptions))
_WRAP = ("wrap-u", "wrap-v")
_MAP = "map"
OPTIONS = (*_BAKE, *_READ, *_WRAP, _MAP)
"""Names of options for sets."""

_ABOUT = {"library": str, "out": str, "jobs": int, "memory": str}
_TYPES: Mapping[str, tuple[type, ...]] = {
    **dict.fromkeys(_WRAP, (str,)),
    **{
        each.name: (int, float) if each.kind is float else (each.kind,)
        for of in (BakeOptions, LoadOptions)
        for each in options_of(of).values()
    },
    _MAP: (dict,),
}
_WORDS = {str: "text in quotes", int: "a whole number", float: "a number", bool: "true or false", dict: "a table"}


@dataclass(frozen=True)
class Setting:
    """What an option is set to, and where that was said."""

    value: Any
    origin: str


Settings = Mapping[str, Setting]


@dataclass(frozen=True)
class Rule:
    """Options for the sets whose label, or a folder around them, a pattern matches.

    Args:
        origin: where the patterns stand.
    """

    patterns: tuple[str, ...]
    settings: Settings
    origin: str = ""

    def applies(self, label: str) -> bool:
        """Whether it is about an entry of that label.

        In patterns, * stands for any text, with slashes in it too, ? for a character, and [ab] for one of some.
        """
        return any(_matches(label, pattern) for pattern in self.patterns)


def _matches(label: str, pattern: str) -> bool:
    around = (str(folder) for folder in PurePosixPath(label).parents if folder not in _TOPS)
    return any(fnmatchcase(each, pattern) for each in (label, *around))


@dataclass(frozen=True)
class Chosen:
    """How an entry is read and baked.

    Args:
        options, load: what it means. settings: what was said, by option.
    """

    options: BakeOptions
    load: LoadOptions
    settings: Settings = field(default_factory=dict)


@dataclass(frozen=True)
class Project:
    """What a project file says.

    Args:
        library: the folder that is baked. out: the folder of all results.
        jobs: processes at most. memory: bytes; None for the default.
        settings: options for all sets. rules: for some, the later before the earlier.
    """

    library: Path
    out: Path
    jobs: int | None = None
    memory: int | None = None
    settings: Settings = field(default_factory=dict)
    rules: tuple[Rule, ...] = ()

    def chosen(self, label: str, given: Settings | None = None) -> Chosen:
        """How an entry is read and baked.

        Args:
            given: what counts more than the file, by option.

        Raises:
            UsageError: an option has a value that it cannot have; the sentence says where it was said.
        """
        merged: dict[str, Setting] = {}
        for settings in (self.settings, *(r.settings for r in self.rules if r.applies(label)), given or {}):
            for option, setting in settings.items():
                before = merged.get(option)
                if option == _MAP and before is not None:  # role by role
                    merged[option] = replace(setting, value={**before.value, **setting.value})
                else:
                    merged[option] = setting
        return chosen(merged)

    def idle(self, labels: Sequence[str]) -> list[str]:
        """Sentences on patterns that none of these labels matches."""
        return [
            f"{rule.origin}: {pattern!r} matches none of {len(labels)} {'source' if len(labels) == 1 else 'sources'}"
            for rule in self.rules
            for pattern in rule.patterns
            if not any(_matches(label, pattern) for label in labels)
        ]


def chosen(settings: Settings) -> Chosen:
    """What options mean. UsageError for a value that cannot be; the sentence says where it was said."""
    try:
        return _chosen(settings)
    except UsageError as error:
        blamed = [
            each.origin
            for option, each in settings.items()
            if each.origin != COMMAND_LINE and _fault({o: s for o, s in settings.items() if o != option}) != str(error)
        ]
        where = f"{listed(dict.fromkeys(blamed))}: " if blamed else ""
        raise UsageError(f"{where}{error}") from error


def _fault(settings: Settings) -> str:
    """What is wrong with settings; "" where nothing is."""
    try:
        _chosen(settings)
    except UsageError as error:
        return str(error)
    return ""


def _chosen(settings: Settings) -> Chosen:
    bake: dict[str, Any] = {}
    read: dict[str, Any] = {}
    wrap = list(LoadOptions().wrap)
    for option, setting in settings.items():
        if option in _BAKE:
            bake[_BAKE[option]] = setting.value
        elif option in _WRAP:
            wrap[_WRAP.index(option)] = setting.value
        elif option == _MAP:
            read["maps"] = {role: _map_source(source) for role, source in setting.value.items()}
        else:
            read[_READ[option]] = setting.value
    options = BakeOptions(**bake)
    load = LoadOptions(**read, wrap=(wrap[0], wrap[1]))
    options.plan()
    return Chosen(options, load, settings)


def _map_source(source: object) -> Any:
    """What fills a role, as `--map` takes it."""
    if not isinstance(source, str):
        return source
    if source.lower() == "none":
        return None
    try:
        return float(source)
    except ValueError:
        return source


def settings_of(options: BakeOptions, load: LoadOptions, names: Collection[str], origin: str) -> Settings:
    """Options as settings: the fields of these names, and `wrap_u`, `wrap_v`, `gloss` and `maps`."""
    found: dict[str, Any] = {option: getattr(options, field) for option, field in _BAKE.items() if field in names}
    found |= {option: getattr(load, field) for option, field in _READ.items() if {field, option} & set(names)}
    found |= {option: load.wrap[at] for at, option in enumerate(_WRAP) if option.replace("-", "_") in names}
    if "maps" in names:
        found[_MAP] = {role: "none" if source is None else source for role, source in load.maps.items()}
    return {option: Setting(value, origin) for option, value in found.items()}


def read_project(path: Path) -> Project:
    """What a project file says.

    Args:
        path: the file, or the folder that it lies in. The folders in it are relative to its own.

    Raises:
        InputError: it cannot be read. UsageError: it is no TOML, or says what cannot be; the sentence has the line.
    """
    file = path / PROJECT if disk.is_dir(path) else path
    text = disk.read_bytes(file, "a project file, as `mipbake init` writes it")
    try:
        source = _Source(file, text.decode("utf-8-sig"))
        content = toml_text.parsed(source.text)
    except UnicodeDecodeError as error:
        raise UsageError(f"{file} is not UTF-8 text: save it as UTF-8") from error
    except ValueError as error:
        raise UsageError(f"{file} is not TOML: {error}; correct it there") from error
    return _project(source, content)


@dataclass(frozen=True)
class _Source:
    """The text of a project file, which says where something stands."""

    path: Path
    text: str

    @cached_property
    def lines(self) -> Mapping[tuple[str | int, ...], int]:
        """Keys, from the outermost to the innermost, to their lines. Tables of a list are counted."""
        found: dict[tuple[str | int, ...], int] = {}
        counts: dict[tuple[str | int, ...], int] = {}
        table: tuple[str | int, ...] = ()
        begun, part = 1, ""
        for number, line in enumerate(self.text.split("\n"), 1):
            begun, part = (begun, f"{part}\n{line}") if part else (number, line)
            try:
                content = toml_text.parsed(part)
            except ValueError:
                continue  # a value of several lines goes on
            if content and part.lstrip().startswith("["):
                table = ()
                while isinstance(content, dict) and content:
                    if table in counts:
                        table = (*table, counts[table])
                    [(key, content)] = content.items()
                    table = (*table, key)
                if isinstance(content, list):
                    counts[table] = counts.get(table, -1) + 1
                    table = (*table, counts[table])
                found.setdefault(table, begun)
            else:
                for path in _paths(content):
                    found.setdefault((*table, *path), begun)
            part = ""
        return found

    def at(self, *keys: str | int) -> str:
        """The file, and the line in which a key is set; of a key in braces or brackets, where they begin."""
        line = next((self.lines[keys[:n]] for n in range(len(keys), 0, -1) if keys[:n] in self.lines), None)
        return self.path.name if line is None else f"{self.path.name}, line {line}"

    def fail(self, message: str, *keys: str | int) -> UsageError:
        return UsageError(f"{self.at(*keys)}: {message}")


def _paths(table: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """The keys of a table, and of tables in it."""
    for key, value in table.items():
        yield (key,)
        if isinstance(value, dict):
            yield from ((key, *path) for path in _paths(value))


def _project(source: _Source, content: Mapping[str, Any]) -> Project:
    known = (*_ABOUT, "options", "sets")
    for key, value in content.items():
        if key not in known:
            raise source.fail(unknown("key", key, known), key)
        expected = _ABOUT.get(key)
        if expected is not None and (not isinstance(value, expected) or isinstance(value, bool)):
            raise source.fail(f"{key} is {value!r}: expected {_WORDS[expected]}", key)
    for key in ("library", "out"):
        if key not in content:
            raise UsageError(f"{source.path.name} has no {key}: expected {key} = a folder, relative to that file")
    jobs = content.get("jobs")
    if jobs is not None and jobs < 1:
        raise source.fail(f"jobs is {jobs}: expected 1 or more", "jobs")
    most = None
    if "memory" in content:
        try:
            most = memory.parsed(content["memory"])
        except UsageError as error:
            raise source.fail(error.full, "memory") from error
    options, sets = content.get("options", {}), content.get("sets", [])
    if not isinstance(options, dict):
        raise source.fail("options is no table: expected [options]", "options")
    if not isinstance(sets, list) or not all(isinstance(each, dict) for each in sets):
        raise source.fail("sets is no list of tables: expected [[sets]]", "sets")
    folder = source.path.parent
    project = Project(
        folder / content["library"],
        folder / content["out"],
        jobs,
        most,
        _settings(source, options, "options"),
        tuple(_rules(source, sets)),
    )
    # What is wrong by itself is said before any set is looked at. What does not go together may never meet in a set.
    for settings in (project.settings, *(rule.settings for rule in project.rules)):
        for option, setting in settings.items():
            chosen({option: setting})
    chosen(project.settings)
    return project


def _rules(source: _Source, sets: Sequence[Mapping[str, Any]]) -> Iterator[Rule]:
    for index, table in enumerate(sets):
        match = table.get("match")
        patterns = [match] if isinstance(match, str) else match
        if not isinstance(patterns, list) or not patterns or not all(isinstance(each, str) for each in patterns):
            where = ("sets", index) if match is None else ("sets", index, "match")
            raise source.fail('a table of sets has no match: expected match = "metals/*", or a list of such', *where)
        others = {key: value for key, value in table.items() if key != "match"}
        yield Rule(tuple(patterns), _settings(source, others, "sets", index), source.at("sets", index, "match"))


def _settings(source: _Source, table: Mapping[str, Any], *keys: str | int) -> dict[str, Setting]:
    found = {}
    for option, value in table.items():
        if option not in OPTIONS:
            raise source.fail(unknown("option", option, sorted(OPTIONS)), *keys, option)
        types = _TYPES[option]
        if not isinstance(value, types) or (isinstance(value, bool) and bool not in types):
            raise source.fail(f"{option} is {value!r}: expected {_WORDS[types[-1]]}", *keys, option)
        found[option] = Setting(value, source.at(*keys, option))
    return found


TEMPLATE = """\
# How `mipbake bake` bakes a library: run it in this folder, or name this file with --config.
# `mipbake inspect --config` says what applies to a set, and where that is said.

library = "{library}"   # the folder that is baked, with everything below it
out = "{out}"           # the folder of all results
# jobs = 2              # so many sets at once
# memory = "8G"         # what all of them together hold to

# Options for all sets: the options of `mipbake bake`, under their names without the dashes.
[options]
# preset = "unreal"
# method = "auto"
# strength = 1.0

# Options for some sets. `match` is a pattern for their paths below the library, or for a folder around them; * stands
# for any text. Tables that come later count more.
# [[sets]]
# match = "metals/*"
# strength = 0.8
# normal-convention = "directx"

# [[sets]]
# match = ["decals/*", "signs/*"]
# wrap-u = "clamp"
# wrap-v = "clamp"
# map.roughness = "*_Rgh.png"   # which file is which map, where its name does not tell
"""
"""What `mipbake init` writes."""
