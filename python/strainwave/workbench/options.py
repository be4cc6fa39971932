"""Options of the server: where it listens, and whom it lets in."""

from __future__ import annotations

import ipaddress
import os
from dataclasses import dataclass
from pathlib import Path

from strainwave.errors import InvalidInput


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
