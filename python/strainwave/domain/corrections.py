"""Changes to a study or to its logs that make the input consistent, and their instructions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

from strainwave.domain.clauses import Clause
from strainwave.domain.kinds import change_arm_keys
from strainwave.domain.study import Channel, Experiment, Study


@dataclass(frozen=True, slots=True)
class Correction:
    """One key of study.toml, or one property of the logs, and its corrected value."""

    table: Literal["arm", "joint", "channels", "experiment", "log"]
    entry: str  # number of the joint, name of the channel or experiment; "" of [arm]
    key: str  # of a log: "delay_s", "clock", "high_pass_hz", "unusable"
    value: float | str | None  # None: the key is removed


def apply_corrections(study: Study, corrections: Sequence[Correction]) -> Study:
    """Return the study with all corrections of its keys. Corrections of logs do not change it."""
    for correction in corrections:
        if correction.table == "arm":
            arm = change_arm_keys(study.arm, **{correction.key: correction.value})
            study = replace(study, arm=arm)
        elif correction.table == "joint":
            changes = {correction.key: correction.value}
            study = replace(study, arm=study.arm.with_joint(int(correction.entry), **changes))
        elif correction.table == "channels":
            before = study.channels.get(correction.entry) or Channel(correction.entry)
            after = replace(before, **{correction.key: correction.value})  # type: ignore[arg-type]
            study = replace(study, channels={**study.channels, correction.entry: after})
        elif correction.table == "experiment":
            experiments = tuple(
                _correct_experiment(experiment, correction)
                if experiment.name == correction.entry
                else experiment
                for experiment in study.experiments
            )
            study = replace(study, experiments=experiments)
    return study


def _correct_experiment(experiment: Experiment, correction: Correction) -> Experiment:
    if correction.key == "prbs.amplitude" and experiment.prbs is not None:
        prbs = replace(experiment.prbs, amplitude=float(correction.value or 0.0))
        return replace(experiment, prbs=prbs)
    return replace(experiment, **{correction.key: correction.value})  # type: ignore[arg-type]


def steps_of(study: Study, corrections: Sequence[Correction]) -> tuple[Clause, ...]:
    """Instructions for the corrections, with the corrected lines of study.toml."""
    after = apply_corrections(study, corrections)
    return tuple(dict.fromkeys(_step(after, correction) for correction in corrections))


def _step(after: Study, correction: Correction) -> Clause:
    entry, key, value = correction.entry, correction.key, correction.value
    if correction.table == "channels":
        return Clause("step/channel", line=channel_line(after, entry))
    if correction.table == "log":
        change = float(value or 0.0)
        side = "earlier" if change > 0.0 else "later"
        step = f"step/{key}"
        return Clause(step, channel=entry, delay=abs(change), side=side, spacing=1.0 + change)
    table = Clause(f"table/{correction.table}", entry=entry)
    if value is None:
        return Clause("step/remove", key=key, table=table)
    step = "step/set" if isinstance(value, float) else "step/set-count"
    return Clause(step, key=key, value=value, table=table)


def channel_line(study: Study, name: str) -> str:
    """Line of a channel in [channels]."""
    channel = study.channels.get(name) or Channel(name)
    scale = f", scale = {channel.scale:.7g}" if channel.scale != 1.0 else ""
    offset = f", offset = {channel.offset:.7g}" if channel.offset else ""
    if not scale and not offset:
        return f'channels.{name} = "{channel.column}"'
    return f'channels.{name} = {{ column = "{channel.column}"{scale}{offset} }}'
