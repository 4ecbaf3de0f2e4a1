"""A library of texture sets, baked by several processes; what has not changed since the last time is left as it is."""

from __future__ import annotations

from mipbake.batch.finding import Shard
from mipbake.batch.library import Entry, Home, Library, entries_below, entries_of
from mipbake.batch.project import COMMAND_LINE, TEMPLATE, Chosen, Project, read_project, settings_of
from mipbake.batch.results import BatchListener, EntryResult, Summary
from mipbake.batch.run import BatchOptions, bake_library, watch_library

__all__ = [
    "COMMAND_LINE",
    "TEMPLATE",
    "BatchListener",
    "BatchOptions",
    "Chosen",
    "Entry",
    "EntryResult",
    "Home",
    "Library",
    "Project",
    "Shard",
    "Summary",
    "bake_library",
    "entries_below",
    "entries_of",
    "read_project",
    "settings_of",
    "watch_library",
]
