"""A track being played: the frame, its vertices made ready ahead, the scans that are there."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32

from corporeal.view.ahead_cache import AheadCache
from corporeal.view.frame_clock import FrameClock
from corporeal.view.track import FrameRow, ShownScan, Track, problem_stretches

# A batch is posed in little more time than one frame alone: the correctives' matrix is read once for all.
BLOCK = 16
_BLOCKS_KEPT = 6
# Thinned to 20,000 points a scan takes 0.3 MB: 90 MB at most.
SCANS_KEPT = 300
# While it plays, a scan stands until the next one that was read in time, but not longer than this; seconds.
_STANDS = 0.5
_SLACK = 1.2


@dataclass(frozen=True, eq=False)
class PlayedFrame:
    """What is to be seen at a moment.

    Attributes:
        index: of the frame.
        row: what is known of it.
        vertices: (V, 3) of the model, metres.
        scan: of the frame ``scan_index``; None where none is there yet.
        scan_index: that of the frame, or while it plays, of one shortly before.
    """

    index: int
    row: FrameRow
    vertices: Float32[np.ndarray, "V 3"]
    scan: ShownScan | None
    scan_index: int


class Player:
    """Plays one track. Not thread-safe: one thread acts on it, loading goes on in two others."""

    def __init__(
        self, track: Track, on_scan: Callable[[int], None] = lambda index: None, scans_kept: int = SCANS_KEPT
    ) -> None:
        """Start paused, at the first frame.

        Args:
            track: with at least one frame.
            on_scan: told of a frame when its scan is there, in another thread.
            scans_kept: most scans that are kept in memory.
        """
        self.track = track
        self.clock = FrameClock(len(track.rows), track.fps)
        self._blocks: AheadCache[Float32[np.ndarray, "n V 3"]] = AheadCache(self._posed, _BLOCKS_KEPT)
        self._scans = AheadCache(track.scan, scans_kept, on_scan)
        self._scans_kept = scans_kept
        self.scans_wanted = True

    @property
    def scans_there(self) -> int:
        """How many scans are kept."""
        return len(self._scans)

    def at(self, now: float) -> PlayedFrame:
        """What is to be seen now. It waits for the model, which is ahead as a rule, never for a scan."""
        index = self.clock.frame(now)
        block = index // BLOCK
        self._blocks.want(self._blocks_ahead(block))
        vertices = self._blocks.take(block)[index % BLOCK]
        self._scans.want(self._scans_ahead(index) if self.scans_wanted else ())
        scan_index, scan = self._scan_for(index)
        return PlayedFrame(index, self.track.rows[index], vertices, scan, scan_index)

    def next_problem(self, by: int, now: float) -> int | None:
        """The first frame of the next stretch of frames that are not ok, round the end; None without any.

        Args:
            by: 1 for the next, -1 for the one before.
            now: the moment.
        """
        starts = [first for first, _ in problem_stretches(self.track.rows)]
        if not starts:
            return None
        here = self.clock.frame(now)
        beyond = [i for i in starts if (i > here if by > 0 else i < here)]
        if not beyond:
            return starts[0] if by > 0 else starts[-1]
        return beyond[0] if by > 0 else beyond[-1]

    def refresh(self, now: float) -> int:
        """Read frames that were written since; how many there are more (less than none after a restart)."""
        before = len(self.track.rows)
        changed = self.track.refresh()
        count = len(self.track.rows)
        if count:
            self.clock.resize(count, now)
        # Scans that could not be read may be there now; colours of frames that changed are those of before.
        self._scans.forget(lambda scan: not changed and not scan.note)
        # The last block may have been a part of one.
        self._blocks.forget()
        return count - before

    def close(self, wait: float = 0.0) -> None:
        """Stop loading.

        Args:
            wait: for what is being loaded, at most so many seconds each.
        """
        self._blocks.close(wait)
        self._scans.close(wait)

    def _posed(self, block: int) -> Float32[np.ndarray, "n V 3"]:
        start = block * BLOCK
        return self.track.vertices(start, min(start + BLOCK, len(self.track.rows)))

    def _blocks_ahead(self, block: int) -> list[int]:
        last = (self.clock.count - 1) // BLOCK
        following = block + 1 if block < last else 0
        return [block, following, max(block - 1, 0)]

    def _scans_ahead(self, index: int) -> Iterator[int]:
        """The frames whose scans to read, the soonest needed first.

        While it plays faster than scans are read, first every so many frames, as can be there in time; then
        those between, for the next round.
        """
        ahead = min(self.clock.count if self.clock.loop else self.clock.count - index, self._scans_kept)
        if self.clock.playing:
            stride = max(1, math.ceil(_SLACK * self._scans.seconds * self.clock.rate))
            # Counted from the first frame, so that all moments wish for the same ones.
            first = (index // stride + 1) * stride
            yield from (number % self.clock.count for number in range(first, index + ahead, stride))
        yield from (number % self.clock.count for number in range(index, index + ahead))

    def _scan_for(self, index: int) -> tuple[int, ShownScan | None]:
        earliest = max(0, index - int(_STANDS * self.clock.rate)) if self.clock.playing else index
        for number in range(index, earliest - 1, -1):
            scan = self._scans.get(number)
            if scan is not None:
                return number, scan
        return index, None
