"""Who may talk to the page: only who brings the token, over HTTP and over the websocket alike."""

from __future__ import annotations

import hmac
import http
import secrets
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import parse_qs, urlsplit

import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

_POLICY = {
    "Cache-Control": "no-store",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}


@dataclass(frozen=True)
class Answer:
    """What a page of ours answers: content and its type, or another address to go to."""

    content: bytes
    content_type: str = "text/html; charset=utf-8"
    status: http.HTTPStatus = http.HTTPStatus.OK
    location: str | None = None


Route = Callable[[Mapping[str, str]], Answer]
"""Answers a request, given the parameters of its query (the first value of each)."""


@dataclass
class TokenGuard:
    """Refuses every request without the token of this run.

    The first request brings the token in its address; the answer puts it in a cookie that scripts cannot
    read and that no other site's request carries, and the browser goes on without it in the address. A
    request of a page from another origin is refused even with the cookie: cookies do not tell ports apart.

    Attributes:
        routes: path -> who answers it; every other path is left to viser.
        token: a new secret.
    """

    routes: Mapping[str, Route] = field(default_factory=dict)
    token: str = field(default_factory=lambda: secrets.token_urlsafe(24))

    def answer(self, request: Request) -> Response | None:
        """A response of ours, or None where the request is admitted and is viser's."""
        address = urlsplit(request.path)
        query = {key: values[0] for key, values in parse_qs(address.query).items()}
        port = _port_of(request.headers.get("Host", ""))
        if not self._is_of_this_page(request.headers):
            return _response(Answer(b"refused: the request comes from another site", *_TEXT_403))
        if hmac.compare_digest(self._cookie(request.headers, port).encode(), self.token.encode()):
            route = self.routes.get(address.path)
            return None if route is None else _response(route(query))
        if hmac.compare_digest(query.get("token", "").encode(), self.token.encode()):
            if request.headers.get("Upgrade", "").lower() == "websocket":
                return None
            response = _response(Answer(b"", status=http.HTTPStatus.SEE_OTHER, location=address.path))
            cookie = f"{_cookie_name(port)}={self.token}; HttpOnly; SameSite=Strict; Path=/"
            response.headers["Set-Cookie"] = cookie
            return response
        sentence = b"refused: open the address, with its token, that the command printed"
        return _response(Answer(sentence, *_TEXT_403))

    def _is_of_this_page(self, headers: Headers) -> bool:
        host, origin = headers.get("Host", ""), headers.get("Origin")
        # A name other than these two is another site's whose address was turned to this machine.
        if host.rpartition(":")[0] not in ("127.0.0.1", "localhost"):
            return False
        if headers.get("Sec-Fetch-Site", "none") in ("cross-site", "same-site"):
            return False
        return origin is None or origin == f"http://{host}"

    def _cookie(self, headers: Headers, port: str) -> str:
        jar: SimpleCookie = SimpleCookie()
        try:
            for line in headers.get_all("Cookie"):
                jar.load(line)
        except CookieError:
            return ""
        morsel = jar.get(_cookie_name(port))
        return "" if morsel is None else morsel.value


@contextmanager
def guarding(guard: TokenGuard) -> Iterator[None]:
    """Servers that viser starts inside ask the guard first.

    viser (1.1.1) has no hook for requests; it starts its one server, for pages and websocket, by
    ``websockets.asyncio.server.serve`` with a ``process_request`` of its own, which is wrapped here. A proxy
    in front was refused: viser's own port would stay open behind it.

    Raises:
        RuntimeError: viser did not start its server this way; it must not be used then.
    """
    original = websockets.asyncio.server.serve
    wrapped = 0

    def serve(*arguments: Any, **options: Any) -> Any:
        nonlocal wrapped
        inner = options.get("process_request")

        def process_request(connection: ServerConnection, request: Request) -> Any:
            refused = guard.answer(request)
            if refused is not None or inner is None:
                return refused
            return inner(connection, request)

        wrapped += 1
        return original(*arguments, **options | {"process_request": process_request})

    websockets.asyncio.server.serve = serve  # type: ignore[assignment]
    try:
        yield
    finally:
        websockets.asyncio.server.serve = original
    if not wrapped:
        raise RuntimeError("this version of viser starts its server in another way, so that it has no guard")


_TEXT_403 = ("text/plain; charset=utf-8", http.HTTPStatus.FORBIDDEN)


def _response(answer: Answer) -> Response:
    headers = Headers(_POLICY)
    headers["Content-Type"] = answer.content_type
    headers["Content-Length"] = str(len(answer.content))
    headers["Connection"] = "close"
    if answer.location is not None:
        headers["Location"] = answer.location
    return Response(answer.status.value, answer.status.phrase, headers, answer.content)


def _port_of(host: str) -> str:
    return host.rpartition(":")[2]


def _cookie_name(port: str) -> str:
    return f"corporeal_{port}" if port.isdigit() else "corporeal"
