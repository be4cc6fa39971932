"""Protection of the workbench: host, origin, token, and headers of every response.

A page of another site that is open in the same browser must neither read nor change anything here,
and a file of the folder must not run as code.
"""

from __future__ import annotations

import hmac
from collections.abc import Iterator, Sequence
from urllib.parse import parse_qs, quote, unquote, urlencode, urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse, RedirectResponse, Response
from starlette.types import ASGIApp, Message, Receive, Scope, Send

_SAFE_METHODS = ("GET", "HEAD")
_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:"
    " blob:; connect-src 'self'; form-action 'self'; frame-src 'self'; base-uri 'none';"
    " frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": _POLICY,
    "x-content-type-options": "nosniff",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}
"""Headers of every response that does not set them itself."""


def allowed_hosts(host: str, port: int) -> frozenset[str]:
    """Values of the Host header under which the server answers."""
    names = {"127.0.0.1", "localhost", "[::1]", f"[{host}]" if ":" in host else host}
    return frozenset(f"{name}:{port}" for name in names)


class Guard:
    """Refuses requests of other sites and of clients without the token; adds the headers.

    `hosts` are the accepted Host headers; without it, any host is accepted (another machine may
    know the server by any name, and the token protects it).
    """

    def __init__(self, app: ASGIApp, hosts: frozenset[str] | None, port: int, token: str) -> None:
        self._app, self._hosts, self._token = app, hosts, token
        self._cookie = f"strainwave-{port}"  # browsers send a cookie to all ports of a host

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer a request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        answer = self._refusal(scope) or self._app
        await answer(scope, receive, _with_headers(send))

    def _refusal(self, scope: Scope) -> Response | None:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if self._hosts is not None and host not in self._hosts:
            return PlainTextResponse(f"The workbench does not answer as {host!r}.", 400)
        if _is_cross_site(headers, host, scope["method"]):
            return PlainTextResponse("Requests of other sites are refused.", 403)
        return self._token_refusal(scope, headers)

    def _token_refusal(self, scope: Scope, headers: Headers) -> Response | None:
        """None if the client has the token as a cookie; a token in the address sets the cookie."""
        if any(map(self._is_token, self._cookies(headers))):
            return None
        query = parse_qs(scope["query_string"].decode("latin-1"))
        given = query.pop("token", [""])[0]
        if scope["method"] == "GET" and self._is_token(given):
            rest = urlencode(query, doseq=True)
            answer = RedirectResponse(f"{scope['path']}{'?' if rest else ''}{rest}", 303)
            value = quote(self._token, safe="")
            answer.set_cookie(self._cookie, value, httponly=True, samesite="lax")
            return answer
        return PlainTextResponse(
            "This workbench needs a token: open the address that strainwave serve printed.", 401
        )

    def _cookies(self, headers: Headers) -> Iterator[str]:
        """Values of the cookie; those of other applications may have any form."""
        for header in headers.getlist("cookie"):
            for part in header.split(";"):
                name, _, value = part.strip().partition("=")
                if name == self._cookie:
                    yield unquote(value.strip('"'))

    def _is_token(self, given: str) -> bool:
        return hmac.compare_digest(given.encode(), self._token.encode())


def _is_cross_site(headers: Headers, host: str, method: str) -> bool:
    """Whether another site made the request. Its links may open a page, nothing else."""
    origin = headers.get("origin")
    if origin is not None and urlsplit(origin).netloc != host:
        return True
    site = headers.get("sec-fetch-site", "none")
    if site in ("none", "same-origin"):
        return False
    is_navigation = headers.get("sec-fetch-mode") == "navigate"
    is_page = headers.get("sec-fetch-dest") == "document"
    return not (method in _SAFE_METHODS and is_navigation and is_page)


def _with_headers(send: Send) -> Send:
    async def send_with_headers(message: Message) -> None:
        if message["type"] == "http.response.start":
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
        await send(message)

    return send_with_headers


def report_policy(script_hashes: Sequence[str]) -> str:
    """Policy of a report in a frame: its known scripts run, without access to the workbench."""
    scripts = " ".join(f"'{value}'" for value in script_hashes)
    return (
        f"sandbox allow-scripts allow-downloads; default-src 'none'; script-src {scripts};"
        " style-src 'unsafe-inline'; img-src data: blob:; frame-ancestors 'self'"
    )
