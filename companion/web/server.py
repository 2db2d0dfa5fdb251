"""The HTTP server of the live page: Starlette on Uvicorn, in a thread of its own.

It answers GET only. A request whose ``Host`` is a name that is not ours is refused: a web site that
points its own name at this machine could read the page otherwise. One whose ``Origin`` is another
site is refused too. Each open page gets the newest snapshot when it has taken the one before; what
a slow page misses is not kept for it.
"""

import asyncio
import contextlib
import ipaddress
import json
import logging
import socket
import sys
import threading
from collections.abc import AsyncIterator, Sequence
from pathlib import Path
from urllib.parse import urlsplit

import uvicorn
from starlette.applications import Starlette
from starlette.datastructures import Headers
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from companion.errors import ConfigError
from companion.health import Health
from companion.plots import style
from companion.web.board import Board
from companion.web.metrics import CONTENT_TYPE, exposition
from companion.web.settings import Address, HttpSettings, read_address

logger = logging.getLogger("kollsman.web")

REFRESH_S = 0.1
ALIVE_S = 1.0
"""An event goes to each page at least so often, so that it notices a lost connection."""
SEND_S = 20.0
"""A page that takes nothing for so long is disconnected."""
MOST_CONNECTIONS = 32
SWITCH_S = 0.0005
"""how long the server's thread may hold the interpreter while the estimator's waits for it"""
PAGE = Path(__file__).with_name("page")
FILES = {
    "/": ("index.html", "text/html; charset=utf-8"),
    "/page.css": ("page.css", "text/css; charset=utf-8"),
    "/curves.js": ("curves.js", "text/javascript; charset=utf-8"),
    "/page.js": ("page.js", "text/javascript; charset=utf-8"),
}
SAFE = {
    "content-security-policy": "default-src 'none'; script-src 'self'; style-src 'self'; "
    "connect-src 'self'; img-src 'self' data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'",
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


class Guard:
    """Refuses requests for another host or from another site.

    Parameters
    ----------
    names : host names that are ours, lower case. IP addresses always are: an attack needs a name.
    """

    def __init__(self, app: ASGIApp, names: Sequence[str]) -> None:
        self._app = app
        self._names = frozenset(names)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            return
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin")
        if not self._is_ours(host):
            text = f"host {host!r} is refused: use an IP address, or add the name to http.hosts\n"
            await PlainTextResponse(text, 403, SAFE)(scope, receive, send)
        elif origin is not None and urlsplit(origin).netloc != host:
            await PlainTextResponse("another site is refused\n", 403, SAFE)(scope, receive, send)
        else:
            await self._app(scope, receive, send)

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return name in self._names
        return True


def names_of(address: Address, hosts: Sequence[str]) -> list[str]:
    """The host names that are ours: localhost, this machine's, the configured ones."""
    own = socket.gethostname().lower()
    return [
        "localhost",
        own,
        f"{own.split('.')[0]}.local",
        address.host.lower(),
        *map(str.lower, hosts),
    ]


class EventStream:
    """The newest snapshot to one page, again and again until it goes."""

    def __init__(self, server: "WebServer", request: Request) -> None:
        self._server = server
        self._request = request

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = {**SAFE, "content-type": "text/event-stream", "x-accel-buffering": "no"}
        raw = [(name.encode(), value.encode()) for name, value in headers.items()]
        await send({"type": "http.response.start", "status": 200, "headers": raw})
        with contextlib.suppress(TimeoutError):
            async for event in self._server.events():
                if await self._request.is_disconnected():
                    return
                async with asyncio.timeout(SEND_S):
                    await send({"type": "http.response.body", "body": event, "more_body": True})
            await send({"type": "http.response.body", "body": b"", "more_body": False})


class WebServer:
    """Serves a board until closed.

    Parameters
    ----------
    address : where to listen; port 0 takes a free one.
    hosts : further host names that are ours.

    Raises `ConfigError` when the address cannot be had.
    """

    def __init__(self, address: Address, board: Board, hosts: Sequence[str] = ()) -> None:
        self._board = board
        self._files = {
            path: ((PAGE / name).read_bytes(), kind) for path, (name, kind) in FILES.items()
        } | _styles()
        try:
            self._socket = _listen(address)
        except OSError as error:
            raise ConfigError(
                f"--http {address.host}:{address.port}: {error.strerror or error}; "
                "give another address or port"
            ) from None
        self.address = Address(address.host, self._socket.getsockname()[1])
        self._changed = asyncio.Event()
        app = Guard(self._app(), names_of(address, hosts))
        config = uvicorn.Config(
            app,
            loop="asyncio",
            http="h11",
            ws="none",
            lifespan="off",
            log_config=None,
            log_level="error",
            access_log=False,
            server_header=False,
            limit_concurrency=MOST_CONNECTIONS,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._run, name="http", daemon=True)

    @property
    def url(self) -> str:
        """Where a browser finds the page."""
        host = self.address.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.address.port}/"

    @property
    def told(self) -> str:
        """A line about where it is, and who can read it."""
        reach = "; every machine that reaches this one can read it"
        return f"live page: {self.url}{'' if self.address.is_loopback else reach}"

    @property
    def is_alive(self) -> bool:
        """Whether it serves."""
        return self._thread.is_alive()

    def start(self) -> None:
        """Begin to serve."""
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_S))
        self._thread.start()

    def close(self) -> None:
        """End every connection and the thread."""
        self._server.should_exit = True
        if self._thread.is_alive():
            self._thread.join(5.0)
        self._socket.close()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except Exception:  # the altitude goes on without its page
            logger.exception("the live page ended")

    async def _serve(self) -> None:
        refreshing = asyncio.create_task(self._refresh())
        try:
            await self._server.serve(sockets=[self._socket])
        finally:
            refreshing.cancel()

    async def _refresh(self) -> None:
        """Look at the slot, and wake the pages when something is new."""
        while True:
            self._look()
            await asyncio.sleep(REFRESH_S)

    def _look(self) -> None:
        if self._board.refresh():
            changed, self._changed = self._changed, asyncio.Event()
            changed.set()

    async def events(self) -> AsyncIterator[bytes]:
        """The newest event, each time there is a newer one and once a second at least."""
        while not self._server.should_exit:
            self._look()
            sent = self._board.number
            yield self._board.event()
            changed = self._changed
            if self._board.number != sent:  # while the page took that one
                continue
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(ALIVE_S):
                    await changed.wait()

    def _app(self) -> Starlette:
        routes = [Route(path, self._file) for path in self._files]
        routes += [
            Route("/api/state", self._state),
            Route("/api/history", self._history),
            Route("/api/events", self._events),
            Route("/metrics", self._metrics),
            Route("/healthz", self._healthz),
        ]
        return Starlette(routes=routes)

    async def _file(self, request: Request) -> Response:
        body, kind = self._files[request.url.path]
        return Response(body, headers=SAFE, media_type=kind)

    async def _state(self, request: Request) -> Response:
        snapshot = self._board.newest
        if snapshot is None:
            return JSONResponse({"error": "no snapshot yet"}, 503, SAFE)
        return JSONResponse({**snapshot.document, "age_s": self._board.age_s}, headers=SAFE)

    async def _history(self, request: Request) -> Response:
        return Response(
            b"".join(self._board.history()), headers=SAFE, media_type="application/json"
        )

    async def _events(self, request: Request) -> EventStream:
        return EventStream(self, request)

    async def _metrics(self, request: Request) -> Response:
        return Response(exposition(self._board), headers={**SAFE, "content-type": CONTENT_TYPE})

    async def _healthz(self, request: Request) -> Response:
        """200 while there is an altitude to use and the loop runs, else 503; the body says why."""
        snapshot = self._board.newest
        if snapshot is None:
            return JSONResponse({"status": "STARTING", "reason": "no snapshot yet"}, 503, SAFE)
        if self._board.is_stalled:
            reason = f"the loop has not reported for {self._board.age_s:.0f} s"
            return JSONResponse({"status": "STALLED", "reason": reason}, 503, SAFE)
        health = snapshot.document["sessions"][0]["health"]
        code = 503 if health["at_end"] == Health.LOST.name else 200
        return JSONResponse({"status": health["at_end"], "reason": health["reason"]}, code, SAFE)


