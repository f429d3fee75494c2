"""The page on which a session is curated: viser's scene and panel, keys, and the contact sheet."""

from __future__ import annotations

import functools
import html
import http
import queue
import threading
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

from corporeal.view.contact_sheet import PictureDrawer, picture_answer, sheet_page
from corporeal.view.curation import ANY, DECIDED, Curation, ScanDisplay
from corporeal.view.files import DecisionFileError
from corporeal.view.guard import Answer, Route
from corporeal.view.guarded_server import GuardedServer

_EYE, _CENTRE = (0.0, 0.0, 0.42), (0.0, 0.0, 0.0)
_SKIN, _POINT_SIZE = (236, 189, 161), 0.0007
_KEYS: tuple[tuple[str, str, Any, Any], ...] = (
    ("accept", "accept (a)", "A", "green"),
    ("reject", "reject (r)", "R", "red"),
    ("next", "next (right)", "arrowright", "gray"),
    ("previous", "previous (left)", "arrowleft", "gray"),
    ("undo", "undo (u)", "U", "yellow"),
)
Action = tuple[str, str, str]
"""What to do, its argument, and the scan that was on the page when it was asked for."""


class CurationPage:
    """Serves one session on this machine only; every action runs in one thread, in the order of the keys.

    Attributes:
        url: the address with its token.
    """

    def __init__(self, curation: Curation, drawer: PictureDrawer, port: int = 0) -> None:
        """Start to serve.

        Args:
            curation: the session.
            drawer: draws its thumbnails.
            port: to listen on; 0 for any. If it is taken, the next free one.

        Raises:
            PortError: no port can be listened on.
        """
        self._curation, self._drawer = curation, drawer
        self._actions: queue.Queue[Action | None] = queue.Queue()
        self._shown = ""
        routes: dict[str, Route] = {
            "/sheet": self._sheet,
            "/thumbnail": functools.partial(picture_answer, drawer),
            "/go": self._go,
        }
        self._guarded = GuardedServer("corporeal curate", routes, port)
        self._server, self.url = self._guarded.viser, self._guarded.url
        self._build_scene()
        self._build_panel()
        self._thread = threading.Thread(target=self._work, name="curation", daemon=True)
        self._actions.put(("show", "", ""))
        self._thread.start()

    def wait(self) -> None:
        """Return when the page's thread has ended."""
        while self._thread.is_alive():
            self._thread.join(timeout=0.5)

    def close(self) -> None:
        """Stop serving; every decision is on the disk already."""
        self._actions.put(None)
        self._thread.join(timeout=30)
        self._guarded.stop()
        self._drawer.close()
        self._curation.close()

    def _build_scene(self) -> None:
        self._server.scene.set_up_direction("+y")
        self._server.initial_camera.position = _EYE
        self._server.initial_camera.look_at = _CENTRE

    def _build_panel(self) -> None:
        gui = self._server.gui
        self._words = gui.add_html("")
        for action, label, key, colour in _KEYS:
            gui.add_button(label, color=colour).on_click(self._on(action))
            gui.add_command(label, hotkey=key).on_trigger(self._on(action))
        gui.add_html("<p style='margin:0 1em'><a href='/sheet' style='color:#1c6dd0'>contact sheet</a></p>")
        items = self._curation.items.values()
        choices = {
            "status": (ANY, *sorted({item.status for item in items})),
            "subject": (ANY, *sorted({item.subject for item in items if item.subject})),
            "decision": DECIDED,
        }
        self._filters = {name: gui.add_dropdown(name, values) for name, values in choices.items()}
        for choice in self._filters.values():
            choice.on_update(self._on("filter"))
        self._show_scan = gui.add_checkbox("scan, coloured by error", True)
        self._show_registration = gui.add_checkbox("registration", True)
        for box in (self._show_scan, self._show_registration):
            box.on_update(self._on("visibility"))

    def _on(self, action: str) -> Callable[[Any], Coroutine[Any, Any, None]]:
        # Coroutines run in the server's loop in the order in which the keys came; plain functions would
        # run in a pool and could overtake each other.
        async def enqueue(_: Any) -> None:
            self._actions.put((action, "", self._shown))

        return enqueue

    def _sheet(self, query: Mapping[str, str]) -> Answer:
        decisions = dict(self._curation.log.history.current)
        return sheet_page(self._curation.items.values(), decisions, query)

    def _go(self, query: Mapping[str, str]) -> Answer:
        name = query.get("name", "")
        if name not in self._curation.items:
            return Answer(b"no such scan", "text/plain", http.HTTPStatus.NOT_FOUND)
        self._actions.put(("go", name, ""))
        return Answer(b"", status=http.HTTPStatus.SEE_OTHER, location="/")

    def _work(self) -> None:
        while (action := self._actions.get()) is not None:
            try:
                note = self._act(*action)
                # Keys pressed meanwhile still go one after the other; drawing waits for none of them.
                self._show(note)
            except Exception as error:
                # A scan that cannot be drawn must not end the page and the night's work with it.
                self._clear()
                self._describe(f"{type(error).__name__}: {error}")
                self._shown = self._curation.name

    def _act(self, action: str, argument: str, shown: str) -> str:
        """Do it; what the curator should be told, or ""."""
        curation = self._curation
        if action in ("accept", "reject"):
            if shown != curation.name:
                return "that key came before this scan was shown: nothing was decided by it"
            try:
                curation.decide("accept" if action == "accept" else "reject")
            except DecisionFileError as error:
                return f"NOT written: {error}"
        elif action == "undo":
            try:
                return "" if curation.undo() else "nothing to undo"
            except DecisionFileError as error:
                return f"NOT written: {error}"
        elif action in ("next", "previous"):
            curation.step(1 if action == "next" else -1)
        elif action == "go":
            curation.go(argument)
        elif action == "filter":
            chosen = {name: choice.value for name, choice in self._filters.items()}
            return "" if curation.show_only(**chosen) else "no scan is left by these filters"
        return curation.log.note if action == "show" else ""

    def _show(self, note: str) -> None:
        curation = self._curation
        if curation.name != self._shown:
            display = curation.display()
            with self._server.atomic():
                self._draw(display)
                self._describe(note or display.note)
            self._frame()
        else:
            self._describe(note)
        if self._scan is not None:
            self._scan.visible = self._show_scan.value
        if self._registration is not None:
            self._registration.visible = self._show_registration.value
        self._shown = curation.name

    def _frame(self) -> None:
        """Look at the scan again: viser takes "a" for a step of the camera to the left too."""
        for client in self._server.get_clients().values():
            client.camera.position, client.camera.look_at = _EYE, _CENTRE

    def _draw(self, display: ScanDisplay) -> None:
        self._clear()
        scene = self._server.scene
        self._scan = scene.add_point_cloud(
            "/scan", display.points.astype("float32"), display.colours, point_size=_POINT_SIZE
        )
        if len(display.vertices):
            self._registration = scene.add_mesh_simple(
                "/registration", display.vertices.astype("float32"), display.faces.astype("uint32"),
                color=_SKIN, opacity=0.6, side="double",
            )  # fmt: skip

    def _clear(self) -> None:
        for node in (self._scan, self._registration):
            if node is not None:
                node.remove()
        self._scan = self._registration = None

    def _describe(self, note: str) -> None:
        curation = self._curation
        item, done = curation.items[curation.name], curation.log.history.current
        decided = sum(name in done for name in curation.items)
        rows = "".join(
            f"<tr><td>{html.escape(name)}&nbsp;</td><td>{html.escape(value)}</td></tr>"
            for name, value in item.signals
        )
        verdict = {"accept": "accepted", "reject": "rejected", None: "undecided"}[curation.verdict()]
        self._words.content = (
            f"<div id='curation' data-name='{html.escape(item.name, quote=True)}' data-decided='{decided}' "
            "style='margin:0 1em;font-size:0.9em'>"
            f"<b>{html.escape(item.name)}</b> ({curation.position + 1} of {len(curation.visible)})<br>"
            f"<b>{html.escape(item.status)}</b>, {verdict}; {decided} of {len(curation.items)} decided<br>"
            f"{html.escape(item.reason)}<br><span style='color:#b3261e'>{html.escape(note)}</span>"
            f"<table>{rows}</table>error on the scan: "
            "<span style='background:linear-gradient(90deg,#264085,#3385b8,#99d1ad,#fae68c,#f08540,#a60d1f);"
            "color:#fff;padding:0 4px'>0 &nbsp; 1 &nbsp; 2 &nbsp; 3 mm</span></div>"
        )

    _scan: Any = None
    _registration: Any = None
