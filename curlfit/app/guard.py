"""Who may see the page: the browser that its user opened, and nobody else."""

from __future__ import annotations

import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from http import HTTPStatus
from http.cookies import CookieError, SimpleCookie
from typing import Any

_Message = MutableMapping[str, Any]
_Receive = Callable[[], Awaitable[_Message]]
_Send = Callable[[_Message], Awaitable[None]]
_App = Callable[[_Message, _Receive, _Send], Awaitable[None]]

_POLICY_VIOLATION = 1008  # with which a web socket is closed
_ALWAYS = {
    "referrer-policy": "no-referrer",
    "x-content-type-options": "nosniff",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
}
# Vue makes its functions from text.
_OF_PAGE = (
    "default-src 'self'; connect-src 'self' ws://{host}; img-src 'self' data:; "
    "script-src 'self' 'unsafe-inline' 'unsafe-eval'; font-src 'self' data:; "
    "style-src 'self' 'unsafe-inline'; object-src 'none'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
# A result, or a file that was dropped: its scripts are of no origin, so that they
# reach neither the page nor its cookie.
_OF_RESULTS = (
    "sandbox allow-scripts; default-src 'none'; script-src 'unsafe-inline'; "
    "style-src 'unsafe-inline'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'self'"
)
_ENTERED = (
    '<!doctype html><meta charset="utf-8"><title>curlfit</title>'
    '<meta http-equiv="refresh" content="0;url={path}">'
)


class Guard:
    """The server of the page behind a cookie.

    An address is good for one visit: it gives the browser a cookie that no script can
    read and no other site sends, and the path of the page. That path is a secret too,
    since a browser sends a cookie to all ports of this computer, but to one path alone.

    Attributes
    ----------
    path : of the page. cookie : its name.
    opened : called when an address was used.
    """

    def __init__(self, host: str, port: int, opened: Callable[[], None]) -> None:
        self.path = f"/{secrets.token_urlsafe(24)}"
        self.cookie = f"curlfit-{port}"
        self.opened = opened
        self._host = f"{host}:{port}"
        self._value = secrets.token_urlsafe(24)
        self._addresses: set[str] = set()

    def new_address(self) -> str:
        """An address for one visit."""
        path = f"/{secrets.token_urlsafe(24)}/"
        self._addresses.add(path)
        return f"http://{self._host}{path}"

    def around(self, served: _App, most_bytes: int) -> _App:
        """The server of what only the user may see, with uploads of at most so
        many bytes."""

        async def guarded(scope: _Message, receive: _Receive, send: _Send) -> None:
            if scope["type"] == "lifespan":
                await served(scope, receive, send)
                return
            headers = {
                name.decode("latin-1"): value.decode("latin-1")
                for name, value in scope["headers"]
            }
            if self._is_first_visit(scope, headers):
                self.opened()
                # by a link of its own: with one from another site the browser would
                # not send the cookie
                entered = _ENTERED.format(path=f"{self.path}/")
                await _answer(send, HTTPStatus.OK, entered, cookie)
                return
            refusal = self._refusal(scope, headers, most_bytes)
            if refusal is None:
                await served(scope, receive, self._answering(scope, send))
            elif scope["type"] == "websocket":
                await receive()
                await send({"type": "websocket.close", "code": _POLICY_VIOLATION})
            else:
                await _answer(send, refusal)

        cookie = (
            f"{self.cookie}={self._value}; Path={self.path}/; HttpOnly; SameSite=Strict"
        )
        return guarded

    def _is_first_visit(self, scope: _Message, headers: dict[str, str]) -> bool:
        """Whether this is the one visit of an address, which has no further one."""
        is_visit = scope["type"] == "http" and scope["method"] == "GET"
        if not is_visit or headers.get("host") != self._host:
            return False
        if scope["path"] not in self._addresses:
            return False
        self._addresses.remove(scope["path"])
        return True

    def _refusal(
        self, scope: _Message, headers: dict[str, str], most_bytes: int
    ) -> HTTPStatus | None:
        """The status with which a request is refused; None if it may be served."""
        if headers.get("host") != self._host:
            return HTTPStatus.NOT_FOUND
        if not scope["path"].startswith(f"{self.path}/"):
            return HTTPStatus.NOT_FOUND
        origin = f"http://{self._host}"
        if headers.get("origin", origin) != origin:
            return HTTPStatus.FORBIDDEN
        try:
            cookies = SimpleCookie(headers.get("cookie", ""))
        except CookieError:
            return HTTPStatus.FORBIDDEN
        cookie = cookies.get(self.cookie)
        if cookie is None or not secrets.compare_digest(cookie.value, self._value):
            return HTTPStatus.FORBIDDEN
        has_no_body = scope.get("method", "GET") in ("GET", "HEAD")
        length = headers.get("content-length", "0" if has_no_body else "unknown")
        if not length.isdecimal() or int(length) > most_bytes:
            return HTTPStatus.REQUEST_ENTITY_TOO_LARGE
        return None

    def _answering(self, scope: _Message, send: _Send) -> _Send:
        """Sending with the headers that limit what a page or a result may do."""
        is_result = scope["path"].startswith(f"{self.path}/results/")
        policy = _OF_RESULTS if is_result else _OF_PAGE.format(host=self._host)

        async def answer(message: _Message) -> None:
            if message["type"] == "http.response.start":
                # without those of socket.io, which lets any origin in
                headers = [
                    (name, value)
                    for name, value in message.get("headers", [])
                    if not name.lower().startswith(b"access-control-")
                ]
                headers += _encoded(_ALWAYS | {"content-security-policy": policy})
                message["headers"] = headers
            await send(message)

        return answer


def _encoded(headers: dict[str, str]) -> list[tuple[bytes, bytes]]:
    """Headers as ASGI has them."""
    return [(name.encode(), value.encode()) for name, value in headers.items()]


async def _answer(
    send: _Send, status: HTTPStatus, text: str = "", cookie: str = ""
) -> None:
    """Send a whole answer, with a cookie if one is given."""
    headers = _ALWAYS | {
        "content-type": "text/html; charset=utf-8",
        "content-length": str(len(text)),
        "content-security-policy": "default-src 'none'; frame-ancestors 'none'",
        "cache-control": "no-store",
    }
    if cookie:
        headers["set-cookie"] = cookie
    await send(
        {
            "type": "http.response.start",
            "status": status.value,
            "headers": _encoded(headers),
        }
    )
    await send({"type": "http.response.body", "body": text.encode()})
