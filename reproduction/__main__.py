"""Identify the built-in arm, then test the claims of the paper's figures on it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console

from reproduction.run import print_comparisons, write_comparisons
from strainwave.numerics.parallel import configure_process
from strainwave.report.terminal import print_summary
from strainwave.virtual.experiments import demonstrate
from strainwave.virtual.scara import ARMS


def reproduce(
    out: Annotated[Path, typer.Option(help="Folder of the results.")],
    seed: Annotated[int, typer.Option(help="First seed of sensor noise and motions.")] = 0,
    seeds: Annotated[int, typer.Option(min=1, help="Number of seeds.")] = 1,
    as_published: Annotated[
        bool, typer.Option("--as-published", help="Also with the settings of the paper.")
    ] = False,
    arm: Annotated[
        Literal["soft", "stiff"], typer.Option(help="Soft gears, or stiff ones, loaded less.")
    ] = "soft",
    figures: Annotated[bool, typer.Option("--figures", help="Also save images.")] = False,
    quick: Annotated[
        bool, typer.Option("--quick", help="The identification only, as `strainwave demo`.")
    ] = False,
) -> None:
    """Identify the built-in arm, then compare with Figs. 2 and 4 to 15 of the paper."""
    with Console(stderr=True).status("starting") as status:

        def progress(text: object) -> None:
            status.update(f"{text} ...")

        identification, truth = demonstrate(
            out, seed=seed, progress=progress, figures=figures, built_in=ARMS[arm]
        )
    print_summary(identification, out, truth=truth, figures=figures)
    if not quick:
        with Console(stderr=True).status("starting") as status:
            tallies = write_comparisons(
                identification,
                out,
                seed=seed,
                seeds=seeds,
                as_published=as_published,
                arm=arm,
                figures=figures,
                progress=progress,
            )
        print_comparisons(tallies, out)
    raise typer.Exit(identification.verdict.exit_code)


if __name__ == "__main__":
    configure_process()
    typer.run(reproduce)
