"""What takes time to load, loaded by a thread before it is needed; a bounded number of it is kept."""

from __future__ import annotations

import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Generic, TypeVar

T = TypeVar("T")
_SMOOTHING = 0.3


class AheadCache(Generic[T]):
    """Values by number, one loaded at a time. Thread-safe.

    Attributes:
        seconds: that a value takes to load, smoothed over the last ones; 0 before the first.
    """

    def __init__(
        self, load: Callable[[int], T], kept: int, on_loaded: Callable[[int], None] = lambda number: None
    ) -> None:
        """Start the thread.

        Args:
            load: gives the value of a number; called in the thread.
            kept: most values that are kept; at least one.
            on_loaded: told of a number when its value is there, in the thread.
        """
        self._load, self._kept, self._on_loaded = load, max(1, kept), on_loaded
        self.seconds = 0.0
        self._values: OrderedDict[int, T] = OrderedDict()
        self._failures: dict[int, Exception] = {}
        self._wanted: list[int] = []
        self._generation = 0
        self._closed = False
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._work, name="ahead", daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._values)

    def __contains__(self, number: int) -> bool:
        return number in self._values

    def get(self, number: int) -> T | None:
        """The value, or None where it is not there; it does not wait."""
        with self._changed:
            if number not in self._values:
                return None
            self._values.move_to_end(number)
            return self._values[number]

    def want(self, numbers: Iterable[int]) -> None:
        """Have these loaded, in this order, instead of all wished for before; no more than are kept."""
        wanted = list(dict.fromkeys(numbers))[: self._kept]
        with self._changed:
            self._wanted = wanted
            self._changed.notify_all()

    def take(self, number: int, timeout: float = 60.0) -> T:
        """The value; it is the next to be loaded and waited for where it is not there.

        Raises:
            RuntimeError: it could not be loaded; the next call tries again.
            TimeoutError: it did not come, or the cache was closed.
        """
        ends = time.monotonic() + timeout
        with self._changed:
            while number not in self._values:
                if number in self._failures:
                    error = self._failures.pop(number)
                    self._changed.notify_all()
                    raise RuntimeError(f"number {number} could not be loaded") from error
                left = ends - time.monotonic()
                if self._closed or left <= 0:
                    raise TimeoutError(f"number {number} was not loaded within {timeout:g} s")
                if self._wanted[:1] != [number]:
                    self._wanted.insert(0, number)
                    self._changed.notify_all()
                self._changed.wait(left)
            self._values.move_to_end(number)
            return self._values[number]

    def forget(self, kept: Callable[[T], bool] = lambda value: False) -> None:
        """Drop values, one that is just being loaded too.

        Args:
            kept: tells which ones stay all the same.
        """
        with self._changed:
            self._values = OrderedDict((key, value) for key, value in self._values.items() if kept(value))
            self._failures.clear()
            self._generation += 1
            self._changed.notify_all()

    def close(self, wait: float = 0.0) -> None:
        """Stop after the value that is being loaded.

        Args:
            wait: for it, at most so many seconds.
        """
        with self._changed:
            self._closed = True
            self._wanted.clear()
            self._changed.notify_all()
        self._thread.join(timeout=wait)

    def _next(self) -> int | None:
        known = (self._values, self._failures)
        return next((number for number in self._wanted if not any(number in there for there in known)), None)

    def _work(self) -> None:
        while True:
            with self._changed:
                while not self._closed and self._next() is None:
                    self._changed.wait()
                number, generation = self._next(), self._generation
                if self._closed or number is None:
                    return
            begun = time.perf_counter()
            try:
                value = self._load(number)
            except Exception as error:
                # One value must not end the thread; whoever takes it is told.
                with self._changed:
                    self._failures[number] = error
                    self._changed.notify_all()
                continue
            seconds = time.perf_counter() - begun
            with self._changed:
                if generation != self._generation:
                    continue
                self.seconds += (_SMOOTHING if self.seconds else 1.0) * (seconds - self.seconds)
                self._keep(number, value)
                self._changed.notify_all()
            self._on_loaded(number)

    def _keep(self, number: int, value: T) -> None:
        """What is not wished for goes first, longest unused first; then what is wished for last."""
        self._values[number] = value
        while len(self._values) > self._kept:
            wanted = set(self._wanted[: self._kept])
            spare = (kept for kept in self._values if kept not in wanted and kept != number)
            last = next((kept for kept in reversed(self._wanted) if kept in self._values), number)
            del self._values[next(spare, last)]
