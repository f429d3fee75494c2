"""A session being curated: which scan is shown, what the filters leave, and the next one loaded ahead."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from corporeal.view.decisions import Verdict
from corporeal.view.files import DecisionLog

ANY = "all"
DECIDED = (ANY, "undecided", "accepted", "rejected")
_KEPT = 6


@dataclass(frozen=True)
class CurationItem:
    """What is known of a scan without opening it.

    Attributes:
        name: of the scan in its session.
        status: ok, doubtful or failed.
        reason: the sentence that explains the status.
        subject: whose hand it is; "" where unknown.
        signals: (name, value) pairs to be shown.
    """

    name: str
    status: str
    reason: str
    subject: str
    signals: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, eq=False)
class ScanDisplay:
    """What is drawn of a scan: metres, x right, y up, z towards the viewer, about the origin.

    Attributes:
        points: of the scan.
        colours: of the points, by error or by skin.
        vertices: of the registration; none where there is none.
        faces: of the registration.
        note: what could not be shown, or "".
    """

    points: Float[np.ndarray, "N 3"]
    colours: UInt8[np.ndarray, "N 3"]
    vertices: Float[np.ndarray, "V 3"]
    faces: Int[np.ndarray, "F 3"]
    note: str = ""


class Curation:
    """Where the curator stands. Not thread-safe: one thread acts on it, loading goes on in another."""

    def __init__(
        self, items: Sequence[CurationItem], log: DecisionLog, load: Callable[[str], ScanDisplay]
    ) -> None:
        """Start at the first undecided scan.

        Args:
            items: the session; at least one.
            log: where decisions go.
            load: reads what is to be drawn of a scan; called in another thread, one call at a time.
        """
        self.items = {item.name: item for item in items}
        self.log = log
        self._load = load
        self._loader = ThreadPoolExecutor(max_workers=1, thread_name_prefix="preload")
        self._loaded: OrderedDict[str, Future[ScanDisplay]] = OrderedDict()
        self.show_only()
        undecided = (name for name in self.visible if name not in log.history.current)
        self.name = next(undecided, self.visible[0])

    def show_only(self, status: str = ANY, subject: str = ANY, decision: str = ANY) -> bool:
        """Filter; False and no change where nothing would be left."""
        wanted = {"accepted": "accept", "rejected": "reject", "undecided": None}
        current = self.log.history.current
        left = [
            item.name
            for item in self.items.values()
            if status in (ANY, item.status)
            and subject in (ANY, item.subject)
            and (decision == ANY or current.get(item.name) == wanted[decision])
        ]
        if not left:
            return False
        self.visible = left
        self.name = self.name if getattr(self, "name", None) in left else left[0]
        return True

    @property
    def position(self) -> int:
        """Index of the scan among the visible ones."""
        return self.visible.index(self.name)

    def verdict(self) -> Verdict | None:
        """What was decided of the scan that is shown."""
        return self.log.history.current.get(self.name)

    def go(self, name: str) -> None:
        """Show a scan; filters that hide it are lifted."""
        if name not in self.items:
            raise ValueError(f"no scan of the session is named {name!r}")
        self.name = name
        if name not in self.visible:
            self.show_only()

    def step(self, by: int) -> None:
        """Go on or back among the visible scans; the first and the last are ends."""
        self.name = self.visible[int(np.clip(self.position + by, 0, len(self.visible) - 1))]

    def decide(self, verdict: Verdict) -> None:
        """Write the decision, then go to the next scan."""
        self.log.decide(self.name, verdict)
        self.step(1)

    def undo(self) -> bool:
        """Take the last decision back and show its scan; False where there was none."""
        name = self.log.undo()
        if name is not None and name in self.items:
            self.go(name)
        return name is not None

    def display(self) -> ScanDisplay:
        """What is to be drawn of the scan; waits for it, and has the next one loaded meanwhile."""
        wanted = self._future(self.name)
        following = self.visible[self.position + 1 : self.position + 2]
        for name in following:
            self._future(name)
        while len(self._loaded) > _KEPT:
            self._loaded.popitem(last=False)[1].cancel()
        return wanted.result()

    def close(self) -> None:
        """Stop loading."""
        self._loader.shutdown(wait=True, cancel_futures=True)

    def _future(self, name: str) -> Future[ScanDisplay]:
        if name not in self._loaded:
            self._loaded[name] = self._loader.submit(self._load, name)
        self._loaded.move_to_end(name)
        return self._loaded[name]
