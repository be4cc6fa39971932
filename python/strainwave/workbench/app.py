"""The web application: its pages, files and protection."""

from __future__ import annotations

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from strainwave.presentation.report.blocks import plotly_script
from strainwave.workbench.pages import ROUTES
from strainwave.workbench.security import Guard, allowed_hosts
from strainwave.workbench.server import ServerOptions
from strainwave.workbench.web import HANDLED, HERE, error_response
from strainwave.workbench.workspace import Workspace

_DAY = "max-age=86400"


def create_app(options: ServerOptions, port: int) -> Starlette:
    """The application that serves a folder on a port."""
    hosts = allowed_hosts(options.host, port) if options.is_local else None
    app = Starlette(
        routes=[
            *ROUTES,
            Route("/plotly.js", _plotly),
            Mount("/static", StaticFiles(directory=HERE / "static")),
        ],
        middleware=[Middleware(Guard, hosts=hosts, token=options.token)],
        exception_handlers=dict.fromkeys(HANDLED, error_response),
    )
    app.state.workspace = Workspace(options.folder.resolve(), options.max_upload_mib << 20)
    return app


def _plotly(_request: Request) -> Response:
    """The script of the installed plotly package, which reports contain as well."""
    return FileResponse(
        plotly_script(), media_type="text/javascript", headers={"cache-control": _DAY}
    )
