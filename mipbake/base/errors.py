"""The errors that mipbake raises on purpose.

Each message is one sentence that says what is wrong, where, what was expected and what to do. The command line
prints it without a traceback and exits with the class's code; anything else that escapes is a defect.
"""

from __future__ import annotations

LONGEST = 290
"""Letters of a message at most: with `mipbake: ` before it, it is a line of less than 300."""

_WORD, _GAP = 60, "..."


def shortened(message: str) -> str:
    """A message of at most `LONGEST` letters. Long words, which are paths and names of others, lose their middle first;
    then the message does, so that it still says at the end what to do."""
    words = message.split(" ")
    while (excess := sum(map(len, words)) + len(words) - 1 - LONGEST) > 0:
        index = max(range(len(words)), key=lambda at: len(words[at]))
        if len(words[index]) <= _WORD:
            break
        words[index] = without_middle(words[index], max(_WORD, len(words[index]) - excess))
    return without_middle(" ".join(words), LONGEST)


def without_middle(text: str, most: int) -> str:
    end = (most - len(_GAP)) // 2
    return text if len(text) <= most else text[: most - len(_GAP) - end] + _GAP + text[-end:]


class MipbakeError(Exception):
    """Base of every error that a user can cause; never raised itself."""

    exit_code: int = 1

    @property
    def full(self) -> str:
        """The message as it was raised, however long the names in it are."""
        return super().__str__()

    def __str__(self) -> str:
        """The message in one line of bounded length. Lines that follow it stay as they are."""
        sentence, *lines = self.full.split("\n")
        return "\n".join([shortened(sentence), *lines])

    def __format__(self, spec: str) -> str:
        """The full message: one that holds another one is shortened as a whole."""
        return format(self.full, spec)


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
