"""Claims of the source, Figs. 2 and 4 to 15, tested on the built-in arm with known true values."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

from reproduction import amplitude, decoupled, inputs, refinement
from reproduction.document import document_of, failed_comparison, to_json, to_markdown
from reproduction.joint_estimates import evidence_of
from reproduction.records import Comparison, Protocol, Tally
from reproduction.rig import OWN_SETTINGS, PUBLISHED_SETTINGS, Rig, Settings, WholeArmEstimate
from strainwave.domain import ArmModel
from strainwave.errors import StrainwaveError
from strainwave.numerics.parallel import one_blas_thread, run_parallel
from strainwave.virtual.scara import SOFT, BuiltInArm

__all__ = [
    "OWN_SETTINGS",
    "PUBLISHED_SETTINGS",
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
    """Extent of the simulations."""

    figures: tuple[int, ...] = (2, 4, 5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15)
    amplitudes: tuple[float, ...] = (4.0, 6.0, 8.0, 10.0)  # [V]; below, friction holds the motors
    payloads: tuple[int, ...] = (5, 3, 1, 0)  # [kg]
    records: int | None = None  # of one period at each amplitude; None: from the settings


def compare(
    whole_arm: ArmModel | None = None,
    *,
    seed: int = 0,
    settings: Settings = OWN_SETTINGS,
    built_in: BuiltInArm = SOFT,
    options: ComparisonOptions | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Comparison, ...]:
    """All comparisons in the order of the source's figures.

    `whole_arm` is the fit of the arm with its full payload, computed here if None. `seed` is that
    of sensor noise, motions and the start of the PRBS. `progress` receives the current activity.
    """
    comparison_options = options or ComparisonOptions()
    rig = Rig(seed, settings, progress, built_in)
    # verdicts must not depend on the number of threads that share a sum
    with one_blas_thread():
        comparisons = [
            _attempt(figure, job, progress)
            for figure, job in _jobs(rig, whole_arm, comparison_options).items()
            if figure in comparison_options.figures
        ]
    rig.clear_caches()
    return tuple(replace(each, protocol=settings.protocol) for each in comparisons)


def compare_seeds(
    seeds: Sequence[int],
    *,
    whole_arm: ArmModel | None = None,
    settings: Sequence[Settings] = (OWN_SETTINGS,),
    built_in: BuiltInArm = SOFT,
    options: ComparisonOptions | None = None,
    progress: Callable[[str], None] = lambda _: None,
) -> tuple[Tally, ...]:
    """All comparisons over several seeds, with one or several settings.

    `whole_arm` is the fit of the first seed with the default settings, computed here if None.
    The result is sorted by figure, then by settings; only the first seed has plots.
    """

    def job(seed: int, run_settings: Settings) -> tuple[Comparison, ...]:
        fit = whole_arm if seed == seeds[0] and run_settings.protocol == "own" else None
        run = compare(
            fit,
            seed=seed,
            settings=run_settings,
            built_in=built_in,
            options=options,
            progress=progress,
        )
        progress(f"seed {seed} is done")
        return (
            run if seed == seeds[0] else tuple(replace(comparison, plots=()) for comparison in run)
        )

    with one_blas_thread():  # for the duration of all runs
        runs = run_parallel(
            [partial(job, seed, run_settings) for seed in seeds for run_settings in settings]
        )
    by_key: dict[tuple[int, Protocol], list[Comparison]] = {}
    for run in runs:
        for comparison in run:
            by_key.setdefault((comparison.figure, comparison.protocol), []).append(comparison)
    order = [run_settings.protocol for run_settings in settings]
    keys = sorted(by_key, key=lambda key: (key[0], order.index(key[1])))
    return tuple(Tally(tuple(by_key[key])) for key in keys)


def _jobs(
    rig: Rig, whole_arm: ArmModel | None, options: ComparisonOptions
) -> dict[int, Callable[[], Comparison]]:
    """Function that computes each figure. The jobs share simulations and estimates."""
    levels: amplitude.LevelsByJoint = {}
    records = options.records or rig.settings.records

    def tuned_arm() -> WholeArmEstimate:
        if whole_arm is None:
            return rig.whole_arm()
        return WholeArmEstimate(dict(whole_arm.values), (evidence_of(whole_arm, "whole arm"),))

    def over_amplitudes(step: Callable[[amplitude.LevelsByJoint], Comparison]) -> Comparison:
        if not levels:
            for joint in (1, 2):
                levels[joint] = amplitude.estimate_levels(rig, joint, options.amplitudes, records)
        return step(levels)

    return {
        2: partial(over_amplitudes, amplitude.stiffest),
        4: partial(inputs.prbs, rig),
        5: partial(inputs.free, rig),
        6: lambda: refinement.responses(rig, 1, tuned_arm()),
        7: lambda: refinement.tuning(rig, refinement.modified_values(rig), tuned_arm()),
        8: lambda: refinement.validation(rig, tuned_arm()),
        9: lambda: refinement.responses(rig, 2, tuned_arm()),
        10: partial(decoupled.inputs, rig),
        11: partial(decoupled.outputs, rig, options.payloads),
        12: partial(inputs.servoed, rig),
        13: partial(decoupled.methods, rig),
        14: partial(over_amplitudes, amplitude.responses),
        15: partial(over_amplitudes, amplitude.squares),
    }


def _attempt(
    figure: int, job: Callable[[], Comparison], progress: Callable[[str], None]
) -> Comparison:
    progress(f"figure {figure}")
    try:
        return job()
    except StrainwaveError as error:
        return failed_comparison(figure, error)
