"""The web application: its pages, files and protection."""

from __future__ import annotations

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from strainwave.report.document.blocks import plotly_script
from strainwave.workbench.options import ServerOptions
from strainwave.workbench.pages import (
    by_hand,
    check,
    compare,
    design,
    estimate,
    help,
    home,
    runs,
    signals,
    study,
    virtual,
)
from strainwave.workbench.security import Guard, allowed_hosts
from strainwave.workbench.web import HANDLED, HERE, error_response
from strainwave.workbench.workspace import Workspace

_PAGES = (home, help, study, check, signals, estimate, compare, by_hand, design, virtual, runs)
ROUTES = [route for page in _PAGES for route in page.routes]


def create_app(options: ServerOptions, port: int) -> Starlette:
    """The application that serves a folder on a port."""
    hosts = allowed_hosts(options.host, port) if options.is_local else None
    app = Starlette(
        routes=[
            *ROUTES,
            Route("/plotly.js", _plotly),  # of the installed package, as in reports
            Mount("/static", StaticFiles(directory=HERE / "static")),
        ],
        middleware=[Middleware(Guard, hosts=hosts, port=port, token=options.token)],
        exception_handlers=dict.fromkeys(HANDLED, error_response),
    )
    allowed = tuple(folder.resolve() for folder in options.allowed)
    app.state.workspace = Workspace(options.folder.resolve(), options.max_upload_mib << 20, allowed)
    return app


def _plotly(_request: Request) -> Response:
    headers = {"cache-control": "max-age=86400"}  # a day
    return FileResponse(plotly_script(), media_type="text/javascript", headers=headers)
