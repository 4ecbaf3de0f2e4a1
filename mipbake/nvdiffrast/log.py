"""Messages of `mipbake.nvdiffrast`, by Python's `logging`, with the severities that nvdiffrast numbers from 0 to 3."""

from __future__ import annotations

import logging
import operator
import sys

from mipbake.base.errors import UsageError

__all__ = ["LOGGER", "get_log_level", "set_log_level"]

LOGGER = logging.getLogger("mipbake.nvdiffrast")

_SEVERITIES = (logging.INFO, logging.WARNING, logging.ERROR, logging.CRITICAL)


class _Printer(logging.Handler):
    """Prints to the standard error, but leaves messages to a program that has handlers of its own."""

    def emit(self, record: logging.LogRecord) -> None:
        above = LOGGER.parent
        if LOGGER.handlers == [self] and not (above and above.hasHandlers()):
            print(f"{record.name}: {record.levelname.lower()}: {record.getMessage()}", file=sys.stderr)


if not LOGGER.handlers:
    LOGGER.addHandler(_Printer())
if LOGGER.level == logging.NOTSET:  # else the program has set it already
    LOGGER.setLevel(logging.WARNING)


def get_log_level() -> int:
    """The least severity of the messages that are printed.

    Returns:
        0 = info, 1 = warning, 2 = error, 3 = fatal. It is 1 unless the program has set it, with `set_log_level` or on
        the logger `mipbake.nvdiffrast` of Python's `logging`.
    """
    least = LOGGER.getEffectiveLevel()
    return min(sum(severity < least for severity in _SEVERITIES), len(_SEVERITIES) - 1)


def set_log_level(level: int) -> None:
    """Says which messages are printed; it sets the level of the logger `mipbake.nvdiffrast` of Python's `logging`.

    Messages go to the standard error, or to the program's own handlers of `logging` where there are any. An info says
    of each new context on which device it rasterises. A warning says, once in a process, that this is the processor
    because there is no graphics card. Errors are raised and never logged, so 2 and 3 silence everything.

    Args:
        level: 0 = info, 1 = warning, 2 = error, 3 = fatal: this severity and higher ones are printed.

    Raises:
        UsageError: level is no integer from 0 to 3.
    """
    try:
        number = -1 if isinstance(level, bool) else operator.index(level)
    except TypeError:
        number = -1
    if not 0 <= number < len(_SEVERITIES):
        raise UsageError(f"level is {level!r}: expected 0 (info), 1 (warning), 2 (error) or 3 (fatal)")
    LOGGER.setLevel(_SEVERITIES[number])
