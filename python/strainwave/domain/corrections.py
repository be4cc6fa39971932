"""Changes to a study or to its logs that make the input consistent, as data and as text."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Literal

from strainwave.domain.study import Channel, Experiment, Study


@dataclass(frozen=True, slots=True)
class Correction:
    """One key of study.toml, or one property of the logs, and its corrected value."""

    table: Literal["arm", "joint", "channels", "experiment", "log"]
    entry: str  # number of the joint, name of the channel or experiment; "" of [arm]
    key: str  # of a log: "delay_s", "clock", "high_pass_hz", "unusable"
    value: float | str | None  # None: the key is removed


def corrected_study(study: Study, corrections: Sequence[Correction]) -> Study:
    """The study after all corrections of its keys; those of logs do not change it."""
    for each in corrections:
        if each.table == "arm":
            study = replace(study, arm=replace(study.arm, **{each.key: each.value}))  # type: ignore[arg-type]
        elif each.table == "joint":
            joints = list(study.arm.joints)
            number = int(each.entry) - 1
            joints[number] = replace(joints[number], **{each.key: each.value})  # type: ignore[arg-type]
            study = replace(study, arm=study.arm.with_joints(joints))
        elif each.table == "channels":
            before = study.channels.get(each.entry) or Channel(each.entry)
            after = replace(before, **{each.key: each.value})  # type: ignore[arg-type]
            study = replace(study, channels={**study.channels, each.entry: after})
        elif each.table == "experiment":
            experiments = tuple(
                _corrected_experiment(own, each) if own.name == each.entry else own
                for own in study.experiments
            )
            study = replace(study, experiments=experiments)
    return study


def _corrected_experiment(experiment: Experiment, correction: Correction) -> Experiment:
    if correction.key == "prbs.amplitude" and experiment.prbs is not None:
        prbs = replace(experiment.prbs, amplitude=float(correction.value or 0.0))
        return replace(experiment, prbs=prbs)
    return replace(experiment, **{correction.key: correction.value})  # type: ignore[arg-type]


def correction_text(study: Study, corrections: Sequence[Correction]) -> str:
    """The instruction that carries out corrections, with the lines of study.toml as they become."""
    after = corrected_study(study, corrections)
    places = groupby(corrections, key=lambda each: (each.table, each.entry))
    steps = [_step(after, table, entry, tuple(own)) for (table, entry), own in places]
    return "; ".join(steps)


def _step(after: Study, table: str, entry: str, corrections: Sequence[Correction]) -> str:
    if table == "channels":
        return f"set {channel_line(after, entry)}"
    place = {"arm": "[arm]", "joint": f"[[joint]] {entry}"}.get(table, f"[[experiment]] {entry}")
    steps = []
    for each in corrections:
        if table == "log":
            steps.append(_log_step(entry, each))
        elif each.value is None:
            steps.append(f"remove {each.key} from {place}")
        else:
            value = f"{each.value:.7g}" if isinstance(each.value, float) else each.value
            steps.append(f"set {each.key} = {value} in {place}")
    return ", ".join(steps)


def _log_step(channel: str, correction: Correction) -> str:
    value = float(correction.value or 0.0)
    if correction.key == "delay_s":
        side = "earlier" if value > 0.0 else "later"
        return f"shift {channel} by {1e3 * abs(value):.3g} ms to {side} times in every log"
    if correction.key == "clock":
        return f"resample {channel} at {1.0 + value:.7g} times its spacing in every log"
    if correction.key == "high_pass_hz":
        return f"couple the amplifier of {channel} to DC, or remove its column from the logs"
    return f"remove or rename the column of {channel} in the logs, so that it is not used"


def channel_line(study: Study, name: str) -> str:
    """A channel's line in [channels]."""
    own = study.channels.get(name) or Channel(name)
    scale = f", scale = {own.scale:.7g}" if own.scale != 1.0 else ""
    offset = f", offset = {own.offset:.7g}" if own.offset else ""
    if not scale and not offset:
        return f'channels.{name} = "{own.column}"'
    return f'channels.{name} = {{ column = "{own.column}"{scale}{offset} }}'
