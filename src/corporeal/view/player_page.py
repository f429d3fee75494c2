"""The page on which tracks are played: viser's scene and panel, and the one thread that acts and draws."""

from __future__ import annotations

import html
import http
import queue
import threading
import time
from collections.abc import Callable, Collection, Coroutine, Mapping, Sequence
from typing import Any

from viser import Icon

from corporeal.view.frame_clock import SPEEDS
from corporeal.view.guard import Answer
from corporeal.view.guarded_server import GuardedServer
from corporeal.view.player import PlayedFrame, Player
from corporeal.view.player_panel import (
    PlayerWords,
    keys_html,
    legend_html,
    problems_html,
    strip_html,
    words_html,
)
from corporeal.view.player_scene import PlayerScene, Shown
from corporeal.view.track import Track

_KEY_ACTIONS = ("toggle", "next", "previous", "first", "last", "next_problem", "previous_problem")
_QUIET = ("draw", "scan")
"""What no user asked for: time goes on, and scans come in."""
_OVER, _BESIDE = "over the model", "beside the model"
# Words, strip and slider cost the browser more than the mesh: ten times a second while it plays.
_PANEL_SECONDS = 0.1
Action = tuple[str, Any]


class PlayerPage:
    """Serves tracks on this machine only; every action runs in one thread, in the order in which it came.

    Attributes:
        url: the address with its token.
        port: that it listens on.
    """

    def __init__(
        self,
        tracks: Sequence[Track],
        find: Callable[[Collection[str]], Sequence[Track]],
        worst_mm: float,
        port: int = 0,
    ) -> None:
        """Start to serve.

        Args:
            tracks: that are there, read; at least one of them with frames.
            find: gives those that have come when the user refreshes, but for the names that it is told.
            worst_mm: distance that has the last colour of the scale.
            port: to listen on; 0 for any. If it is taken, the next free one.

        Raises:
            PortError: no port can be listened on.
        """
        self._find = find
        self._tracks = {track.name: track for track in tracks}
        self._actions: queue.Queue[Action | None] = queue.Queue()
        self._player: Player | None = None
        self._message, self._told = "", 0.0
        self._guarded = GuardedServer("corporeal view", {"/do": self._do}, port)
        self._server, self.port, self.url = self._guarded.viser, self._guarded.port, self._guarded.url
        self._scene = PlayerScene(self._server)
        self._build_panel(worst_mm)
        first = next(name for name, track in self._tracks.items() if track.rows)
        self._thread = threading.Thread(target=self._work, name="player", daemon=True)
        self._actions.put(("select", first))
        self._thread.start()

    def wait(self) -> None:
        """Return when the page's thread has ended."""
        while self._thread.is_alive():
            self._thread.join(timeout=0.5)

    def close(self) -> None:
        """Stop serving."""
        self._actions.put(None)
        self._thread.join(timeout=15)
        self._guarded.stop()

    def _build_panel(self, worst_mm: float) -> None:
        gui = self._server.gui
        gui.add_html(keys_html())
        names = tuple(self._tracks)
        self._picker = gui.add_dropdown("sequence", names, visible=len(names) > 1)
        self._picker.on_update(self._on("select", lambda: self._picker.value))
        self._words, self._strip = gui.add_html(""), gui.add_html("")
        self._slider = gui.add_slider("frame", 1, 2, 1, 1)
        self._slider.on_update(self._on("go", lambda: int(self._slider.value) - 1))
        self._play = gui.add_button("play (space)", icon=Icon.PLAYER_PLAY)
        self._play.on_click(self._on("toggle"))
        steps = gui.add_button_group("step", ("\u25c0 left", "right \u25b6"))
        steps.on_click(self._on("step", lambda: -1 if "left" in steps.value else 1))
        speeds = gui.add_dropdown("speed", tuple(f"{speed:g}x" for speed in SPEEDS))
        speeds.on_update(self._on("speed", lambda: float(speeds.value.removesuffix("x"))))
        loop = gui.add_checkbox("loop", True)
        loop.on_update(self._on("loop", lambda: loop.value))
        self._place = gui.add_dropdown("scan", (_BESIDE, _OVER))
        self._place.on_update(self._on("view"))
        boxes = ("model", "scan", "colours of distance", "follow the person")
        self._boxes = [gui.add_checkbox(label, True) for label in boxes]
        for box in self._boxes:
            box.on_update(self._on("show"))
        gui.add_html(legend_html(worst_mm))
        self._problems = gui.add_html("")
        gui.add_button("look from the front", color="gray").on_click(self._on("view"))
        hint = "reads frames that a running track has written since"
        gui.add_button("refresh", color="gray", hint=hint).on_click(self._on("refresh"))

    def _on(
        self, action: str, argument: Callable[[], Any] = lambda: None
    ) -> Callable[[Any], Coroutine[Any, Any, None]]:
        # Coroutines run in the server's loop in the order in which events came; plain functions would run in
        # a pool and could overtake each other.
        async def enqueue(event: Any) -> None:
            # What the page sets itself, such as the slider while it plays, comes from no browser.
            if event.client_id is not None:
                self._actions.put((action, argument()))

        return enqueue

    def _do(self, query: Mapping[str, str]) -> Answer:
        action, frame = query.get("action", ""), query.get("frame", "")
        if action in _KEY_ACTIONS:
            self._actions.put((action, None))
        elif action == "go" and frame.isdecimal():
            self._actions.put(("go", int(frame)))
        else:
            return Answer(b"no such action", "text/plain", http.HTTPStatus.NOT_FOUND)
        return Answer(b"", "text/plain")

    def _work(self) -> None:
        while True:
            try:
                action = self._actions.get(timeout=self._pause())
            except queue.Empty:
                action = ("draw", None)
            if action is None:
                break
            try:
                if action[0] not in _QUIET:
                    self._message = ""
                self._act(*action)
                if self._actions.empty():
                    self._draw(action[0] not in _QUIET)
            except Exception as error:
                # A frame that cannot be drawn must not end the page.
                self._say(f"{type(error).__name__}: {error}")
        if self._player is not None:
            # Threads that compute must not be cut off by the end of the process.
            self._player.close(wait=5.0)

    def _pause(self) -> float | None:
        return None if self._player is None else self._player.clock.next_change(time.monotonic())

    def _act(self, action: str, argument: Any) -> None:
        now = time.monotonic()
        if action == "select":
            self._select(str(argument))
        elif action == "refresh":
            self._refresh(now)
        elif action == "view":
            self._scene.reset_view(self._shown().beside)
        elif self._player is not None:
            _play(self._player, action, argument, now)

    def _select(self, name: str) -> None:
        track = self._tracks[name]
        if self._player is not None:
            self._player.close(wait=2.0)
            if self._player.track is not track:
                self._player.track.release()
            self._player = None
        track.refresh()
        if not track.rows:
            self._scene.clear()
            self._strip.content = self._problems.content = ""
            self._say(f"{name}: {track.note or 'no frame yet'}")
            return
        self._message = track.note
        self._player = Player(track, lambda index: self._actions.put(("scan", index)))
        self._scene.start(track.stance(), track.vertices(0, 1)[0], track.faces())
        self._scene.reset_view(self._shown().beside)
        self._told_rows()
        if self._picker.value != name:
            self._picker.value = name

    def _refresh(self, now: float) -> None:
        found = self._find(tuple(self._tracks))
        self._tracks |= {track.name: track for track in found}
        if found:
            self._picker.options = tuple(self._tracks)
            self._picker.visible = True
        if self._player is None:
            self._select(self._picker.value)
            return
        more = self._player.refresh(now)
        if not self._player.track.rows:
            self._select(self._player.track.name)
            return
        news = f"{more} more frame{'s' * (more > 1)}" if more > 0 else "no new frames"
        self._message = self._player.track.note or news
        self._told_rows()

    def _told_rows(self) -> None:
        """Bring what depends on all frames up to date."""
        if self._player is not None:
            rows = self._player.track.rows
            self._slider.max = max(2, len(rows))
            self._problems.content = problems_html(rows)

    def _shown(self) -> Shown:
        model, scan, errors, follow = (box.value for box in self._boxes)
        return Shown(model, scan, self._place.value == _BESIDE, errors, follow)

    def _draw(self, whole: bool) -> None:
        """Draw what is to be seen now; ``whole`` for the panel too, which is else told from time to time."""
        player, now = self._player, time.monotonic()
        if player is None:
            return
        if player.clock.playing and not self._server.get_clients():
            # Nobody looks on: a page that was closed must not keep the machine busy.
            player.clock.toggle(now)
        shown = self._shown()
        player.scans_wanted = shown.scan
        frame = player.at(now)
        self._scene.show(frame.row.status, frame.vertices, frame.scan, shown)
        if whole or not player.clock.playing or now - self._told > _PANEL_SECONDS:
            self._told = now
            self._tell(player, frame)

    def _tell(self, player: Player, frame: PlayedFrame) -> None:
        playing, rows = player.clock.playing, player.track.rows
        words = PlayerWords(
            player.track.name, frame.index, len(rows), frame.index / player.clock.fps, frame.row, playing,
            self._scan_words(player, frame), frame.scan_index if frame.scan is not None else None,
            "; ".join(filter(None, (self._message, frame.scan.note if frame.scan is not None else ""))),
        )  # fmt: skip
        with self._server.atomic():
            self._words.content = words_html(words)
            self._strip.content = strip_html(rows, frame.index)
            label = "pause (space)" if playing else "play (space)"
            if self._play.label != label:
                self._play.label = label
                self._play.icon = Icon.PLAYER_PAUSE if playing else Icon.PLAYER_PLAY
            if self._slider.value != frame.index + 1:
                self._slider.value = frame.index + 1

    def _scan_words(self, player: Player, frame: PlayedFrame) -> str:
        there = f"{player.scans_there} of {player.clock.count} in memory"
        if not player.scans_wanted:
            return "not shown"
        if frame.scan is None:
            return f"is being read; {there}"
        if frame.scan.note:
            return "none"
        return (
            there
            if frame.scan_index == frame.index
            else f"of {player.track.rows[frame.scan_index].name}; {there}"
        )

    def _say(self, message: str) -> None:
        self._words.content = (
            f"<div id='player' style='margin:0 1em;color:#b3261e'>{html.escape(message)}</div>"
        )


def _play(player: Player, action: str, argument: Any, now: float) -> None:
    """Do what one of the keys or buttons of a player asks for."""
    clock = player.clock
    if action == "toggle":
        clock.toggle(now)
    elif action in ("next", "previous", "step"):
        clock.step(argument or {"next": 1, "previous": -1}[action], now)
    elif action in ("go", "first", "last"):
        clock.go({"first": 0, "last": clock.count}.get(action, argument))
    elif action == "speed":
        clock.set_speed(argument, now)
    elif action == "loop":
        clock.set_loop(argument, now)
    elif action in ("next_problem", "previous_problem"):
        found = player.next_problem(1 if action == "next_problem" else -1, now)
        if found is not None:
            clock.go(found)
