"""The server of the live page, for viewers that may see it."""

from __future__ import annotations

import ipaddress
import secrets
import socket
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from deepir.errors import ConfigError
from deepir.io.guards import import_optional
from deepir.live.page.views import Session

LOOPBACK = "127.0.0.1"


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
    from deepir.live.page.app import Guard, make_app

    listener = _listen(host, port)
    token = "" if _is_local(host) else secrets.token_urlsafe(16)
    config = uvicorn.Config(
        Guard(make_app(session), host, token),
        ws="websockets-sansio",
        ws_max_size=4096,  # bytes
        ws_per_message_deflate=False,
        lifespan="off",
        log_config=None,
        log_level="critical",
        server_header=False,
        timeout_graceful_shutdown=1,  # s
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
            f"the page cannot be served at {host}, port {port}: {reason}; choose another with --port or --host"
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
            probe.connect(("192.0.2.1", 9))  # of the documentation (RFC 5737): no packet is sent to it
        except OSError:  # no network
            return LOOPBACK
        return str(probe.getsockname()[0])
