"""Changes to a study or to its logs that make the input consistent, as data and as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

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


def correction_text(study: Study, corrections: Sequence[Correction]) -> str:
    """Instruction for the corrections, with the corrected lines of study.toml."""
    after = apply_corrections(study, corrections)
    places = groupby(corrections, key=lambda correction: (correction.table, correction.entry))
    steps = [
        _describe_changes(after, table, entry, tuple(group)) for (table, entry), group in places
    ]
    return "; ".join(steps)


def _describe_changes(
    after: Study, table: str, entry: str, corrections: Sequence[Correction]
) -> str:
    if table == "channels":
        return f"set {channel_line(after, entry)}"
    place = {"arm": "[arm]", "joint": f"[[joint]] {entry}"}.get(table, f"[[experiment]] {entry}")
    steps = []
    for correction in corrections:
        if table == "log":
            steps.append(_describe_log_change(entry, correction))
        elif correction.value is None:
            steps.append(f"remove {correction.key} from {place}")
        else:
            spec = ".7g" if isinstance(correction.value, float) else ""
            steps.append(f"set {correction.key} = {correction.value:{spec}} in {place}")
    return ", ".join(steps)


def _describe_log_change(channel: str, correction: Correction) -> str:
    value = float(correction.value or 0.0)
    if correction.key == "delay_s":
        side = "earlier" if value > 0.0 else "later"
        return f"shift {channel} by {1e3 * abs(value):.3g} ms to {side} times in every log"
    if correction.key == "clock":
        return f"resample {channel} at {1.0 + value:.7g} times its spacing in every log"
    if correction.key == "high_pass_hz":
        return f"couple the amplifier of {channel} to DC, or remove its column from the logs"
    return f"remove or rename the column of {channel} in the logs to exclude it"


def channel_line(study: Study, name: str) -> str:
    """Line of a channel in [channels]."""
    channel = study.channels.get(name) or Channel(name)
    scale = f", scale = {channel.scale:.7g}" if channel.scale != 1.0 else ""
    offset = f", offset = {channel.offset:.7g}" if channel.offset else ""
    if not scale and not offset:
        return f'channels.{name} = "{channel.column}"'
    return f'channels.{name} = {{ column = "{channel.column}"{scale}{offset} }}'
