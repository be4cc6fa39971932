"""Licences of all locked packages, without a network: `python -m benchmarks.licences`.

Installed packages and fetched crates state their licences in their metadata. Packages whose licence
is not free are listed last and are an error.

Vulnerabilities are not checked here: the databases (OSV, RustSec, PyPA) change daily, and a copy in
this repository would be out of date. With a network: `pip-audit -r requirements.lock`,
`cargo audit`.
"""

from __future__ import annotations

import json
import re
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

from rich.table import Table

from benchmarks.console import Console

ROOT = Path(__file__).parents[1]
FREE = {
    "0BSD",
    "APACHE",
    "BSD",
    "BSL",  # Boost
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
"""Beginnings of the names of free licences."""

EXAMINED = {
    "apsw": "any licence that the Open Source Initiative has approved",
    "axe-playwright-python": "MIT (its file LICENSE); the axe-core in it is under MPL-2.0",
    "cmeel-qhull": "Qhull: free to use, change and distribute with its notice",
    "docutils": "public domain and BSD; one of its files, an editor's mode, is under the GPL",
    "usd-core": "Apache 2.0 with another clause on trademarks (Tomorrow Open Source Technology)",
}
"""Package with ambiguous metadata -> its licence."""


@dataclass(frozen=True, slots=True)
class Licensed:
    """A locked package and the licence in its metadata."""

    name: str
    version: str
    licence: str

    @property
    def free(self) -> bool:
        """Whether one of its alternative licences is free in all parts."""
        return any(
            all(_is_free(part) for part in re.split(r" AND | and |; ", alternative))
            for alternative in re.split(r" OR | or |/", self.licence.replace("License ::", ""))
        )


def _is_free(licence: str) -> bool:
    name = licence.replace("OSI Approved ::", "").strip(" ():").upper()
    return any(name.startswith(beginning) for beginning in FREE)


def of_python() -> Iterator[Licensed]:
    """Installed packages of requirements.lock."""
    for line in (ROOT / "requirements.lock").read_text().splitlines():
        name, separator, rest = line.partition("==")
        if not separator:
            continue
        try:
            fields = metadata.metadata(name)
        except metadata.PackageNotFoundError:
            continue  # for another system
        yield Licensed(name, rest.split()[0], _licence_of(fields))


def _licence_of(fields: metadata.PackageMetadata) -> str:
    classes = [c for c in fields.get_all("Classifier") or [] if c.startswith("License")]
    texts = fields.json
    licence = texts.get("license_expression") or "; ".join(classes) or texts.get("license")
    return str(licence or "unknown").splitlines()[0]


def of_rust() -> Iterator[Licensed]:
    """Crates of Cargo.lock; fails without cargo or before it has fetched them."""
    command = ["cargo", "metadata", "--offline", "--locked", "--format-version", "1"]
    process = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
    for crate in json.loads(process.stdout)["packages"]:
        yield Licensed(crate["name"], crate["version"], crate["license"] or "unknown")


def main() -> None:
    """Print all packages; exit with 1 if a licence is not free."""
    packages = [*of_python(), *of_rust()]
    table = Table(box=None)
    for name in ("package", "version", "licence"):
        table.add_column(name)
    not_free = [p for p in packages if not p.free and p.name not in EXAMINED]
    for package in sorted(packages, key=lambda p: (p in not_free, p.name.lower())):
        licence = EXAMINED.get(package.name, package.licence)
        table.add_row(package.name, package.version, licence)
    Console(width=140).print(table)
    print(f"{len(packages)} packages, {len(not_free)} of them not known to be free")
    raise SystemExit(1 if not_free else 0)


if __name__ == "__main__":
    main()
