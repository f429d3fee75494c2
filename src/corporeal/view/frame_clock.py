"""Which frame of a track is to be seen at a moment: play, pause, speed, steps, loop. It knows no page."""

from __future__ import annotations

import math

SPEEDS = (1.0, 0.5, 0.25)


class FrameClock:
    """Tells frames by time: where drawing is slow, frames are left out and the speed stays.

    Moments are seconds of any clock that does not go back.

    Attributes:
        fps: frames per second at speed 1.
        count: of frames; at least one.
        loop: after the last frame comes the first; otherwise playing ends at the last.
    """

    def __init__(self, count: int, fps: float, loop: bool = True) -> None:
        """Start paused, at the first frame.

        Raises:
            ValueError: there is no frame, or not a positive number of them per second.
        """
        if count < 1 or not 0 < fps < math.inf:
            raise ValueError(f"a clock needs frames and frames per second, got {count} and {fps}")
        self.count, self.fps, self.loop = count, fps, loop
        self._speed, self._playing = SPEEDS[0], False
        self._since, self._from = 0.0, 0.0

    @property
    def playing(self) -> bool:
        """Whether it runs."""
        return self._playing

    @property
    def speed(self) -> float:
        """Share of the true speed."""
        return self._speed

    @property
    def rate(self) -> float:
        """Frames per second at which it plays."""
        return self.fps * self._speed

    def frame(self, now: float) -> int:
        """The frame to be seen; one that does not loop stops at the last."""
        reached = math.floor(self._reached(now))
        if reached < self.count:
            return reached
        if self.loop:
            return reached % self.count
        self._playing, self._from = False, float(self.count - 1)
        return self.count - 1

    def next_change(self, now: float) -> float | None:
        """Seconds until another frame is to be seen; None while it stands."""
        if not self._playing:
            return None
        reached = self._reached(now)
        return (math.floor(reached) + 1 - reached) / self.rate

    def toggle(self, now: float) -> None:
        """Play or pause; playing from the last frame on begins at the first."""
        frame = self.frame(now)
        if self._playing:
            self.go(frame)
        else:
            at_end = frame == self.count - 1 and not self.loop
            self._playing, self._since, self._from = True, now, 0.0 if at_end else float(frame)

    def go(self, frame: int) -> None:
        """Stand at a frame; one that does not exist is the nearest that does."""
        self._playing, self._from = False, float(min(max(frame, 0), self.count - 1))

    def step(self, by: int, now: float) -> None:
        """Stand so many frames on or back; round the ends where it loops."""
        target = self.frame(now) + by
        self.go(target % self.count if self.loop else target)

    def set_speed(self, speed: float, now: float) -> None:
        """Go on at another speed, without a jump.

        Raises:
            ValueError: it is not positive.
        """
        if not 0 < speed < math.inf:
            raise ValueError(f"speed: expected a positive number, got {speed}")
        self._from, self._since, self._speed = self._reached(now), now, speed

    def set_loop(self, loop: bool, now: float) -> None:
        """Loop, or stop at the last frame, from the frame on that is seen."""
        self._from, self._since = self._reached(now) % self.count, now
        self.loop = loop

    def resize(self, count: int, now: float) -> None:
        """Frames came, or went; the one that is seen stays where it still exists.

        Raises:
            ValueError: no frame is left.
        """
        if count < 1:
            raise ValueError("a clock needs at least one frame")
        frame = self.frame(now)
        self.count = count
        self._from, self._since = float(min(frame, count - 1)), now

    def _reached(self, now: float) -> float:
        if not self._playing:
            return self._from
        return self._from + max(0.0, now - self._since) * self.rate
