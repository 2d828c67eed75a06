"""What a browser may ask for: only under this server's own names, changes only from its own pages, bodies of a size.

Loopback alone is no protection: a page of somebody else's, open in the same browser, can send requests to it (CSRF),
and can make its own name point to it (DNS rebinding) to read the answers.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Iterable
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

SAFE_METHODS = ("GET", "HEAD")
PAGE_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
REPORT_POLICY = (
    "sandbox allow-scripts allow-downloads; default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; "
    "img-src data:; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
_HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",  # with "no-referrer" browsers send no usable Origin with a form
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Permissions-Policy": "camera=(), microphone=(), geolocation=()",
}
ROOM_FOR_FORM = 1_000_000  # bytes of a request besides its file


class TooLarge(Exception):
    """A body grew beyond what is taken."""


class Guard:
    """ASGI middleware that refuses what no page of this server asks for, and adds the headers that keep pages apart.

    Args:
        app: what is guarded.
        hosts: names that this server may be called by, besides localhost and addresses of numbers, which no foreign
            page can make its own.
        largest: body of a request [bytes].
    """

    def __init__(self, app: ASGIApp, hosts: Iterable[str], largest: int) -> None:
        self.app = app
        self.hosts = {name.lower() for name in hosts} | {"localhost"}
        self.largest = largest + ROOM_FOR_FORM

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            await self.app(scope, receive, send)
            return
        refused = self._refusal(scope["method"], Headers(scope=scope))
        if refused is not None:
            await refused(scope, receive, send)
            return
        taken = 0

        async def limited() -> Message:
            nonlocal taken
            message = await receive()
            taken += len(message.get("body", b""))
            if taken > self.largest:
                raise TooLarge
            return message

        async def guarded(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
                headers.setdefault("Content-Security-Policy", PAGE_POLICY)
                headers.setdefault("Cache-Control", "no-store")
            await send(message)

        await self.app(scope, limited, guarded)

    def _refusal(self, method: str, headers: Headers) -> PlainTextResponse | None:
        host = headers.get("host", "")
        if not self._is_ours(host):
            return _refused(421, "This server isn't called that. Start it with --name NAME to call it by another name.")
        if method not in SAFE_METHODS:
            origin, site = headers.get("origin"), headers.get("sec-fetch-site")
            foreign = urlsplit(origin).netloc != host if origin is not None else site != "same-origin"
            if foreign:
                return _refused(403, "Only this server's own pages may change something here (Origin).")
        length = headers.get("content-length", "0")
        if not length.isdigit() or int(length) > self.largest:
            return _refused(413, f"Too large: at most {self.largest // 1_000_000} MB are taken.")
        return None

    def _is_ours(self, host: str) -> bool:
        try:
            name = urlsplit(f"//{host}").hostname or ""
        except ValueError:
            return False
        if name in self.hosts:
            return True
        try:
            ipaddress.ip_address(name)
        except ValueError:
            return False
        return True


def _refused(status: int, words: str) -> PlainTextResponse:
    return PlainTextResponse(words, status, headers={**_HEADERS, "Connection": "close"})
