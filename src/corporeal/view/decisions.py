"""What a curator decided, as a history that can be undone."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Verdict = Literal["accept", "reject"]


@dataclass
class DecisionHistory:
    """Decisions in the order in which they were made; the last one of a scan counts.

    Attributes:
        current: name of a scan -> "accept" or "reject".
    """

    current: dict[str, Verdict] = field(default_factory=dict)
    _made: list[tuple[str, Verdict | None]] = field(default_factory=list)

    @classmethod
    def replayed(cls, entries: Iterable[Mapping[str, Any]]) -> DecisionHistory:
        """The history that these entries of a log tell.

        Raises:
            ValueError: an entry is no decision; the message tells which it is.
        """
        history = cls()
        for number, entry in enumerate(entries, start=1):
            history._apply(number, entry)
        return history

    def entry_for(self, name: str, verdict: Verdict) -> dict[str, Any]:
        """The entry that says a verdict; it takes effect with ``record``."""
        return {"name": name, "decision": verdict}

    def entry_for_undo(self) -> dict[str, Any] | None:
        """The entry that takes the last decision back, or None where there is none.

        A scan that had been decided differently before gets that verdict again, since the last entry of a
        scan counts; "undo" says that it is undecided again.
        """
        if not self._made:
            return None
        name, before = self._made[-1]
        return {"name": name, "decision": before or "undo", "takes_back": True}

    def record(self, entry: Mapping[str, Any]) -> None:
        """Let an entry take effect."""
        self._apply(len(self._made) + 1, entry)

    def _apply(self, number: int, entry: Mapping[str, Any]) -> None:
        name, decision = entry.get("name"), entry.get("decision")
        if not isinstance(name, str) or decision not in ("accept", "reject", "undo"):
            raise ValueError(f"entry {number} is no decision: expected a name and accept, reject or undo")
        before = self.current.get(name)
        if decision == "undo":
            self.current.pop(name, None)
        else:
            self.current[name] = decision
        if decision == "undo" or entry.get("takes_back"):
            if self._made and self._made[-1][0] == name:
                self._made.pop()
        else:
            self._made.append((name, before))
