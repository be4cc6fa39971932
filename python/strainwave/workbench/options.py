"""Options of the server: where it listens, and whom it lets in."""

from __future__ import annotations

import ipaddress
import os
import secrets
from dataclasses import dataclass, field
from pathlib import Path

from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import decode, read_small

TOKEN_VARIABLE = "STRAINWAVE_TOKEN"
"""Environment variable of the token; the command line of a process is visible to all users."""
_MAX_TOKEN_BYTES = 4096


@dataclass(frozen=True, slots=True)
class ServerOptions:
    """Where the workbench listens, and what it accepts."""

    folder: Path
    host: str = "127.0.0.1"
    port: int = 8765  # 0: any free port
    token: str = field(default_factory=secrets.token_urlsafe, repr=False)  # clients must know it
    max_upload_mib: int = 2048  # of one file
    allowed: tuple[Path, ...] = ()  # further folders whose files a study may name

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
    folders = [(options.folder, str(options.folder), "your studies")]
    folders += [(each, f"--allow {each}", "the logs") for each in options.allowed]
    for folder, where, content in folders:
        if not folder.is_dir():
            remedy = f"name the folder of {content}"
            raise InvalidInput("is not a folder", where=where, remedy=remedy)


def token_from(file: Path | None) -> str:
    """The token of a file or else of the environment; a new one if neither is given.

    Raises InvalidInput if the file cannot be read or is empty.
    """
    if file is None:
        return os.environ.get(TOKEN_VARIABLE, "").strip() or secrets.token_urlsafe()
    token = decode(read_small(file, "the token", _MAX_TOKEN_BYTES), file).strip()
    if not token:
        raise InvalidInput("the token is empty", where=str(file), remedy="write one line")
    return token
