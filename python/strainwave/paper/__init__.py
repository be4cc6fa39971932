"""The claims of the source, Figs. 2 and 4 to 15, put to the built-in arm whose truth is known."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from strainwave.domain import ArmModel, Comparison, Protocol, Tally
from strainwave.errors import StrainwaveError
from strainwave.numerics.parallel import one_blas_thread, side_by_side
from strainwave.paper import amplitude, decoupled, feedback, inputs, refinement, steps
from strainwave.paper.claims import failed
from strainwave.paper.document import document_of, to_json
from strainwave.paper.estimates import evidence_of
from strainwave.paper.page import to_markdown
from strainwave.paper.rig import Rig, Tuned
from strainwave.paper.settings import OWN, PUBLISHED, Settings

__all__ = [
    "OWN",
    "PUBLISHED",
    "ComparisonOptions",
    "Settings",
    "compare",
    "compare_seeds",
    "document_of",
    "to_json",
    "to_markdown",
]


@dataclass(frozen=True, slots=True)
class ComparisonOptions:
    """How much is simulated."""

    figures: tuple[int, ...] = (2, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
    amplitudes: tuple[float, ...] = (2.0, 4.0, 6.0, 8.0, 10.0)  # [V]
    payloads: tuple[int, ...] = (5, 3, 1, 0)  # [kg]
    records: int | None = None  # of one period, at each amplitude; None: as the settings say


def compare(
    tuned: ArmModel | None = None,
    *,
    seed: int = 0,
    settings: Settings = OWN,
    options: ComparisonOptions | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Comparison, ...]:
    """Every comparison, in the order of the source's figures.

    `tuned`: The whole-arm fit of the arm with its full payload. None: it is made here. `seed`: Of
    the sensors' noise, of the motions, and of where the PRBS begins. `progress`: Called with what
    is being done.
    """
    chosen = options or ComparisonOptions()
    rig = Rig(seed, settings, progress)
    # verdicts must not hang on how many threads share a sum
    with one_blas_thread():
        found = [
            _attempted(figure, job, progress)
            for figure, job in _jobs(rig, tuned, chosen).items()
            if figure in chosen.figures
        ]
    rig.forget()
    return tuple(replace(each, protocol=settings.protocol) for each in found)


def compare_seeds(
    seeds: Sequence[int],
    *,
    tuned: ArmModel | None = None,
    settings: Sequence[Settings] = (OWN,),
    options: ComparisonOptions | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Tally, ...]:
    """Every comparison over several seeds, by one or several settings.

    `tuned`: The whole-arm fit of the first seed by our own settings. None: it is made here.
    `progress`: Called with what is being done. Returns: By figure, then by settings; plots are
    those of the first seed alone.
    """
    asked = [(seed, how) for seed in seeds for how in settings]

    def job(seed: int, how: Settings) -> tuple[Comparison, ...]:
        given = tuned if seed == seeds[0] and how.protocol == "own" else None
        found = compare(given, seed=seed, settings=how, options=options, progress=progress)
        progress(f"seed {seed} is done")
        return found if seed == seeds[0] else tuple(replace(each, plots=()) for each in found)

    with one_blas_thread():  # for as long as any of them runs
        runs = side_by_side([partial(job, seed, how) for seed, how in asked])
    gathered: dict[tuple[int, Protocol], list[Comparison]] = {}
    for found in runs:
        for each in found:
            gathered.setdefault((each.figure, each.protocol), []).append(each)
    order = [how.protocol for how in settings]
    keys = sorted(gathered, key=lambda key: (key[0], order.index(key[1])))
    return tuple(Tally(tuple(gathered[key])) for key in keys)


def _jobs(
    rig: Rig, tuned: ArmModel | None, options: ComparisonOptions
) -> dict[int, Callable[[], Comparison]]:
    """What makes each figure; nothing is simulated or estimated twice."""
    swept: amplitude.Swept = {}
    records = options.records or rig.settings.records

    def after() -> Tuned:
        if tuned is None:
            return rig.tuned()
        return Tuned(dict(tuned.values), (evidence_of(tuned, "whole arm"),))

    def over_amplitudes(step: Callable[[amplitude.Swept], Comparison]) -> Comparison:
        if not swept:
            for joint in (1, 2):
                swept[joint] = amplitude.levels(rig, joint, options.amplitudes, records)
        return step(swept)

    return {
        2: partial(over_amplitudes, amplitude.stiffest),
        4: partial(inputs.prbs, rig),
        5: partial(inputs.free, rig),
        6: lambda: refinement.responses(rig, 1, after()),
        7: lambda: steps.tuning(rig, refinement.modified_values(rig), after()),
        8: lambda: steps.validation(rig, after()),
        9: lambda: refinement.responses(rig, 2, after()),
        10: partial(decoupled.inputs, rig),
        11: partial(decoupled.outputs, rig, options.payloads),
        12: partial(inputs.servoed, rig),
        13: partial(feedback.methods, rig),
        14: partial(over_amplitudes, amplitude.responses),
        15: partial(over_amplitudes, amplitude.squares),
    }


def _attempted(
    figure: int, job: Callable[[], Comparison], progress: Callable[[str], None]
) -> Comparison:
    progress(f"figure {figure}")
    try:
        return job()
    except StrainwaveError as problem:
        return failed(figure, problem)
