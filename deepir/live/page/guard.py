"""Access control of the page: requests from other sites, for foreign host names, or without the token are refused."""

from __future__ import annotations

import ipaddress
import secrets
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

#: Of every answer: only the page's own files load and run, no other site may show or read them.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}


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
