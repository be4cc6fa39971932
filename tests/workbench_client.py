"""A client of the workbench without a server."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from starlette.testclient import TestClient

BASE, TOKEN = "http://127.0.0.1:8765", "the-token-of-the-tests"


def make_client(folder: Path, **options: Any) -> TestClient:
    """A client, with the token, of the application without a server; it raises what a page raises."""
    from starlette.testclient import TestClient

    from strainwave.workbench.app import create_app
    from strainwave.workbench.options import ServerOptions

    app = create_app(ServerOptions(folder, token=TOKEN, **options), 8765)
    return TestClient(app, base_url=BASE, cookies={"strainwave-8765": TOKEN})
