"""Instructions per step of the compiled programs on aarch64 and x86-64, counted in an emulator.

The emulator writes the instructions of each block once, and a line whenever it enters the block.
The difference of two runs excludes their beginnings. In brackets: the share of instructions on
registers that hold several numbers.

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
ROWS = (
    ("two-link arm, simulation", "two-link", "simulation"),
    ("two-link arm, 27 derivatives", "two-link", "derivatives"),
    ("chain of 7 joints, simulation", "7", "simulation"),
)
TRACE = ("-d", "nochain,exec,in_asm")


@dataclass(frozen=True)
class Machine:
    """A target of the compiler, the registers of its programs, and an emulator of it."""

    target: str
    width: str
    several_numbers: tuple[bytes, ...]
    """Text in a disassembled instruction on registers that hold several numbers."""
    emulator: tuple[str, ...]


MACHINES = (
    Machine("aarch64-unknown-linux-gnu", "Neon", (b".2d",), ("qemu-aarch64-static",)),
    Machine("x86_64-unknown-linux-gnu", "Avx2", (b"%ymm",), ("qemu-x86_64-static", "-cpu", "max")),
    Machine("x86_64-unknown-linux-gnu", "Portable", (b"pd ",), ("qemu-x86_64-static",)),
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


def instructions(machine: Machine, path: str, arm: str, kind: str, steps: int) -> Counter[bool]:
    """Instructions of a run; those on registers with several numbers are under True."""
    command = (*machine.emulator, *TRACE, path, arm, machine.width, kind, str(steps))
    blocks: dict[int, Counter[bool]] = {}
    entries: Counter[int] = Counter()
    block = None
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as run:
        assert run.stderr is not None
        for line in run.stderr:
            if line.startswith(b"Trace"):
                entries[int(line.split(b"/")[1], 16)] += 1
            elif line.startswith(b"IN:"):
                block = None
            elif line.startswith(b"0x"):
                address, text = line.split(b":  ", 1)
                if block is None:
                    block = blocks[int(address, 16)] = Counter()
                if b"  " in text:  # otherwise it is the ninth byte of the instruction above
                    block[any(part in text for part in machine.several_numbers)] += 1
    if run.returncode != 0:
        raise subprocess.CalledProcessError(run.returncode, command)
    total: Counter[bool] = Counter()
    for address_of_block, count in entries.items():
        for is_several, size in blocks[address_of_block].items():
            total[is_several] += count * size
    return total


def per_step(machine: Machine, path: str, arm: str, kind: str) -> str:
    """Instructions of a step, and the share of those on registers with several numbers."""
    few, many = (instructions(machine, path, arm, kind, steps) for steps in STEPS)
    many.subtract(few)
    total = many.total()
    return f"{total / (STEPS[1] - STEPS[0]):.0f} ({100 * many[True] / total:.0f} %)"


def main() -> None:
    heads = (f"{one.target.split('-')[0]}, {one.width}" for one in MACHINES)
    table = Table("instructions per step", *heads)
    paths = {target: executable(target) for target in {one.target for one in MACHINES}}
    for name, arm, kind in ROWS:
        counts = (per_step(one, paths[one.target], arm, kind) for one in MACHINES)
        table.add_row(name, *counts)
    Console().print(table)


if __name__ == "__main__":
    main()
