"""Changes to a study or to its logs that make the input consistent, and their instructions."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from strainwave.domain.arm import ArmDescription, Matrix
from strainwave.domain.kinds import change_arm_keys
from strainwave.domain.messages import Clause
from strainwave.domain.study import Channel, Experiment, Study


@dataclass(frozen=True, slots=True)
class Correction:
    """One key of study.toml, or one property of the logs, and its corrected value."""

    table: Literal["arm", "joint", "channels", "experiment", "transmission", "log"]
    entry: str  # number of the joint, name of the channel or experiment; "" of other tables
    key: str  # of a log: "delay_s", "clock", "high_pass_hz", "unusable"
    value: float | str | tuple[float, ...] | Matrix | None  # None: the key is removed

    @property
    def number(self) -> float:
        """The value as a number; zero if it is none."""
        return self.value if isinstance(self.value, float | int) else 0.0


def exchange_corrections(pairs: Iterable[tuple[str, str]], study: Study) -> tuple[Correction, ...]:
    """Corrections that exchange the columns of two channels, with their scales and offsets."""
    corrections = []
    for first, second in pairs:
        for name, other in ((first, second), (second, first)):
            source = study.channels.get(other) or Channel(other)
            for key in ("column", "scale", "offset"):
                corrections.append(Correction("channels", name, key, getattr(source, key)))
    return tuple(corrections)


def apply_corrections(study: Study, corrections: Sequence[Correction]) -> Study:
    """Return the study with all corrections of its keys. Corrections of logs do not change it."""
    for correction in corrections:
        if correction.table == "arm":
            arm = change_arm_keys(study.arm, **{correction.key: correction.value})
            study = replace(study, arm=arm)
        elif correction.table == "joint":
            study = replace(study, arm=_with_joint(study.arm, correction))
        elif correction.table == "transmission":
            changes = {correction.key: correction.value}
            study = replace(study, arm=replace(study.arm, **changes))  # type: ignore[arg-type]
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


def _with_joint(arm: ArmDescription, correction: Correction) -> ArmDescription:
    """The arm with another value of a key of one joint, or of a part of it: "origin.xyz"."""
    number, value = int(correction.entry), correction.value
    key, _, part = correction.key.partition(".")
    if not part:
        return arm.with_joint(number, **{key: value})
    whole = getattr(arm.joints[number - 1], key)
    return arm.with_joint(number, **{key: replace(whole, **{part: value})})


def _correct_experiment(experiment: Experiment, correction: Correction) -> Experiment:
    _, _, key = correction.key.partition("prbs.")
    if key and experiment.prbs is not None:
        prbs = replace(experiment.prbs, **{key: correction.value})  # type: ignore[arg-type]
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
        change = correction.number
        side = "earlier" if change > 0.0 else "later"
        step = f"step/{key}"
        return Clause(step, channel=entry, delay=abs(change), side=side, spacing=1.0 + change)
    table = Clause(f"table/{correction.table}", entry=entry)
    if after.arm.urdf is not None and key.partition(".")[0] in ("origin", "axis"):
        table = Clause("table/urdf", entry=entry, file=after.arm.urdf.file)
    if value is None:
        return Clause("step/remove", key=key, table=table)
    if isinstance(value, tuple):
        return Clause("step/set-list", key=key, value=_list_text(value), table=table)
    step = "step/set" if isinstance(value, float) else "step/set-count"
    return Clause(step, key=key, value=value, table=table)


def _list_text(value: tuple[float, ...] | Matrix) -> str:
    """A vector or a matrix as a TOML value."""
    entries = (f"{e:.5g}" if isinstance(e, float | int) else _list_text(e) for e in value)
    return f"[{', '.join(entries)}]"


def channel_line(study: Study, name: str) -> str:
    """Line of a channel in [channels]."""
    channel = study.channels.get(name) or Channel(name)
    scale = f", scale = {channel.scale:.7g}" if channel.scale != 1.0 else ""
    offset = f", offset = {channel.offset:.7g}" if channel.offset else ""
    meaning = f', meaning = "{channel.meaning}"' if channel.meaning != "motor" else ""
    if not scale and not offset and not meaning:
        return f'channels.{name} = "{channel.column}"'
    return f'channels.{name} = {{ column = "{channel.column}"{scale}{offset}{meaning} }}'
