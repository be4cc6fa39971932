"""The web application: its pages, files and protection, and the server that starts it."""

from __future__ import annotations

import ipaddress
import os
import socket
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import FileResponse, Response
from starlette.routing import Mount, Route
from starlette.staticfiles import StaticFiles

from strainwave.errors import InvalidInput, import_optional
from strainwave.workbench.pages import ROUTES
from strainwave.workbench.security import Guard, allowed_hosts
from strainwave.workbench.web import HANDLED, HERE, error_response
from strainwave.workbench.workspace import Workspace


@dataclass(frozen=True, slots=True)
class ServerOptions:
    """Where the workbench listens, and what it accepts."""

    folder: Path
    host: str = "127.0.0.1"
    port: int = 8765  # 0: any free port
    token: str = ""  # required from clients unless empty
    max_upload_mib: int = 2048  # of one file

    @property
    def is_local(self) -> bool:
        """Whether only this machine reaches the host."""
        if self.host == "localhost":
            return True
        try:
            return ipaddress.ip_address(self.host).is_loopback
        except ValueError:
            return False


def check_options(options: ServerOptions) -> None:
    """Raise InvalidInput if the folder does not exist, or if others could use the server."""
    if os.name != "posix":  # runs are process groups with locks
        raise InvalidInput(
            "the workbench runs on Linux and macOS only", remedy="use the command line"
        )
    if not options.folder.is_dir():
        raise InvalidInput(
            "is not a folder", where=str(options.folder), remedy="name the folder of your studies"
        )
    if not options.is_local and not options.token:
        raise InvalidInput(
            f"other machines reach {options.host}, and --token is missing",
            where="--host",
            remedy="add --token with a secret, or leave --host out",
        )


def serve(options: ServerOptions) -> None:
    """Serve the folder until Ctrl-C.

    Raises InvalidInput if the options are invalid, if the port is in use, or if the packages of the
    extra `serve` are missing.
    """
    check_options(options)
    uvicorn = import_optional("uvicorn", "the workbench", "strainwave[serve]")
    for module in ("starlette", "tomlkit"):
        import_optional(module, "the workbench", "strainwave[serve]")
    from strainwave.workbench.server import create_app

    listener = _listen(options)
    port = listener.getsockname()[1]
    address = f"[{options.host}]" if ":" in options.host else options.host
    query = f"?token={options.token}" if options.token else ""
    app = create_app(options, port)
    print(f"strainwave serves {options.folder} at http://{address}:{port}/{query}", flush=True)
    print("Ctrl-C ends the server; runs go on.", flush=True)
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1)
    uvicorn.Server(config).run(sockets=[listener])


def _listen(options: ServerOptions) -> socket.socket:
    """A listening socket; raises InvalidInput if the address or the port is not available."""
    family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
    listener = socket.socket(family)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        listener.bind((options.host, options.port))
        listener.listen(128)  # a client that connects now waits for the application
    except OSError as error:
        listener.close()
        raise InvalidInput(
            f"cannot listen on {options.host}, port {options.port}: {error.strerror}",
            where="--port",
            remedy="choose another port, or 0 for any free one",
        ) from error
    return listener


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
    spec = find_spec("plotly")
    if spec is None or spec.origin is None:
        raise ModuleNotFoundError("plotly")
    script = Path(spec.origin).parent / "package_data" / "plotly.min.js"
    return FileResponse(script, media_type="text/javascript", headers={"cache-control": _DAY})
