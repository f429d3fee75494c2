"""What a command raises when it cannot do what was asked."""

from __future__ import annotations


class CommandError(Exception):
    """A sentence for the user, and the exit status: 1 nothing could be done, 2 a wrong call."""

    def __init__(self, sentence: str, status: int = 1) -> None:
        super().__init__(sentence)
        self.status = status
