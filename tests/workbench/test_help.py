"""Help: a page for each topic, from the package alone."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

pytest.importorskip("starlette")

from strainwave.domain.messages import catalogue
from strainwave.domain.study import study_keys
from strainwave.workbench.web import PAGE_TABS, STUDY_TABS

if TYPE_CHECKING:
    from starlette.testclient import TestClient


@pytest.mark.parametrize("tab", [*PAGE_TABS, *STUDY_TABS], ids=lambda tab: tab[1])
def test_each_page_has_its_help(client: TestClient, tab: tuple[str, str, str]) -> None:
    key, title, _ = tab
    path = f"/{key}" if tab in PAGE_TABS else f"/{key}/arm/study.toml"
    topic = f'href="/help/{key or "studies"}"'
    assert topic in client.get(path).text
    answer = client.get(f"/help/{key or 'studies'}")
    assert answer.status_code == 200
    assert f"<h1>{title}</h1>" in answer.text


def test_help_has_each_warning_and_each_key(client: TestClient) -> None:
    warnings, keys = client.get("/help/warnings").text, client.get("/help/keys").text
    assert all(f"<h2>{code}</h2>" in warnings for code in catalogue())
    assert all(f"<code>{key.key}</code>" in keys for key in study_keys()["joint"])
    assert "](" not in keys


def test_unknown_help_is_refused(client: TestClient) -> None:
    answer = client.get("/help/nothing")
    assert answer.status_code == 400
    assert "there is no such help" in answer.json()["error"]


def test_letters_of_pages_are_unique() -> None:
    for tabs in (PAGE_TABS, STUDY_TABS):
        assert len({letter for _, _, letter in tabs}) == len(tabs)
