"""Licences of locked packages are free, and other licences are detected."""

from __future__ import annotations

import shutil

import pytest
from benchmarks.licences import EXAMINED, Licensed, of_python, of_rust


def test_locked_packages_are_free() -> None:
    packages = list(of_python())
    assert len(packages) > 50
    assert [p for p in packages if not p.free and p.name not in EXAMINED] == []


@pytest.mark.skipif(shutil.which("cargo") is None, reason="cargo is not installed")
def test_locked_crates_are_free() -> None:
    assert [crate for crate in of_rust() if not crate.free] == []


@pytest.mark.parametrize(
    ("licence", "free"),
    [
        ("MIT", True),
        ("Apache-2.0 WITH LLVM-exception", True),
        ("MIT OR GPL-3.0-only", True),
        ("MIT OR Apache-2.0 OR LGPL-2.1-or-later", True),
        ("(MIT OR Apache-2.0) AND Unicode-3.0", True),
        ("License :: OSI Approved :: BSD License", True),
        ("GPL-3.0-only", False),
        ("MIT AND AGPL-3.0-or-later", False),
        ("License :: OSI Approved :: GNU General Public License v3 (GPLv3)", False),
        ("Proprietary", False),
        ("unknown", False),
    ],
)
def test_a_licence_is_free_if_one_alternative_is(licence: str, free: bool) -> None:
    assert Licensed("package", "1", licence).free == free
