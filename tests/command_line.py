"""The command line in the process of the test, without the second that a new process takes.

And in a process of its own, for what such a process alone shows.
"""

from __future__ import annotations

import io
import os
import subprocess
import sys
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from strainwave import cli

COLUMNS = "100"


@dataclass(frozen=True, slots=True)
class Finished:
    """Output and exit code of a command."""

    returncode: int
    stdout: str
    stderr: str


def run_here(*arguments: str | Path, cwd: Path | None = None) -> Finished:
    """Run `strainwave` with arguments; a warning is an error, as everywhere in the tests."""
    line = ["strainwave", *map(str, arguments)]
    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        chdir(cwd or Path.cwd()),
        patch.dict(os.environ, COLUMNS=COLUMNS),
        patch("sys.argv", line),
        patch(
            "strainwave.numerics.parallel.configure_process"
        ),  # this process runs other tests too
        redirect_stdout(out),
        redirect_stderr(err),
    ):
        try:
            cli.main()
        except SystemExit as done:
            code = done.code if isinstance(done.code, int) else int(done.code is not None)
    return Finished(code, out.getvalue(), err.getvalue())


def run_apart(*arguments: str) -> subprocess.CompletedProcess[str]:
    """Run `strainwave` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "strainwave", *arguments],
        capture_output=True,
        text=True,
        check=False,
        env={**os.environ, "COLUMNS": COLUMNS, "PYTHONWARNINGS": "error"},
    )
