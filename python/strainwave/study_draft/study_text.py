"""Write a study file from guesses, each with its reason; unknown values are TODO."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from strainwave.study_draft.candidates import Guess, JointFacts, Mapping
from strainwave.study_draft.experiment_type import ExperimentProposal
from strainwave.study_draft.inspection import Record

TODO = "TODO"
_WIDTH = 100  # [characters] maximum length of a line
_HEAD = (
    "Written by `strainwave init` from {files}. {todo} All other values are guesses; each "
    "comment states the reason, and whether the guess is sure, likely or unsure. docs/study.md "
    "describes every key. When the file is complete, run"
)
_SERVO_NEEDED = (
    "Required: {names} moved under the servo, and only a simulation with the same servo can be "
    "compared with {them}. If the gains are unknown, remove the table; the elastic model is then "
    "fitted, but not validated."
)
_SERVO_OPTIONAL = "only for `strainwave simulate` and `strainwave excite`"
_SERVO = (  # key, value, comment
    ("kind", '"pi-velocity"', "u = kp e + ki integral(e), e = reference - motor velocity"),
    ("period", "{period:.6g}", "[s] sampling period of the servo"),
    ("kp", "{gains}", "[V s/rad] at the motor, one per joint: from the drive's settings"),
    ("ki", "{gains}", "[V/rad]"),
    ("limit", "TODO", "[V] largest output of the drive"),
)
_EXPERIMENTS = (
    "In every [[experiment]], control is unsure: open is assumed for a joint without input, or "
    "with an input of few levels; servo is assumed otherwise. Validation records are never fitted."
)
_VALUE_SOURCES = {  # key -> unit, meaning and source of the value
    "link_length": "[m] from axis 1 to axis 2: from the drawing, or measured",
    "gear_ratio": "link turns per motor turn, 0.01 for 100:1: from the data sheet; "
    "1 if torque and angle are both logged at the link",
    "torque_per_volt": "[N m/V] at the motor: amplifier gain [A/V] times the motor's torque "
    "constant [N m/A], from their data sheets",
    "accelerometer_distance": "[m] from the axis of this joint to the sensor: measured; "
    "remove the line to estimate it",
}


_BANDWIDTH = (
    "bandwidth [Hz] of the sensor with its filter, from the data sheet or the settings. Without "
    "it, the lag biases delay or damping; remove the line only if the bandwidth exceeds the "
    "sampling rate"
)
_IMU = "and xyz [m], rpy [rad], if known"
_CURRENT_LOOP = (
    "bandwidth [Hz] from voltage to torque, from the drive's data sheet; remove the line only "
    "if the bandwidth exceeds the sampling rate"
)


def study_text(
    records: Sequence[Record],
    mapping: Mapping,
    experiments: Sequence[ExperimentProposal],
    out: Path,
) -> str:
    """Return the text of a draft study file.

    `out` is the path of the study file; log paths are relative to its folder.
    """
    elastic = is_elastic(mapping, experiments)
    parts = [_arm(mapping)]
    for number, facts in enumerate(mapping.joints, start=1):
        parts.append(_joint(number, facts, elastic))
    parts.append(_servo(records[0], mapping, experiments, elastic))
    parts.append(_channels(records, mapping))
    parts.append("\n".join(_wrapped(_EXPERIMENTS)))
    parts += [_experiment(each, out) for each in experiments]
    body = "\n\n".join(parts) + "\n"
    count = count_todos(body)
    todo = f"Complete it: {count} value(s) are {TODO}." if count else f"Nothing is {TODO}."
    files = ", ".join(record.path.name for record in records[:4])
    more = f" and {len(records) - 4} more" if len(records) > 4 else ""
    head = _wrapped(_HEAD.format(files=files + more, todo=todo))
    head.append(f"#     strainwave identify {out.name} --out results")
    return "\n".join(head) + "\n\n" + body


def count_todos(text: str) -> int:
    """Count the TODO values of a study file, without comments."""
    lines = [line.split("#")[0] for line in text.splitlines()]
    return sum(line.count(TODO) for line in lines)


def is_elastic(mapping: Mapping, experiments: Sequence[ExperimentProposal]) -> bool:
    """Whether the logs identify gear stiffness: a link sensor or a pseudo-random input exists."""
    sensed = any(facts.link_sensors for facts in mapping.joints)
    return sensed or any(each.prbs for each in experiments)


def _line(key: str, value: str, comment: str) -> str:
    """Return one line with its comment, or the comment above if the line is too long."""
    code = f"{key} = {value}"
    if len(code) + len(comment) + 4 <= _WIDTH:
        return f"{code:<26}  # {comment}"
    return "\n".join([*_wrapped(comment), code])


def _wrapped(text: str) -> list[str]:
    import textwrap

    return textwrap.wrap(text, _WIDTH, initial_indent="# ", subsequent_indent="# ")


def _optional_line(key: str, value: str, comment: str) -> str:
    """Return a commented-out optional line."""
    code = f"# {key} = {value}" if value else f"# {key}"
    return f"{code:<26}  # {comment}"


def _servo(
    record: Record, mapping: Mapping, experiments: Sequence[ExperimentProposal], elastic: bool
) -> str:
    """Return [servo]: required if step records are compared with a simulation, else optional."""
    gains = "[" + ", ".join([TODO] * len(mapping.joints)) + "]"
    entries = [
        (key, value.format(period=record.period, gains=gains), comment)
        for key, value, comment in _SERVO
    ]
    steps = [
        each.record.name
        for each in experiments
        if each.use in ("tuning", "check") and each.joint is not None and "servo" in each.control
    ]
    if not (elastic and steps):
        return "\n".join(
            [_optional_line("[servo]", "", _SERVO_OPTIONAL), *(_optional_line(*e) for e in entries)]
        )
    names = ", ".join(steps[:4]) + (f" and {len(steps) - 4} more" if len(steps) > 4 else "")
    reason = _wrapped(_SERVO_NEEDED.format(names=names, them="it" if len(steps) == 1 else "them"))
    return "\n".join([*reason, "[servo]", *(_line(*each) for each in entries)])


def _arm(mapping: Mapping) -> str:
    is_two_link = len(mapping.joints) == 2
    kind = "planar-two-link" if is_two_link else "single-joint"
    evidence = "there are angles of two joints" if is_two_link else "there is one joint angle"
    lines = ["[arm]", _line("kind", _quoted(kind), f"likely: {evidence}")]
    if is_two_link:
        lines.append(_line("link_length", TODO, _VALUE_SOURCES["link_length"]))
    if not any(facts.prismatic for facts in mapping.joints):
        lines.append(
            _optional_line("gravity", "9.81", "[m/s^2] if the arm moves in a vertical plane: links")
        )
        lines += _wrapped(
            "then lie along +x at zero angle; if your zero hangs down, set the offset of theta_m1 "
            "to -1.5708/gear_ratio"
        )
    return "\n".join(lines)


def _joint(number: int, facts: JointFacts, elastic: bool) -> str:
    lines = [f"[[joint]]                   # {number}"]
    if facts.prismatic:
        lines.append(_line("motion", '"prismatic"', "likely: according to its units; m, N, kg"))
    spring = '"linear"' if elastic else '"rigid"'
    lines += [_line("spring", spring, _spring_reason(facts, elastic)), _gear(facts)]
    if facts.voltage:
        lines.append(_line("torque_per_volt", TODO, _VALUE_SOURCES["torque_per_volt"]))
    if facts.encoder_counts:
        counts, reason = facts.encoder_counts
        write_line, sure = (_line, "likely") if counts else (_optional_line, "unsure")
        lines.append(
            write_line("encoder_counts", str(counts or TODO), f"{sure}: {reason}; per motor turn")
        )
    if "a" in facts.link_sensors:
        lines.append(
            _line("accelerometer_distance", TODO, _VALUE_SOURCES["accelerometer_distance"])
        )
        lines.append(_line("accelerometer_hz", TODO, _BANDWIDTH))
    if "gyro" in facts.link_sensors:
        lines.append(_line("gyro_hz", TODO, _BANDWIDTH))
    if "imu" in facts.link_sensors:
        lines.append(_optional_line("imu", "{ accelerometer_hz = 300.0, gyro_hz = 100.0 }", _IMU))
    if facts.voltage and elastic:
        lines.append(_line("current_loop_hz", TODO, _CURRENT_LOOP))
    return "\n".join(lines)


def _spring_reason(facts: JointFacts, elastic: bool) -> str:
    if not elastic:
        return "unsure: no link sensor is logged, so no spring is identifiable"
    sensors = ", ".join(sorted(facts.link_sensors))
    sensor_reason = f"likely: there is a sensor on the link ({sensors})"
    reason = (
        sensor_reason
        if sensors
        else "unsure: the other joint is elastic, or there are vibration records"
    )
    return reason + '; or "three-slope": strain-wave gears stiffen'


def _gear(facts: JointFacts) -> str:
    if facts.gear_ratio:
        ratio, reason = facts.gear_ratio
        note = f"likely: {reason}; link turns per motor turn, see the data sheet"
        return _line("gear_ratio", f"{ratio:.6g}", note)
    if facts.prismatic:
        return _line("gear_ratio", "1.0", "likely: all signals are logged along the axis")
    return _line("gear_ratio", TODO, _VALUE_SOURCES["gear_ratio"])


def _channels(records: Sequence[Record], mapping: Mapping) -> str:
    """Return [channels].

    A column that has the name of its channel needs no line and may be missing in a log.
    """
    record = records[0]
    lines = ["[channels]                  # value = scale * column + offset, in SI units"]
    direct_channels = [
        g.channel for g in mapping.guesses.values() if g.column == g.channel and g.scale == 1.0
    ]
    if record.time_column is not None:
        rate = 1.0 / record.period
        reason = f"sure: increases by {record.period / record.time_scale:.4g} {record.time_unit}, "
        unit = record.time_unit
        reason += f"{rate:.4g} Hz" if unit == "s" else f"{rate:.4g} Hz if its unit is {unit}"
        if record.time_column == "t" and record.time_scale == 1.0:
            lines += _wrapped(f"t: {reason}")
        else:
            lines.append(
                _line("t", _entry(record.time_column, record.time_scale, of_bag=False), reason)
            )
    if direct_channels:
        lines += _wrapped(f"sure: channel names, in SI units: {', '.join(direct_channels)}")
    for guess in mapping.guesses.values():
        if guess.channel not in direct_channels:
            lines.append(_guess(guess, records))
    for channel, description in mapping.missing.items():
        lines.append(_line(channel, f'"{TODO}"', f"no column was found for {description}"))
    for column, reason in mapping.unused.items():
        lines += _wrapped(f"not used: {_quoted(column)}: {reason}")
    faults = (f"{each.path.name}: {fault}" for each in records for fault in each.faults)
    for note in dict.fromkeys((mapping.limit, *mapping.notes, *record.notes, *faults)):
        if note:
            lines += _wrapped(f"note: {note}")
    return "\n".join(lines)


def _guess(guess: Guess, records: Sequence[Record]) -> str:
    """Return the line of one channel, with the logs that lack its column."""
    comment = f"{guess.sure}: {guess.reason}"
    of_bag = any(record.is_bag for record in records if guess.column in record.columns)
    logs_without = [record.path.name for record in records if guess.column not in record.columns]
    if logs_without:
        comment += f"; not in {', '.join(logs_without)}: absent there"
    if guess.scale is None:
        comment = f"{TODO}: {guess.todo}. {comment}"
    return _line(guess.channel, _entry(guess.column, guess.scale, of_bag), comment)


def _entry(column: str, scale: float | None, of_bag: bool) -> str:
    """Return the value of a channel in [channels]; a bag column is /topic.field[joint or index]."""
    value = TODO if scale is None else repr(float(scale))
    scaled = "" if scale == 1.0 else f", scale = {value}"
    if not of_bag:
        name = _quoted(column)
        return f"{{ column = {name}{scaled} }}" if scaled else name
    topic, _, rest = column.partition(".")
    text = f"{{ topic = {_quoted(topic)}, "
    if rest.endswith("]") and not rest[rest.rindex("[") + 1 : -1].isdecimal():
        at = rest.rindex("[")
        name = _quoted(rest[at + 1 : -1])
        return text + f"field = {_quoted(rest[:at])}, name = {name}{scaled} }}"
    return text + f"field = {_quoted(rest)}{scaled} }}"


def _experiment(each: ExperimentProposal, out: Path) -> str:
    path = os.path.relpath(each.record.path, out.parent).replace(os.sep, "/")
    record = each.record
    span = f"{record.time[-1] - record.time[0]:.4g} s at {1.0 / record.period:.4g} Hz"
    control = ", ".join(f'"{control}"' for control in each.control)
    lines = [
        "[[experiment]]",
        f"name = {_quoted(record.name)}",
        _line("file", _quoted(path), span),
        _line("use", f'"{each.use}"', f"likely: {each.reason}"),
    ]
    if each.joint is not None:
        lines.append(_line("joint", str(each.joint), "the excited joint"))
    lines.append(f"control = [{control}]")
    if each.prbs is not None:
        p = each.prbs
        amplitude = repr(p.amplitude) if each.has_known_amplitude else TODO
        value = f"{{ order = {p.order}, clock = {p.clock!r}, periods = {p.periods}, "
        value += f"amplitude = {amplitude} }}"
        lines.append(
            _line("prbs", value, "likely: from its run lengths and period; amplitude in V")
        )
    return "\n".join(lines)


def _quoted(text: str) -> str:
    """Return a TOML string; JSON escapes do not suffice, because TOML forbids a raw DEL."""
    import tomli_w

    return tomli_w.dumps({"text": text}).removeprefix("text = ").removesuffix("\n")
