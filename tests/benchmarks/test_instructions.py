"""Instructions of a step, counted by an emulator that prints blocks and entries."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from benchmarks.instructions import MACHINES, Machine, instructions, per_step

# A block of 3 instructions before the loop, and one of 4, 2 of them on several numbers, per step.
# The ninth byte of an instruction is on a line of its own, and a block is printed once.
EMULATOR = """
import sys
arm, width, kind, steps = sys.argv[-4:]
first = ["IN: main", "0x10:  90 90  nop", "0x20:  90 90  nop", "0x30:  c3  retq"]
loop = ["IN: ", "0x40:  c4 e2  vfmadd231pd  %ymm0, %ymm1, %ymm2",
        "0x50:  48 b8 00 00 00 00 00 00  movabsq  $1, %rax", "0x58:  01",
        "0x59:  c5 fd  vmovupd  %ymm0, (%rax)", "0x60:  75 f0  jne  0x40"]
lines = [*first, "Trace 0: 0x7f00 [0/0000000000000010/c0b3/ff000200] main", *loop]
lines += ["Trace 0: 0x7f80 [0/0000000000000040/c0b3/ff000200] main"] * int(steps)
print("result")
print("\\n".join(lines), file=sys.stderr)
sys.exit(width == "wrong")
"""

PROGRAM = """
#include <stdlib.h>
int main(int count, char **words)
{
    long steps = atol(words[count - 1]);
    __asm__ volatile("1: fmla v0.2d, v1.2d, v2.2d\\n fmla v3.2d, v1.2d, v2.2d\\n"
                     "subs %0, %0, #1\\n b.ne 1b" : "+r"(steps) : : "v0", "v3", "cc");
    return 0;
}
"""


def machine(emulator: str, width: str = "Avx2") -> Machine:
    return Machine("none", width, (b"%ymm",), (sys.executable, "-c", emulator))


def test_a_block_counts_at_every_entry() -> None:
    counts = instructions(machine(EMULATOR), "program", "two-link", "simulation", 5)
    assert counts == {True: 5 * 2, False: 3 + 5 * 2}


def test_a_step_excludes_what_runs_once() -> None:
    assert per_step(machine(EMULATOR), "program", "two-link", "simulation") == "4 (50 %)"


def test_a_failure_of_the_emulator_is_an_error() -> None:
    with pytest.raises(subprocess.CalledProcessError):
        instructions(machine(EMULATOR, "wrong"), "program", "two-link", "simulation", 5)


def test_a_loop_for_aarch64_has_the_instructions_of_its_source(tmp_path: Path) -> None:
    compiler, (neon, *_) = shutil.which("aarch64-linux-gnu-gcc"), MACHINES
    if compiler is None or shutil.which(neon.emulator[0]) is None:
        pytest.skip("no compiler for aarch64 or no emulator here")
    source, program = tmp_path / "loop.c", str(tmp_path / "loop")
    source.write_text(PROGRAM)
    subprocess.run([compiler, "-static", "-o", program, str(source)], check=True)
    few, many = (instructions(neon, program, "", "", steps) for steps in (100, 900))
    many.subtract(few)
    assert many == {True: 2 * 800, False: 2 * 800}