def serve(
    address: str, settings: HttpSettings, stack: contextlib.ExitStack
) -> tuple[Board, WebServer]:
    """Serve a new board until `stack` is closed. Raises `ConfigError`."""
    try:
        place = read_address(address)
    except ValueError as error:
        raise ConfigError(f"--http: {error}") from None
    board = Board()
    server = WebServer(place, board, settings.hosts)
    stack.callback(server.close)
    server.start()
    return board, server


def _styles() -> dict[str, tuple[bytes, str]]:
    """The project's colours for the page: as CSS variables, and lines as a script."""
    colours = {
        "ink": style.INK,
        "quiet": style.FAINT,
        "paper": style.PAPER,
        "line": style.GRID,
        "good": style.GOOD,
        "warn": style.WARNING,
        "bad": style.BAD,
    } | {name: each.colour for name, each in style.SOURCES.items()}
    variables = "".join(f"--{name}:{colour};" for name, colour in colours.items())
    lines = {name: each.as_dict() for name, each in style.SOURCES.items()}
    return {
        "/style.css": (f":root{{{variables}}}".encode(), "text/css; charset=utf-8"),
        "/style.js": (
            f"const STYLE={json.dumps(lines)};".encode(),
            "text/javascript; charset=utf-8",
        ),
    }


def _listen(address: Address) -> socket.socket:
    family = socket.AF_INET6 if ":" in address.host else socket.AF_INET
    return socket.create_server((address.host, address.port), family=family, backlog=16)
