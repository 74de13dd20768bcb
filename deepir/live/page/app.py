"""What the server answers, and to whom: the page, its files, the pictures, and snapshots."""

from __future__ import annotations

import asyncio
import ipaddress
import json
import secrets
from collections.abc import Callable, Collection
from pathlib import Path
from urllib.parse import urlsplit

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.datastructures import Headers, MutableHeaders
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocket, WebSocketDisconnect

from deepir.io.radiometry import unit_metadata
from deepir.io.tone_mapping import PALETTES, TONE_MAPPINGS
from deepir.live.page.views import Session, ViewerRequest, png, respond, swatch, tiff
from deepir.live.sources import CorrectedFrame
from deepir.report.html import WEB_FOLDER, json_for_html

STATIC = Path(__file__).parent / "static"
#: What the page loads, and its type: what it shares with the reports, and its own.
FILES = {
    WEB_FOLDER / "page.css": "text/css",
    WEB_FOLDER / "page.js": "text/javascript",
    STATIC / "live.css": "text/css",
    STATIC / "picture.js": "text/javascript",
    STATIC / "live.js": "text/javascript",
}
#: Of every answer: only the page's own files load and run, no other site may show or read them.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
LOOK_INTERVAL = 0.005  # s between two looks for a new frame, while a viewer waits for one
STATUS_INTERVAL = 0.25  # s after which a viewer hears how it goes without a new frame
POLICY_VIOLATION = 1008  # why a socket is closed (RFC 6455)


def make_app(session: Session) -> Starlette:
    """The application that shows a session."""
    app = Starlette(
        routes=[
            Route("/", _page),
            Route("/palettes/{name}.png", _palette),
            Route("/snapshot.tif", _values),
            Route("/snapshot.png", _picture),
            WebSocketRoute("/watch", _watch),
            *(Route(f"/{path.name}", _file(path, kind)) for path, kind in FILES.items()),
        ]
    )
    app.state.session = session
    return app


async def _watch(socket: WebSocket) -> None:
    """Respond to one request of a viewer after the other: a slow one asks less often, and nothing waits in a queue.

    Pictures are made here, in the one thread of the server: many viewers share it, and leave the other cores alone.
    """
    session: Session = socket.app.state.session
    await socket.accept()
    try:
        while True:
            request = ViewerRequest.model_validate_json(await socket.receive_text())
            if request.command:
                session.submit(request.command)
            await _wait_for_frame(session, request.seen)
            pictures, status = respond(session, request)
            for picture in pictures:
                await socket.send_bytes(picture)
            await socket.send_text(json.dumps(status, allow_nan=False))
    except WebSocketDisconnect:
        return
    except (ValidationError, KeyError):  # KeyError: bytes in place of text
        await socket.close(POLICY_VIOLATION)


async def _wait_for_frame(session: Session, seen: int) -> None:
    """Wait for a frame that a viewer has not seen, but not for long."""
    loop = asyncio.get_running_loop()
    until = loop.time() + STATUS_INTERVAL
    while (session.newest is None or session.newest.number == seen) and loop.time() < until:
        await asyncio.sleep(LOOK_INTERVAL)


def _page(request: Request) -> Response:
    """The page, and what can be chosen on it."""
    session: Session = request.app.state.session
    data = {
        "title": session.title,
        "palettes": list(PALETTES),
        "tones": list(TONE_MAPPINGS),
        "palette": session.palette,
        "tone": session.tones,
    }
    page = (STATIC / "index.html").read_text(encoding="utf-8")
    return HTMLResponse(page.replace("%data%", json_for_html(data)))


def _file(path: Path, kind: str) -> Callable[[Request], Response]:
    return lambda request: Response(path.read_bytes(), media_type=kind)


def _palette(request: Request) -> Response:
    return Response(swatch(_known(request.path_params["name"], PALETTES)), media_type="image/png")


def _values(request: Request) -> Response:
    """The newest corrected frame as TIFF."""
    session: Session = request.app.state.session
    newest = _newest(session)
    metadata = unit_metadata(session.radiometry) | {"frame": newest.number}
    return _download(tiff(newest.corrected, metadata), f"frame-{newest.number}.tif", "image/tiff")


def _picture(request: Request) -> Response:
    """The newest corrected frame as PNG, in the palette and the tones of the query."""
    newest = _newest(request.app.state.session)
    palette = _known(request.query_params.get("palette"), PALETTES)
    tones = _known(request.query_params.get("tones"), TONE_MAPPINGS)
    return _download(png(newest.corrected, palette, tones), f"frame-{newest.number}.png", "image/png")


def _known(name: str | None, names: Collection[str]) -> str:
    """A name that is one of some; else the answer is 404."""
    if name is None or name not in names:
        raise HTTPException(404)
    return name


def _newest(session: Session) -> CorrectedFrame:
    if session.newest is None:
        raise HTTPException(404, "no frame has come yet")
    return session.newest


def _download(content: bytes, name: str, kind: str) -> Response:
    return Response(content, media_type=kind, headers={"Content-Disposition": f'attachment; filename="{name}"'})


class Guard:
    """Refuses (403) foreign host names, foreign origins, and requests without the token.

    A site whose name is made to point here (DNS rebinding) gives itself away by the `Host` it asks for, one that
    connects from its own page by its `Origin`.

    Args:
        app: That answers what is allowed.
        host: Name or address that the server is bound to.
        token: With which paths must begin; empty: none.
    """

    def __init__(self, app: ASGIApp, host: str, token: str = "") -> None:
        self._app, self._host, self._token = app, host, token

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request, or refuse it."""

        async def send_with_headers(message: Message) -> None:
            if message["type"].endswith("response.start"):
                MutableHeaders(scope=message).update(HEADERS)
            await send(message)

        if refused := self._refused(scope):
            await PlainTextResponse(refused, 403)(scope, receive, send_with_headers)
            return
        rest = scope["path"][len(self._prefix) :]
        await self._app({**scope, "path": rest}, receive, send_with_headers)

    @property
    def _prefix(self) -> str:
        return f"/{self._token}" if self._token else ""

    def _refused(self, scope: Scope) -> str:
        """Why a request is refused; empty if it is not."""
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._known(host):
            return "this host name is not known here: use the address that deepir has printed"
        if origin is not None and origin.partition("://")[2] != host:
            return "pages of other sites may not look here"
        begin = scope["path"][: len(self._prefix) + 1].encode()
        if self._token and not secrets.compare_digest(begin, f"{self._prefix}/".encode()):
            return "the address is not whole: use the one that deepir has printed"
        return ""

    def _known(self, host: str) -> bool:
        """Whether a host is an address, this machine or what the server is bound to: no site can claim these."""
        try:
            name = urlsplit(f"//{host}").hostname or ""
            if name in ("localhost", self._host.lower()):
                return True
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True
