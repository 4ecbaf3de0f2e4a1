"""The errors that mipbake raises on purpose.

Each message is one sentence that says what is wrong, where, what was expected and what to do. The command line
prints it without a traceback and exits with the class's code; anything else that escapes is a defect.
"""

from __future__ import annotations


class MipbakeError(Exception):
    """Base of every error that a user can cause; never raised itself."""

    exit_code: int = 1


class UsageError(MipbakeError):
    """An option, argument or name that does not exist or contradicts another."""

    exit_code = 2


class InputError(MipbakeError):
    """A file or folder that cannot be read, or does not hold what a texture set must hold."""

    exit_code = 3


class OutputError(MipbakeError):
    """A result that cannot be written where it was asked for."""

    exit_code = 4


class RendererError(MipbakeError):
    """A renderer of a fit that failed, or gave something that is no frame.

    The last lines that a program printed follow the sentence, each in a line of its own.
    """

    exit_code = 6
