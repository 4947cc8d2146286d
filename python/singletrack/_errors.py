"""The errors of the package."""

from __future__ import annotations


class SingletrackError(Exception):
    """The car can't be driven or asked; the text says why."""


class ArmError(SingletrackError):
    """The car was not armed; the text is the supervisor's reason.

    ``code`` is the daemon's word for it, such as ``not-ready`` or ``not-commissioned``; ``None`` if
    the reason is not the daemon's.
    """

    def __init__(self, text: str, code: str | None = None) -> None:
        super().__init__(text)
        self.code = code


class Rejected(SingletrackError):
    """A set-point was not obeyed.

    ``word`` is the reason in one word: ``not-finite``, ``out-of-range``, ``future``, ``old``,
    ``sequence``, ``not-external``, ``other-source`` (another program gives set-points) or
    ``invalid``.
    """

    def __init__(self, text: str, word: str) -> None:
        super().__init__(text)
        self.word = word
