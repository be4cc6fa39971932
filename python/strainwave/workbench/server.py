"""Start the workbench."""

from __future__ import annotations

import os
import socket
from urllib.parse import quote

from strainwave.errors import InvalidInput, import_optional
from strainwave.workbench.options import ServerOptions, check_options


def serve(options: ServerOptions) -> None:
    """Serve the folder until Ctrl-C.

    Raises InvalidInput if the options are invalid, if the port is in use, or if the packages of the
    extra `serve` are missing.
    """
    check_options(options)
    for module in ("uvicorn", "starlette", "tomlkit"):
        import_optional(module, "the workbench", "markdown-it-py starlette tomlkit uvicorn")
    import uvicorn

    from strainwave.workbench.app import create_app

    listener = _listen(options)
    port = listener.getsockname()[1]
    address = f"[{options.host}]" if ":" in options.host else options.host
    app = create_app(options, port)
    link = f"http://{address}:{port}/?token={quote(options.token, safe='')}"
    print(f"strainwave serves {options.folder} at {link}", flush=True)
    print("Ctrl-C ends the server; runs go on.", flush=True)
    config = uvicorn.Config(app, log_level="warning", access_log=False, timeout_graceful_shutdown=1)
    uvicorn.Server(config).run(sockets=[listener])


def _listen(options: ServerOptions) -> socket.socket:
    family = socket.AF_INET6 if ":" in options.host else socket.AF_INET
    listener = socket.socket(family)
    if os.name == "posix":  # elsewhere a second server could take the same port
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
