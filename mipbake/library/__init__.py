"""A library of texture sets, baked by several processes; what has not changed since the last time is left as it is."""

from __future__ import annotations

from mipbake.library.listing import Entry, Library, Shard, entries_below, found_library
from mipbake.library.project import COMMAND_LINE, TEMPLATE, Chosen, Project, read_project, settings_of
from mipbake.library.results import BatchListener, EntryResult, Summary
from mipbake.library.run import BatchOptions, bake_library, watch_library

__all__ = [
    "COMMAND_LINE",
    "TEMPLATE",
    "BatchListener",
    "BatchOptions",
    "Chosen",
    "Entry",
    "EntryResult",
    "Library",
    "Project",
    "Shard",
    "Summary",
    "bake_library",
    "entries_below",
    "found_library",
    "read_project",
    "settings_of",
    "watch_library",
]
