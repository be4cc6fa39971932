"""Install a wheel or an sdist as a user does: `python -m benchmarks.installation FILE...`.

The dependencies of all extras for users, and of the build of an sdist, are downloaded first. Each
file is then installed into a fresh virtual environment without a package index; a wheel without a
compiler on the path. There the commands of the README run on the records of the small arm, and the
workbench answers. Prints sizes and times. Needs nothing but Python, and cargo for an sdist.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import venv
from pathlib import Path
from urllib.request import HTTPCookieProcessor, build_opener

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("bags", "cluster", "hdf5", "plot", "serve")
SMALL_ARM = ROOT / "tests/data/small-arm"
TO_CSV = """
from pathlib import Path
from pyarrow import csv, parquet
for path in Path().glob("*.parquet"):
    csv.write_csv(parquet.read_table(path), path.with_suffix(".csv"))
    path.unlink()
"""
LOADED = """
[[experiment]]
name = "load"
file = "motion-check.csv"
use = "motion"
control = ["servo", "servo"]
"""
"""Record of the study `payload.toml`: a motion without a load, so that no mass is expected."""

IMPORT = """
import time
start = time.perf_counter()
import strainwave
print(f"import strainwave: {(time.perf_counter() - start) * 1e3:.0f} ms")
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE")
    parser.add_argument("--wheelhouse", type=Path, default=ROOT / "build/wheelhouse")
    arguments = parser.parse_args()
    files = [file.resolve() for file in arguments.files]
    download(files, arguments.wheelhouse)
    for file in files:
        with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
            check(file, arguments.wheelhouse, Path(folder).resolve())


def download(files: list[Path], wheelhouse: Path) -> None:
    """Download the dependencies as wheels. An sdist also needs its build system and crates."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extras = project["project"]["optional-dependencies"]
    requirements = [*project["project"]["dependencies"]]
    requirements += [requirement for extra in EXTRAS for requirement in extras[extra]]
    if any(file.suffix == ".gz" for file in files):
        requirements += project["build-system"]["requires"]
        subprocess.run(["cargo", "fetch", "--locked", "--quiet"], cwd=ROOT, check=True)
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"]
    options = ["--only-binary", ":all:", "--dest", str(wheelhouse)]
    subprocess.run([*command, *options, *requirements], check=True)


def check(file: Path, wheelhouse: Path, folder: Path) -> None:
    """Install a file, run the README's commands, and print what each step takes."""
    print(f"{file.name}: {file.stat().st_size / 1e6:.2f} MB", flush=True)
    environment = folder / "venv"
    venv.create(environment, with_pip=True)
    programs = environment / ("Scripts" if os.name == "nt" else "bin")
    inherited = {key: text for key, text in os.environ.items() if not key.startswith("PYTHON")}
    alone = {**inherited, "PATH": str(programs), "PYTHONUTF8": "1"}
    building = {**inherited, "CARGO_NET_OFFLINE": "true"}
    python = str(programs / Path(sys.executable).name)
    rig = folder / "rig"
    shutil.copytree(SMALL_ARM, rig)

    def run(step: str, *command: str, environ: dict[str, str] = alone) -> str:
        start = time.perf_counter()
        done = subprocess.run(
            command, check=False, cwd=rig, env=environ, capture_output=True, encoding="utf-8"
        )
        print(f"{time.perf_counter() - start:8.1f} s  {step}", flush=True)
        if done.returncode:
            sys.exit(f"exit code {done.returncode}\n{done.stdout}{done.stderr}")
        return done.stdout

    pip = [python, "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--no-index"]
    target = f"{file}[{','.join(EXTRAS)}]"
    environ = alone if file.suffix == ".whl" else building
    run("pip install", *pip, "--find-links", str(wheelhouse.resolve()), target, environ=environ)
    run("pip check", python, "-m", "pip", "check")
    run("records of the small arm as CSV", python, "-c", TO_CSV)
    study = (rig / "study.toml").read_text(encoding="utf-8").replace(".parquet", ".csv")
    (rig / "study.toml").unlink()
    arm = study[: study.index("[[experiment]]")]
    (rig / "payload.toml").write_text(arm + LOADED, encoding="utf-8")
    commands, script = readme()
    for command in commands:
        words = [
            name
            for word in command.split()
            for name in (sorted(path.name for path in rig.glob(word)) if "*" in word else [word])
        ]
        run(command, str(programs / words[0]), *words[1:])
        (rig / "study.toml").write_text(study, encoding="utf-8")  # the draft of `init`, completed
    run("Python script", python, "-c", script)
    serve(str(programs / "strainwave"), rig, alone)
    print(run("import in a process of its own", python, "-c", IMPORT), end="", flush=True)


def readme() -> tuple[list[str], str]:
    """Commands and the Python script of the README's section on a rig of one's own."""
    text = (ROOT / "README.md").read_text(encoding="utf-8").partition("## Your own rig")[2]
    commands = re.findall(r"^ {4}(strainwave .*?)(?: {2,}#.*)?$", text, re.MULTILINE)
    script = re.search(r"^ {4}import strainwave as sw\n(?:(?: {4}.*)?\n)+", text, re.MULTILINE)
    if not commands or script is None:
        sys.exit("README.md: no commands or no Python script in the section 'Your own rig'")
    unindented = re.sub(r"^ {4}", "", script[0], flags=re.MULTILINE)
    return commands, unindented.replace("gear_stiffness", "gear_stiffness_k1")  # of three slopes


def serve(program: str, rig: Path, environ: dict[str, str]) -> None:
    """Start the workbench, read the page of the studies, and end it."""
    start = time.perf_counter()
    command = [program, "serve", ".", "--port", "0"]
    server = subprocess.Popen(
        command, cwd=rig, env=environ, stdout=subprocess.PIPE, encoding="utf-8"
    )
    assert server.stdout is not None
    try:
        link = re.search(r"http://\S+", server.stdout.readline())
        if link is None:
            sys.exit("strainwave serve printed no address")
        browser = build_opener(HTTPCookieProcessor())  # keeps the token
        with browser.open(link[0], timeout=60) as page:
            if "study" not in page.read().decode():
                sys.exit("the workbench does not list study.toml")
    finally:
        server.terminate()
        server.wait()
    print(f"{time.perf_counter() - start:8.1f} s  strainwave serve", flush=True)


if __name__ == "__main__":
    main()
