"""Instructions per step of the compiled programs on aarch64 and x86-64, counted in an emulator.

The emulator writes the instructions of each block once, and a line whenever it enters the block.
The difference of two runs excludes their beginnings.

make instructions
"""

from __future__ import annotations

import json
import subprocess
from collections import Counter
from dataclasses import dataclass

from rich.table import Table

from benchmarks.console import Console

STEPS = (80, 160)
ARMS = {"two-link": "two-link arm", "7": "chain of 7 joints"}
TRACE = ("-d", "nochain,exec,in_asm")


@dataclass(frozen=True)
class Machine:
    """A target of the compiler, the registers of its programs, and an emulator of it."""

    target: str
    width: str
    emulator: tuple[str, ...]


MACHINES = (
    Machine("aarch64-unknown-linux-gnu", "Neon", ("qemu-aarch64-static",)),
    Machine("x86_64-unknown-linux-gnu", "Avx2", ("qemu-x86_64-static", "-cpu", "max")),
)


def executable(target: str) -> str:
    """Path of the benchmark of a step, compiled for a target."""
    command = ("cargo", "bench", "--locked", "-p", "strainwave-arms", "--bench", "step", "--no-run")
    messages = subprocess.run(
        [*command, "--target", target, "--message-format", "json"],
        check=True,
        stdout=subprocess.PIPE,
    )
    artifacts = (json.loads(line) for line in messages.stdout.splitlines())
    paths = (artifact.get("executable") for artifact in artifacts)
    return str(next(path for path in paths if path))


def instructions(machine: Machine, path: str, arm: str, kind: str, steps: int) -> int:
    """Instructions of a run."""
    command = (*machine.emulator, *TRACE, path, arm, machine.width, kind, str(steps))
    sizes: Counter[int] = Counter()
    block = total = 0
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if line.startswith(b"Trace"):
                total += sizes[int(line.split(b"/")[1], 16)]
            elif line.startswith(b"IN:"):
                block = 0
            elif line.startswith(b"0x"):
                if not block:
                    block = int(line[: line.index(b":")], 16)
                    sizes[block] = 0
                sizes[block] += 1
    if run.returncode != 0:
        raise subprocess.CalledProcessError(run.returncode, command)
    return total


def main() -> None:
    table = Table("step", *(f"{one.target.split('-')[0]}, {one.width}" for one in MACHINES))
    paths = [executable(machine.target) for machine in MACHINES]
    for arm, name in ARMS.items():
        for kind in ("simulation", "derivatives"):
            few, many = (
                [instructions(*at, arm, kind, steps) for at in zip(MACHINES, paths, strict=True)]
                for steps in STEPS
            )
            added = STEPS[1] - STEPS[0]
            per_step = [(b - a) / added for a, b in zip(few, many, strict=True)]
            table.add_row(f"{name}, {kind}", *(f"{count:.0f}" for count in per_step))
    Console().print(table)


if __name__ == "__main__":
    main()
