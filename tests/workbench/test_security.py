"""Refusals: other sites, other hosts, paths out of the folder, large uploads, code in files."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from strainwave.errors import InvalidInput
from strainwave.workbench.options import TOKEN_VARIABLE, ServerOptions, token_from
from strainwave.workbench.workspace import Workspace
from workbench_client import TOKEN, make_client

pytest.importorskip("starlette")

if TYPE_CHECKING:
    from starlette.testclient import TestClient


def test_a_foreign_host_name_is_refused(client: TestClient) -> None:
    assert client.get("/", headers={"host": "attacker.example:8765"}).status_code == 400


@pytest.mark.parametrize(
    "headers",
    [
        {"origin": "http://attacker.example"},
        {"origin": "null"},
        {"origin": "http://127.0.0.1:9999"},
        {"sec-fetch-site": "cross-site", "sec-fetch-mode": "no-cors"},
        {"sec-fetch-site": "same-site", "sec-fetch-mode": "cors"},
    ],
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_requests_of_other_sites_are_refused(
    client: TestClient, headers: dict[str, str], method: str
) -> None:
    answer = client.request(method, "/api/runs/arm/study.toml", headers=headers)
    assert answer.status_code == 403


def test_a_link_of_another_site_may_open_a_page(client: TestClient) -> None:
    headers = {
        "sec-fetch-site": "cross-site",
        "sec-fetch-mode": "navigate",
        "sec-fetch-dest": "document",
    }
    assert client.get("/", headers=headers).status_code == 200


def test_every_response_has_a_strict_policy(client: TestClient) -> None:
    for path in ("/", "/static/workbench.css", "/api/runs/arm/study.toml", "/no-such-page"):
        policy = client.get(path).headers["content-security-policy"]
        scripts = next(p for p in policy.split(";") if p.strip().startswith("script-src"))
        assert scripts.strip() == "script-src 'self'"
        assert "default-src 'none'" in policy


@pytest.mark.parametrize(
    "path", ["../secret.toml", "%2e%2e/secret.toml", "/etc/passwd", "arm/../../secret.toml"]
)
def test_paths_out_of_the_folder_are_refused(client: TestClient, folder: Path, path: str) -> None:
    (folder.parent / "secret.toml").write_text("[arm]\n")
    assert client.get(f"/api/runs/{path}").status_code in (400, 404)


def test_a_symbolic_link_does_not_lead_out_of_the_folder(folder: Path) -> None:
    (folder.parent / "secret.toml").write_text("[arm]\n")
    (folder / "link.toml").symlink_to(folder.parent / "secret.toml")
    with pytest.raises(InvalidInput, match="leads out of the served folder"):
        Workspace(folder.resolve(), 1).study("link.toml")


@pytest.mark.parametrize("token", ["secret", 'a;b c=ü%&+"', "geheïm"])
def test_a_client_needs_the_token(folder: Path, token: str) -> None:
    from starlette.testclient import TestClient

    from strainwave.workbench.app import create_app

    app = create_app(ServerOptions(folder, "0.0.0.0", token=token), 8765)
    client = TestClient(app, base_url="http://rig.example:8765")
    assert client.get("/").status_code == 401
    assert client.get("/?token=wrong").status_code == 401
    assert client.get("/?token=geheïm2&token=2").status_code == 401
    assert client.get("/", params={"token": token}).status_code == 200  # by the redirection
    assert client.get("/").status_code == 200  # by its cookie


@pytest.mark.parametrize("other", ['a={"b": 1}', "=;;", 'x="; y', "strainwave-9999=other"])
def test_cookies_of_other_applications_do_not_matter(folder: Path, other: str) -> None:
    client = make_client(folder)
    client.cookies.clear()
    own = f"strainwave-8765={TOKEN}"
    assert client.get("/", headers={"cookie": f"{other}; {own}"}).status_code == 200
    assert client.get("/", headers={"cookie": f"{own}; {other}"}).status_code == 200
    assert client.get("/", headers={"cookie": other}).status_code == 401


def test_a_token_is_new_unless_a_file_or_the_environment_has_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv(TOKEN_VARIABLE, raising=False)
    assert token_from(None) != token_from(None)
    assert ServerOptions(tmp_path).token != ServerOptions(tmp_path).token
    monkeypatch.setenv(TOKEN_VARIABLE, "of the environment")
    assert token_from(None) == "of the environment"
    file = tmp_path / "token"
    file.write_text("of the file\n")
    assert token_from(file) == "of the file"
    file.write_text("\n")
    with pytest.raises(InvalidInput, match="the token is empty"):
        token_from(file)
