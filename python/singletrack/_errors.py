"""The errors of the package."""

from __future__ import annotations


class SingletrackError(Exception):
    """The car can't be driven or asked; the text says why."""


class ArmError(SingletrackError):
    """The car was not armed; the text is the supervisor's reason."""


class Rejected(SingletrackError):
    """A set-point was not obeyed.

    ``word`` is the reason in one word: ``not-finite``, ``out-of-range``, ``future``, ``old``,
    ``sequence``, ``not-external``, ``other-source`` (another program gives set-points) or
    ``invalid``.
    """

    def __init__(self, text: str, word: str) -> None:
        super().__init__(text)
        self.word = word
