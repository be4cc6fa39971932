"""C programs that tests compile and run."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

_STRICT = ("-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror")


def output_of_c(source: str, folder: Path, text: str = "") -> str:
    """Output of a strictly compiled C program with headers in a folder, for an input text."""
    compiler = shutil.which("gcc") or shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler here")
    main, program = folder / "main.c", str(folder / "program")
    main.write_text(source)
    done = subprocess.run(
        [compiler, *_STRICT, "-O2", "-o", program, str(main), "-lm"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return subprocess.run([program], input=text, capture_output=True, text=True, check=True).stdout
