"""The contact sheet: a page with a small picture of every scan, drawn in the background."""

from __future__ import annotations

import html
import http
import queue
import threading
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from urllib.parse import quote

from corporeal.view.curation import ANY, CurationItem
from corporeal.view.files import read_picture
from corporeal.view.guard import Answer

_STYLE = """
body{font:14px system-ui,sans-serif;margin:16px;background:#fafaf9;color:#26282c}
nav a{margin-right:12px} main{display:grid;gap:10px;grid-template-columns:repeat(auto-fill,minmax(170px,1fr))}
main a{color:inherit;text-decoration:none;background:#fff;border:3px solid #ddd;border-radius:6px;padding:4px}
main img{width:100%;aspect-ratio:1;object-fit:contain;background:#f1f1f0} small{color:#667}
.accept{border-color:#3a9a5b!important}.reject{border-color:#c2413b!important}
"""
_RETRY = "setTimeout(()=>this.src=this.src.replace(/&t=.*|$/,'&t='+Date.now()),2000)"


class PictureDrawer:
    """Draws pictures one after the other in a thread; those that are asked for first."""

    def __init__(self, names: Iterable[str], draw: Callable[[str], Path]) -> None:
        """Start.

        Args:
            names: of all scans, in the order in which they are drawn when nothing is asked for.
            draw: draws the picture of a scan unless it is there; returns where it lies.
        """
        self._draw = draw
        self._paths: dict[str, Path] = {}
        self._failed: dict[str, str] = {}
        self._wanted: queue.PriorityQueue[tuple[int, str]] = queue.PriorityQueue()
        self._names = list(names)
        for number, name in enumerate(self._names):
            self._wanted.put((number, name))
        self._closed = threading.Event()
        self._thread = threading.Thread(target=self._work, name="thumbnails", daemon=True)
        self._thread.start()

    def picture(self, name: str) -> bytes | None:
        """The picture, or None where it is still to be drawn; it is the next one then."""
        if name in self._paths:
            return read_picture(self._paths[name])
        if name in self._names and name not in self._failed:
            self._wanted.put((-1, name))
        return None

    def failure(self, name: str) -> str | None:
        """Why a picture could not be drawn, or None."""
        return self._failed.get(name)

    def close(self) -> None:
        """Stop after the picture that is being drawn."""
        self._closed.set()
        self._wanted.put((-2, ""))
        self._thread.join(timeout=10)

    def _work(self) -> None:
        while not self._closed.is_set():
            name = self._wanted.get()[1]
            if name and name not in self._paths and name not in self._failed:
                try:
                    self._paths[name] = self._draw(name)
                except Exception as error:
                    # One picture must not cost the others; the page shows why.
                    self._failed[name] = f"{type(error).__name__}: {error}"


def picture_answer(drawer: PictureDrawer, query: Mapping[str, str]) -> Answer:
    """Answers a request for the picture of ``query["name"]``; the page asks again after a 404."""
    name = query.get("name", "")
    content = drawer.picture(name)
    if content is not None:
        return Answer(content, "image/png")
    failure = drawer.failure(name)
    if failure is not None:
        words = html.escape(failure[:60])
        text = (
            f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 200 200"><text y="90">{words}</text></svg>'
        )
        return Answer(text.encode(), "image/svg+xml")
    return Answer(b"not drawn yet", "text/plain", http.HTTPStatus.NOT_FOUND)


def sheet_page(
    items: Iterable[CurationItem], decisions: Mapping[str, str], query: Mapping[str, str]
) -> Answer:
    """The page; ``query`` may hold status and subject, as the page's own links do."""
    items = list(items)
    status, subject = query.get("status", ANY), query.get("subject", ANY)
    shown = [item for item in items if status in (ANY, item.status) and subject in (ANY, item.subject)]
    parts = [
        "<!doctype html><meta charset=utf-8><title>corporeal: contact sheet</title>",
        f"<style>{_STYLE}</style><nav><a href='/'>back to the scan</a>",
        *_links("status", sorted({item.status for item in items}), {"subject": subject}),
        "</nav><nav>",
        *_links("subject", sorted({item.subject for item in items if item.subject}), {"status": status}),
        f"</nav><p>{len(shown)} of {len(items)} scans</p><main>",
        *(_card(item, decisions.get(item.name, "")) for item in shown),
        "</main>",
    ]
    return Answer("".join(parts).encode())


def _links(key: str, values: list[str], others: Mapping[str, str]) -> list[str]:
    kept = "".join(f"&{name}={quote(value)}" for name, value in others.items())
    return [
        f"<a href='/sheet?{key}={quote(value)}{html.escape(kept)}'>{html.escape(value)}</a>"
        for value in (ANY, *values)
    ]


def _card(item: CurationItem, decision: str) -> str:
    name = quote(item.name, safe="")
    return (
        f"<a class='{decision}' href='/go?name={name}' title='{html.escape(item.reason, quote=True)}'>"
        f"<img loading=lazy alt='' src='/thumbnail?name={name}' onerror=\"{_RETRY}\">"
        f"<br>{html.escape(item.name)}<br><small>{html.escape(item.status)} {decision}</small></a>"
    )
