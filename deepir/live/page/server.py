"""The server of the live page, for viewers that may see it."""

from __future__ import annotations

import ipaddress
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from deepir.errors import ConfigError
from deepir.io.guards import import_optional
from deepir.live.page.views import Session

#: Of every answer: only the page's own files load and run, no other site may show or read them.
HEADERS = {
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-store",
}
MAX_REQUEST_BYTES = 4096  # of one message of a viewer
CLOSING_TIME = 1  # s that viewers get at the end
LOOPBACK = "127.0.0.1"
#: An address of the documentation (RFC 5737): no packet is sent to it.
ELSEWHERE = ("192.0.2.1", 9)


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


@contextmanager
def serve(session: Session, host: str, port: int) -> Iterator[str]:
    """A context in which a session can be looked at; it gives the address of the page.

    Args:
        session: The session.
        host: Name or address of this machine that the server is bound to. If others can reach it, the address of the
            page holds a token.
        port: Of the server; 0: one that is free.

    Raises:
        DataError: The extra `live` is missing.
        ConfigError: The address or the port cannot be used.
    """
    for library in ("starlette", "websockets"):
        import_optional(library, "live", "--page")
    uvicorn = import_optional("uvicorn", "live", "--page")
    from deepir.live.page.app import make_app
    from deepir.live.page.server import Guard

    listener = _listen(host, port)
    token = "" if _is_local(host) else secrets.token_urlsafe(16)
    config = uvicorn.Config(
        Guard(make_app(session), host, token),
        ws="websockets-sansio",
        ws_max_size=MAX_REQUEST_BYTES,
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        log_level="critical",
        server_header=False,
        timeout_graceful_shutdown=CLOSING_TIME,
    )
    server = uvicorn.Server(config)
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]}, daemon=True)
    thread.start()
    try:
        yield _address(host, listener.getsockname()[1], token)
    finally:
        server.should_exit = True
        thread.join()


def _listen(host: str, port: int) -> socket.socket:
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        both = host == "::" and socket.has_dualstack_ipv6()
        return socket.create_server((host, port), family=family, dualstack_ipv6=both)
    except OSError as error:
        reason = (error.strerror or str(error)).partition(" (")[0]
        raise ConfigError(
            f"the page cannot be served at {host}, port {port}: {reason}; "
            "choose another with --port or --host"
        ) from error


def _is_local(host: str) -> bool:
    """Whether only this machine reaches a server that is bound to a host."""
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _address(host: str, port: int, token: str) -> str:
    """Of the page, for a browser; with an address of this machine for one that stands for all."""
    if host in ("0.0.0.0", "::", ""):
        host = _own_address()
    name = f"[{host}]" if ":" in host else host
    return f"http://{name}:{port}/" + (f"{token}/" if token else "")


def _own_address() -> str:
    """Address of this machine in its network."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect(ELSEWHERE)
        except OSError:  # no network
            return LOOPBACK
        return str(probe.getsockname()[0])
