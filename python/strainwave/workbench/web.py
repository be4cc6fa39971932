"""Requests and responses of the pages: HTML from templates, JSON, and errors as sentences."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import quote

from pydantic_core import to_json
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, Response
from starlette.routing import BaseRoute, Route

from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.io.atomic_files import FULL
from strainwave.io.templates import template_environment
from strainwave.workbench.workspace import ACCEPTED, Workspace, abbreviated

if TYPE_CHECKING:
    from jinja2 import Environment

HERE = Path(__file__).parent
_STATIC = sorted(path.name for path in (HERE / "static").iterdir())
MAX_BODY = 4 << 20  # [bytes] of a JSON request

PAGE_TABS = (
    ("", "Studies", "H"),
    ("import", "Import logs", "I"),
    ("virtual", "Virtual arm", "V"),
)
"""Address, title, and letter of the keyboard, of the pages of the folder."""
STUDY_TABS = (
    ("study", "Study", "S"),
    ("check", "Check", "C"),
    ("signals", "Signals", "L"),
    ("estimate", "Estimate", "E"),
    ("compare", "Compare", "P"),
    ("by-hand", "By hand", "B"),
    ("design", "Design", "D"),
    ("files", "Files", "F"),
)
"""The same of the pages of one study, in the order of the work."""

Body = Mapping[str, Any]
Answer = TypeVar("Answer", bound=Callable[..., Any])


def workspace_of(request: Request) -> Workspace:
    """The served folder."""
    workspace: Workspace = request.app.state.workspace
    return workspace


def study_of(request: Request) -> Path:
    """The study file that the address names; its files lie in the served folder."""
    return workspace_of(request).study(request.path_params["study"])


def study_file_of(request: Request) -> Path:
    """The study file that the address names, to be corrected; its files are not to be read."""
    return workspace_of(request).study_file(request.path_params["study"])


def page(request: Request, template: str, title: str, **values: Any) -> HTMLResponse:
    """A page from a template of `templates/`, named without its ending.

    A page of a study gets the tabs of all pages; `study` and `workspace` are its template values. A
    page has the style and the script of its name in `static/`.
    """
    study = request.path_params.get("study")
    key = request.url.path.split("/")[1]
    tabs = STUDY_TABS if study else PAGE_TABS
    topic = key if key and any(key == tab[0] for tab in tabs) else "studies"
    text = _templates().get_template(f"{template}.html.j2")
    values |= {"title": title, "study": study, "tabs": tabs, "topic": topic, "accepted": ACCEPTED}
    values |= {"files": [file for file in _STATIC if file.startswith(f"{template}.")]}
    values |= {"path": request.url.path, "folder": workspace_of(request).folder.name}
    return HTMLResponse(text.render(values))


def json_response(value: object, status: int = 200) -> Response:
    """A value as JSON; a number that is not finite is null."""
    body = to_json(value, inf_nan_mode="null")
    return Response(body, status, media_type="application/json")


class Routes(list[BaseRoute]):
    """The addresses of one page, in the order of the functions that answer them.

    Functions run in a thread unless they are coroutines.
    """

    def page(self, path: str, method: str = "GET") -> Callable[[Answer], Answer]:
        """Let a function answer an address."""

        def add(answer: Answer) -> Answer:
            self.append(Route(path, answer, methods=[method]))
            return answer

        return add

    def get(self, path: str) -> Callable[[Answer], Answer]:
        """Let an address return the value of `function(request)` as JSON."""
        return self._json(path, "GET")

    def post(self, path: str) -> Callable[[Answer], Answer]:
        """Let an address that gets JSON return the value of `function(request, body)` as JSON."""
        return self._json(path, "POST")

    def _json(self, path: str, method: str) -> Callable[[Answer], Answer]:
        def add(answer: Answer) -> Answer:
            async def endpoint(request: Request) -> Response:
                body = [await read_body(request)] if method == "POST" else []
                return json_response(await run_in_threadpool(answer, request, *body))

            self.append(Route(path, endpoint, methods=[method]))
            return answer

        return add


async def read_body(request: Request) -> Body:
    """The JSON object of a request.

    Raises InvalidInput if it is none, or exceeds the limit.
    """
    from pydantic_core import from_json

    data = bytearray()
    async for chunk in request.stream():
        data += chunk
        if len(data) > MAX_BODY:
            raise InvalidInput(f"the request has more than {MAX_BODY >> 20} MiB", where="request")
    try:
        value = from_json(bytes(data) or b"{}")
    except ValueError as error:
        raise InvalidInput("the request is not JSON", where="request") from error
    if not isinstance(value, dict):
        raise InvalidInput("the request is not a JSON object", where="request")
    return value


def text_of(body: Body, key: str, default: str | None = None) -> str:
    """A text of a request; raises InvalidInput if it is missing or not a text."""
    value = body.get(key, default)
    if not isinstance(value, str):
        raise InvalidInput(f"the request has no text {key!r}", where="request")
    return value


def error_response(request: Request, error: Exception) -> Response:
    """The message of the command line; as a page, or as JSON for a script."""
    status = 422 if isinstance(error, NotIdentifiable | NumericalFailure) else 400
    cause = error if isinstance(error, OSError) else error.__cause__
    if isinstance(cause, OSError) and cause.errno in FULL:
        status = 507
    message = message_of(request, error)
    if request.headers.get("sec-fetch-dest") == "document":
        answer = page(request, "error", "Error", message=message)
        answer.status_code = status
        return answer
    where = message_of(request, getattr(error, "where", None) or "")  # a field, if there is one
    return json_response({"error": message, "where": where}, status)


def message_of(request: Request, error: Exception | str) -> str:
    """The message of an error, with paths relative to the served folder."""
    if isinstance(error, OSError):  # a name that is too long, no permission, no space
        name = abbreviated(os.fspath(error.filename)) if error.filename else None
        remedy = "make space on the disk" if error.errno in FULL else "check names and permissions"
        error = InvalidInput(f"cannot be used ({error.strerror})", where=name, remedy=remedy)
    if isinstance(error, OverflowError):  # an integer of hundreds of digits
        error = InvalidInput("a number is too large", remedy="correct the number")
    return str(error).replace(f"{workspace_of(request).folder}/", "")


HANDLED = (InvalidInput, NotIdentifiable, NumericalFailure, OSError, OverflowError)
"""Errors whose message is the answer."""


@cache
def _templates() -> Environment:
    def read(name: str) -> str:
        return (HERE / "templates" / name).read_text(encoding="utf-8")

    environment = template_environment(read, autoescape=True)
    environment.filters["address"] = quote  # a path of the folder as part of an address
    return environment
