"""First page: the studies of the folder."""

from __future__ import annotations

from starlette.requests import Request
from starlette.responses import Response

from strainwave.workbench.web import get_page, page, workspace_of


def show_home(request: Request) -> Response:
    """The studies of the folder."""
    return page(request, "home", "Studies", studies=workspace_of(request).studies())


ROUTES = (get_page("/", show_home),)
