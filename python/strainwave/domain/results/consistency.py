"""Result of the input check: relations, suspected faults, and corrections of study and logs."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

from strainwave.domain.arm.description import Matrix
from strainwave.domain.arm.kinds import change_arm_keys
from strainwave.domain.arm.link_sensors import link_channel_kinds
from strainwave.domain.keys import JointNumber
from strainwave.domain.messages import Clause, Place, places_text, text_of
from strainwave.domain.results.estimates import Diagnostic
from strainwave.domain.study import Channel, Study, channel_parts


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Suspicion:
    """Possible cause of a contradiction between channels, or between a channel and the study."""

    code: str  # one of the input faults of docs/troubleshooting.md: "wrong-unit", "wrong-sign", ...
    places: tuple[Place, ...]
    clause: Clause  # observation, with the measured value
    remedy_clause: Clause  # lines of study.toml, or action at the rig, that correct it
    factor: float | None = None  # ratio of the data to the value that the study implies
    delay_s: float | None = None  # delay of the channel [s]
    corrections: tuple[Correction, ...] = ()  # machine-readable remedy; empty if unknown
    accepted: bool = False  # by `accept`, or estimated by the fit: it does not decide the status

    @property
    def where(self) -> str:
        """Text of the places: "a1", "joint 2 gear_ratio"."""
        return places_text(self.places)

    @property
    def message(self) -> str:
        """The observation in one sentence."""
        return text_of(self.clause)

    @property
    def remedy(self) -> str:
        """What corrects the fault, as a sentence."""
        text = text_of(self.remedy_clause)
        return text[:1].upper() + text[1:]


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
        arm, entry = study.arm, correction.entry
        if correction.table == "arm":
            arm = change_arm_keys(arm, **{correction.key: correction.value})
        elif correction.table == "transmission":
            arm = _with_value(arm, correction)
        elif correction.table == "joint":
            joints = list(arm.joints)
            joints[int(entry) - 1] = _with_value(joints[int(entry) - 1], correction)
            arm = arm.with_joints(joints)
        elif correction.table == "channels":
            channel = _with_value(study.channels.get(entry) or Channel(entry), correction)
            study = replace(study, channels={**study.channels, entry: channel})
        elif correction.table == "experiment":
            experiments = (
                _with_value(each, correction) if each.name == entry else each
                for each in study.experiments
            )
            study = replace(study, experiments=tuple(experiments))
        study = replace(study, arm=arm)
    return study


def _with_value(record: Any, correction: Correction) -> Any:
    """A record with another value of a key, or of a part of it: "origin.xyz", "prbs.clock"."""
    value: Any = correction.value
    key, _, part = correction.key.partition(".")
    if part:
        value = replace(getattr(record, key), **{part: value})
    return replace(record, **{key: value})


def steps_of(study: Study, corrections: Sequence[Correction]) -> tuple[Clause, ...]:
    """Instructions for the corrections, with the corrected lines of study.toml."""
    after = apply_corrections(study, corrections)
    return tuple(dict.fromkeys(_step(after, correction) for correction in corrections))


def _step(after: Study, correction: Correction) -> Clause:
    entry, key, value = correction.entry, correction.key, correction.value
    if correction.table == "channels":
        channel = after.channels.get(entry) or Channel(entry)
        scale = f", scale = {channel.scale:.7g}" if channel.scale != 1.0 else ""
        offset = f", offset = {channel.offset:.7g}" if channel.offset else ""
        meaning = f', meaning = "{channel.meaning}"' if channel.meaning != "motor" else ""
        column, rest = f'"{channel.column}"', f"{scale}{offset}{meaning}"
        source = f"{{ column = {column}{rest} }}" if rest else column
        return Clause("step/channel", line=f"channels.{entry} = {source}")
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


Bound = Literal["equal", "least", "most"]
"""What the expected value of a relation is."""

_LINK_GEOMETRY = ("accelerometer_distance", "link_length")
"""Keys of the study that affect only predictions of link sensors."""


@dataclass(frozen=True, slots=True)
class Relation:
    """A number that the channels and the study determine, and its value for consistent input."""

    kind: str
    place: Place
    measured: float
    std: float  # standard deviation; 0: not estimated
    expected: float | None  # None: any positive value
    is_consistent: bool
    accuracy: float  # largest difference from the expected value of consistent input
    bound: Bound = "equal"

    @property
    def text(self) -> str:
        """The kind of the relation, as the terminal names it."""
        return text_of(Clause(f"relation/{self.kind}"))

    @property
    def where(self) -> str:
        """Text of the place."""
        return places_text((self.place,))

    @property
    def joint(self) -> JointNumber | None:
        """Joint of the place; None for a record."""
        channel = self.place.channel
        return self.place.joint if channel is None else channel_parts(channel)[1]


@dataclass(frozen=True, slots=True)
class Consistency:
    """Result of the input check: relations, and faults suspected before any fit."""

    suspected: tuple[Suspicion, ...] = ()
    relations: tuple[Relation, ...] = ()
    warnings: tuple[Diagnostic, ...] = ()
    unchecked: tuple[str, ...] = ()  # channels that occur in no relation

    @property
    def deciding(self) -> tuple[Suspicion, ...]:
        """Suspected faults that decide the status: those that are not accepted."""
        return tuple(each for each in self.suspected if not each.accepted)

    @property
    def motors_agree(self) -> bool:
        """Whether all deciding faults concern link sensors, their positions or the link length."""
        places = [place for suspicion in self.deciding for place in suspicion.places]
        kinds = link_channel_kinds()
        return all(
            place.key in _LINK_GEOMETRY
            or (place.channel is not None and channel_parts(place.channel)[0] in kinds)
            for place in places
        )

    def suspecting(self, *further: Suspicion, accept: Collection[str]) -> Consistency:
        """With further suspicions; those with a code in `accept` are marked as accepted."""
        all_faults = (*self.suspected, *further)
        marked = (replace(f, accepted=f.accepted or f.code in accept) for f in all_faults)
        return replace(self, suspected=tuple(marked))


CheckStatus = Literal["consistent", "inconsistent-input"]


@dataclass(frozen=True, slots=True, kw_only=True)
class InputCheck(Consistency):
    """Consistency of the input of a study, without any identification."""

    study: Study
    seconds: float  # for reading and checking

    @property
    def status(self) -> CheckStatus:
        """Whether a fault of the input is suspected and not accepted."""
        return "inconsistent-input" if self.deciding else "consistent"

    @property
    def exit_code(self) -> int:
        """0 if the input is consistent, otherwise 3."""
        return 0 if self.status == "consistent" else 3
