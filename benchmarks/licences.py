"""Licences of all that is locked: `python -m benchmarks.licences`. Needs no network.

What is installed says its own licence, and so does every crate that cargo has fetched. A package
whose licence does not let everyone use strainwave is listed last, and is an error.

Advisories are not checked here: the databases of known faults (OSV, RustSec, PyPA) change by the
day and none is published as a package that could be locked, so a copy in this repository would say
"nothing known" of an old date. With a network: `pip-audit -r requirements.lock`, `cargo audit`.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from rich.console import Console
from rich.table import Table

ROOT = Path(__file__).parents[1]
FREE = {
    "0BSD",
    "APACHE",
    "BSD",
    "CC0",
    "ISC",
    "MIT",
    "MOZILLA",
    "MPL",
    "PSF",
    "UNICODE",
    "UNLICENSE",
    "ZLIB",
    "PYTHON SOFTWARE FOUNDATION",
    "PUBLIC DOMAIN",
}
"""Beginnings of licences under which a dependency may be used by everyone."""

EXAMINED = {
    "apsw": "any licence that the Open Source Initiative has approved",
    "docutils": "public domain and BSD; one of its files, an editor's mode, is under the GPL",
}
"""Packages whose metadata do not settle it -> what was found."""


@dataclass(frozen=True, slots=True)
class Licensed:
    """A locked package and what it says of its licence."""

    name: str
    version: str
    licence: str

    @property
    def free(self) -> bool:
        """Whether one of the alternatives that it offers is free in all its parts."""
        return any(
            all(_is_free(part) for part in re.split(r" AND | and |; ", alternative))
            for alternative in re.split(r" OR | or |/", self.licence.replace("License ::", ""))
        )


def _is_free(licence: str) -> bool:
    own = licence.replace("OSI Approved ::", "").strip(" ():").upper()
    return any(own.startswith(name) for name in FREE)


def of_python() -> Iterator[Licensed]:
    """Packages of requirements.lock that are installed."""
    for line in (ROOT / "requirements.lock").read_text().splitlines():
        name, found, rest = line.partition("==")
        if not found:
            continue
        try:
            said = metadata.metadata(name)
        except metadata.PackageNotFoundError:
            continue  # for another system
        yield Licensed(name, rest.split()[0], _of_metadata(said))


def _of_metadata(said: metadata.PackageMetadata) -> str:
    fields = said.json
    classes = [c for c in said.get_all("Classifier") or [] if c.startswith("License")]
    own = fields.get("license_expression") or "; ".join(classes) or fields.get("license")
    return str(own or "not said").splitlines()[0]


def of_rust() -> Iterator[Licensed]:
    """Crates of Cargo.lock.

    Raises
    ------
    FileNotFoundError, subprocess.CalledProcessError
        There is no cargo, or it has not fetched them.
    """
    command = ["cargo", "metadata", "--offline", "--locked", "--format-version", "1"]
    found = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    for crate in json.loads(found.stdout)["packages"]:
        yield Licensed(crate["name"], crate["version"], crate["license"] or "not said")


def main() -> None:
    """Print them; ends with 1 where one is not free."""
    every = [*of_python(), *of_rust()]
    table = Table(box=None)
    for name in ("package", "version", "licence"):
        table.add_column(name)
    doubtful = [one for one in every if not one.free and one.name not in EXAMINED]
    for one in sorted(every, key=lambda each: (each in doubtful, each.name.lower())):
        table.add_row(one.name, one.version, EXAMINED.get(one.name, one.licence))
    Console(width=140).print(table)
    print(f"{len(every)} packages, {len(doubtful)} of them not known to be free")
    raise SystemExit(1 if doubtful else 0)


if __name__ == "__main__":
    main()
