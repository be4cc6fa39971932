"""Map the columns of one joint: angles first, then the columns that depend on them."""

from __future__ import annotations

import re
from collections.abc import Sequence
from math import pi
from typing import NamedTuple

import numpy as np

from strainwave.domain import FloatArray
from strainwave.study_draft.candidates import (
    MIN_RANGE_SHARE,
    MIN_RELATED_CORRELATION,
    Guess,
    JointFacts,
    Mapping,
    Sure,
)
from strainwave.study_draft.inspection import Record
from strainwave.study_draft.names import COUNTS, LINEAR, UNITS, ParsedName
from strainwave.study_draft.signal_features import (
    MAX_UNIT_RATIO_ERROR,
    UnitPair,
    flat_top,
    levels,
    nearest_unit,
    proportion,
    quantum,
    unit_pair,
    usual_counts,
    wraps,
)
from strainwave.study_draft.signal_features import relation as relation_of

_MAX_REVERSED_CORRELATION = -0.5  # correlation below which the sensor's sign is reversed
_SENSORS = {"acceleration": "a", "gyro": "gyro", "deflection": "deflection"}  # with its channel
_SENSOR_UNITS = {"acceleration": "m/s^2", "gyro": "rad/s", "deflection": "rad"}
_JOINT_STATE = re.compile(r"(?P<topic>/[^.]*)\.position(?P<joint>\[.*[^\d\]].*\])")
_AXIS = re.compile(r"(?<![A-Za-z])[xyz](?![A-Za-z])", re.IGNORECASE)  # of an IMU, in a name
_COUNTS_SCALE = "2 pi / counts per motor turn [rad]"


class _AngleUnit(NamedTuple):
    scale: float | None  # SI factor; None: see `todo`
    reason: str
    todo: str = ""  # what the user must enter as the scale


class JointColumns:
    """Mapping of one joint's columns in progress."""

    def __init__(
        self,
        record: Record,
        parsed_names: dict[str, ParsedName],
        number: int,
        mapping: Mapping,
        *,
        has_spatial_links: bool,
    ) -> None:
        self.record = record
        self.parsed_names = parsed_names
        self.number = number
        self.mapping = mapping
        self.has_spatial_links = has_spatial_links
        self.exceeded = ""  # URDF with limits that the angles of the arm exceed
        self.facts = JointFacts()
        mapping.joints.append(self.facts)
        self.angle, self.link_angle = self._choose_angles()
        self.facts.joint_side = self._joint_states()

    def map(self) -> None:
        """Map the angles, then classify the other columns by their relation to the motor angle."""
        motor = self.angle
        if motor is None:
            self.mapping.missing[f"theta_m{self.number}"] = "the motor angle [rad at the motor]"
        else:
            self._angle(motor)
            self._velocity(motor)
            self._encoder(motor)
            self._reference(motor)
        if motor is not None and self.link_angle is not None:
            if self.facts.joint_side:
                self.mapping.unused[self.link_angle] = f"another angle of joint {self.number}"
            else:
                self._link(motor, self.link_angle)
        self._input()
        self._temperature()
        self._sensors(motor)

    def choose_record(self, others: Sequence[Record]) -> None:
        """Classify the columns by another record if the joint hardly moves in the fullest."""
        if self.angle is None:
            return
        column, names = self.angle, self.parsed_names.keys()
        records = [self.record, *(each for each in others if names <= each.columns.keys())]
        ranges = [float(np.ptp(each.columns[column])) for each in records]
        if ranges[0] < MIN_RANGE_SHARE * max(ranges):
            self.record = records[int(np.argmax(ranges))]

    def scaled_angle(self) -> FloatArray:
        """The angle in SI units; zero if its unit is unknown, or if there is none."""
        scale = None if self.angle is None else self._angle_unit(self.angle).scale
        if self.angle is None or scale is None:
            return np.zeros(len(self.record.time))
        return scale * self._values(self.angle)

    def _joint_states(self) -> str:
        """Why angle and torque are of the joint: both are of one message of joint states."""
        match = _JOINT_STATE.fullmatch(self.angle or "")
        if match is None or f"{match['topic']}.effort{match['joint']}" not in self.parsed_names:
            return ""
        return f"{match['topic']} has positions and efforts of the joints"

    def _columns_of(self, quantity: str) -> list[str]:
        return [name for name, each in self.parsed_names.items() if each.quantity == quantity]

    def _add(self, channel: str, column: str, reason: str, sure: Sure, **more: object) -> None:
        key = f"{channel}{self.number}"
        if column == key and more.get("scale", 1.0) == 1.0:
            reason, sure = "a channel name, in SI units", "sure"
        self.mapping.guesses[key] = Guess(key, column, reason, sure, **more)  # type: ignore[arg-type]

    def _values(self, column: str) -> FloatArray:
        return self.record.columns[column]

    def _choose_angles(self) -> tuple[str | None, str | None]:
        """Return the columns of motor angle and link angle.

        Names decide; without a side in the name, the angle with the larger range is the motor's.
        Joint states precede other topics.
        """
        names = sorted(self._columns_of("angle"), key=lambda n: -float(np.ptp(self._values(n))))
        names.sort(key=lambda name: _JOINT_STATE.fullmatch(name) is None)
        link = [n for n in names if self.parsed_names[n].side == "link"]
        motor = [n for n in names if self.parsed_names[n].side == "motor"]
        no_side = [n for n in names if n not in link + motor]
        motor_candidates = motor + no_side
        motor_angle = motor_candidates[0] if motor_candidates else link.pop(0) if link else None
        link_angle = next(iter(link + motor_candidates[1:]), None)
        for name in names:
            if name not in (motor_angle, link_angle):
                self.mapping.unused[name] = f"another angle of joint {self.number}"
        return motor_angle, link_angle

    def _angle(self, column: str) -> None:
        each = self.parsed_names[column]
        sure: Sure = "likely" if each.sure else "unsure"
        name_reason = _evidence(each)
        scale, unit_reason, todo = self._angle_unit(column)
        if not self.facts.name:
            linear = [e for e in (each, *self._inputs()) if e.unit in LINEAR]
            self.facts.prismatic = bool(linear)
        if self.facts.joint_side:
            unit_reason += "; of the joint"
        elif each.side == "link":
            scale, todo = None, "1/gear_ratio: motor turns per link turn"
            unit_reason = "an angle of the link; there is no motor angle"
        elif self.exceeded:
            unit_reason += f"; angles exceed the limits of {self.exceeded}: those of motors"
        elif each.side is None and not self.facts.prismatic:
            unit_reason += (
                "; assumed to be the motor angle: if it is the link angle, divide the scale by"
            )
            unit_reason += " gear_ratio"
        if wraps(self._values(column), 2.0 * pi if scale == 1.0 else 360.0):
            unit_reason += "; IT JUMPS BY ONE TURN: unwrap it in the log first"
        self._add("theta_m", column, f"{name_reason}; {unit_reason}", sure, scale=scale, todo=todo)

    def _inputs(self) -> list[ParsedName]:
        return [
            each for each in self.parsed_names.values() if each.quantity in ("torque", "velocity")
        ]

    def _angle_unit(self, column: str) -> _AngleUnit:
        unit = self.parsed_names[column].unit
        if unit in COUNTS:
            return _AngleUnit(None, "in counts according to its name", _COUNTS_SCALE)
        if unit is not None:
            return _AngleUnit(UNITS["angle"][unit], f"unit {unit} according to its name")
        for velocity in self._columns_of("velocity"):
            units = self._unit_pair(column, velocity)
            if units and self.parsed_names[velocity].unit is None:
                return _AngleUnit(units.angle_scale, f"with {velocity!r}: {units.text}")
            rate = UNITS["velocity"].get(self.parsed_names[velocity].unit or "")
            r, ratio = self._relation(velocity, column)
            if rate and r > MIN_RELATED_CORRELATION and ratio > 0.0:
                scale = nearest_unit(rate / ratio)
                return _AngleUnit(scale, f"unit from {velocity!r}, of which it is the integral")
        values = self._values(column)
        if np.all(values == np.round(values)) and np.ptp(values) > 100.0:
            return _AngleUnit(None, "whole numbers: counts?", _COUNTS_SCALE)
        assumed = "m" if self.facts.prismatic else "rad"
        return _AngleUnit(1.0, f"assumed unit {assumed}: the log does not state a unit")

    def _relation(self, rate: str, value: str) -> tuple[float, float]:
        return relation_of(self._values(rate), self._values(value), self.record.time)

    def _by_relation(self, quantity: str, angle: str) -> list[str]:
        """Columns of a quantity; first the one that is most like the derivative of the angle."""
        return sorted(self._columns_of(quantity), key=lambda n: -self._relation(n, angle)[0])

    def _unit_pair(self, angle: str, velocity: str) -> UnitPair | None:
        r, ratio = self._relation(velocity, angle)
        return unit_pair(ratio) if r > MIN_RELATED_CORRELATION else None

    def _velocity(self, angle: str) -> None:
        angle_scale = self.mapping.guesses[f"theta_m{self.number}"].scale
        for column in self._by_relation("velocity", angle):
            r, ratio = self._relation(column, angle)
            if f"omega_m{self.number}" in self.mapping.guesses:
                self.mapping.unused[column] = f"another velocity of joint {self.number}"
                continue
            agrees = r > MIN_RELATED_CORRELATION and ratio > 0.0
            if not agrees or angle_scale is None:
                reason = f"a velocity according to its name, but not of {angle!r} (r = {r:.2f})"
                self.mapping.unused[column] = reason if not agrees else "a velocity of the link"
                continue
            scale = ratio * angle_scale
            nearest = nearest_unit(scale)
            if abs(scale / nearest - 1.0) > 2.0 * MAX_UNIT_RATIO_ERROR:
                reason = f"a velocity, but {angle!r} changes {scale:.4g} times as fast: is one of "
                reason += "them measured at the link?"
                self.mapping.unused[column] = reason
                if 5.0 < scale < 1000.0:
                    self.facts.gear_ratio = (1.0 / round(scale), f"{angle!r} over {column!r}")
                continue
            reason = f"its integral is {angle!r} (r = {r:.3f})"
            self._add("omega_m", column, reason, "sure", scale=nearest)

    def _encoder(self, angle: str) -> None:
        if self.facts.joint_side:
            return  # drivers of robots round angles to decimals, not to counts
        scale = self.mapping.guesses[f"theta_m{self.number}"].scale
        step = quantum(self._values(angle))
        if scale is None or step is None or self.facts.prismatic:
            return
        counts = 2.0 * pi / (step * scale)
        if 16.0 < counts < 5e6:
            reason = f"{angle!r} changes in steps of {step * scale:.6g} rad, {counts:.6g} per turn"
            common_counts = usual_counts(counts)
            if common_counts is not None and round(counts) != common_counts:
                reason += f"; {common_counts} is the nearest common encoder resolution"
            self.facts.encoder_counts = (common_counts, reason) if common_counts else (None, reason)

    def _reference(self, angle: str) -> None:
        for column in self._by_relation("reference", angle):
            if f"ref{self.number}" in self.mapping.guesses:
                self.mapping.unused[column] = f"another reference of joint {self.number}"
                continue
            values, each = self._values(column), self.parsed_names[column]
            velocity_r, _ = self._relation(column, angle)
            centred_angle = self._values(angle) - self._values(angle).mean()
            angle_r, _ = proportion(centred_angle, values - values.mean())
            scale = UNITS["reference"].get(each.unit or "", 1.0)
            if angle_r > max(velocity_r, MIN_RELATED_CORRELATION):
                self.mapping.unused[column] = (
                    f"a reference of {angle!r}; only velocity references are used"
                )
            else:
                sure: Sure = "sure" if velocity_r > MIN_RELATED_CORRELATION else "unsure"
                reason = f"{_evidence(each)}; {angle!r} is its integral (r = {velocity_r:.2f})"
                self._add("ref", column, reason, sure, scale=scale)

    def _link(self, motor: str, link: str) -> None:
        """Map the link angle and derive the gear ratio: link turns per motor turn."""
        of_motor, of_link = (self._values(n) - self._values(n).mean() for n in (motor, link))
        r, ratio = proportion(of_motor, of_link)
        scale, todo, unit_reason = self._angle_unit(link)
        sure: Sure = "likely" if r > MIN_RELATED_CORRELATION else "unsure"
        reason = f"{_evidence(self.parsed_names[link])}; it correlates with {motor!r} "
        reason += f"(r = {r:.3f}); {unit_reason}"
        self._add("theta_l", link, reason, sure, scale=scale, todo=todo)
        self.facts.link_sensors.add("theta_l")
        motor_scale = self.mapping.guesses[f"theta_m{self.number}"].scale
        if (
            r > MIN_RELATED_CORRELATION
            and motor_scale
            and scale
            and 0.0 < ratio * scale / motor_scale <= 1.05
        ):
            gear_ratio = 1.0 / max(1.0, round(motor_scale / (ratio * scale)))
            self.facts.gear_ratio = (
                gear_ratio,
                f"{link!r} over {motor!r}: {ratio * scale / motor_scale:.5g}",
            )

    def _input(self) -> None:
        """Map the input of the drive, and the torque that a sensor measures behind the gear."""
        torques = sorted(self._columns_of("torque"), key=self._distance_from_drive)
        voltages, currents = self._columns_of("voltage"), self._columns_of("current")
        sensors = [name for name in torques if self.parsed_names[name].side == "link"]
        if sensors and (len(sensors) < len(torques) or voltages or currents):
            self._torque_sensor(sensors.pop(0))
            torques = [n for n in torques if self.parsed_names[n].side != "link"] + sensors
        for quantity, channel, columns in (
            ("torque", "torque", torques),
            ("voltage", "u", voltages),
            ("current", "torque", currents),
        ):
            for column in columns:
                other = self._mapped_input()
                if other is not None:
                    reason = f"a {quantity} according to its name; {other!r} is used. If both act: "
                    self.mapping.unused[column] = reason + "see `add` in docs/study.md"
                    continue
                self._add_input(column, quantity, channel)
        if self._mapped_input() is None:
            channel, description = (
                ("torque", "the torque [N m at the joint]; for a voltage, map u instead")
                if self.facts.joint_side
                else ("u", "the drive voltage [V]; for a torque, map torque instead")
            )
            self.mapping.missing[f"{channel}{self.number}"] = description

    def _distance_from_drive(self, torque: str) -> tuple[bool, bool, bool]:
        """Order of torques: of the angle's topic, of the motor, then without unknown words."""
        each = self.parsed_names[torque]
        topic = torque.partition(".")[0] if torque.startswith("/") else ""
        is_elsewhere = not (topic and (self.angle or "").startswith(f"{topic}."))
        return is_elsewhere, each.side != "motor", bool(each.unrecognised_word)

    def _torque_sensor(self, column: str) -> None:
        each = self.parsed_names[column]
        reason = f"{_evidence(each)}, of the link" + ("" if each.unit else "; assumed unit N m")
        scale = UNITS["torque"].get(each.unit or "", 1.0)
        self._add("tau_l", column, reason, "likely" if each.sure else "unsure", scale=scale)
        self.facts.link_sensors.add("tau_l")

    def _temperature(self) -> None:
        for column in self._columns_of("temperature")[:1]:
            each = self.parsed_names[column]
            unit = "" if each.unit else "; assumed unit degC"
            self._add("temperature", column, f"{_evidence(each)}, never fitted{unit}", "likely")

    def _mapped_input(self) -> str | None:
        """The column of the drive's torque or voltage."""
        channels = (f"torque{self.number}", f"u{self.number}")
        guesses = (self.mapping.guesses[c] for c in channels if c in self.mapping.guesses)
        return next((guess.column for guess in guesses), None)

    def _add_input(self, column: str, quantity: str, channel: str) -> None:
        each = self.parsed_names[column]
        scale: float | None = UNITS[each.quantity or "voltage"].get(each.unit or "", 1.0)
        todo, reason = "", _evidence(each)
        side = "joint" if self.facts.joint_side else "motor"
        if quantity == "current":
            scale, todo = None, f"torque constant [N m/A], at the {side}; times 1e-3 for mA"
        input_levels = levels(self._values(column))
        if input_levels is not None and len(input_levels) > 1:
            reason += f"; it has {len(input_levels)} levels"
        limit = flat_top(self._values(column))
        if input_levels is None and limit is not None:
            reason += f"; it repeatedly stays at {limit:.4g}: the limit of the drive?"
        if each.word in ("pwm", "duty"):
            scale, todo = None, "volts at full duty"
        if each.unit is None and quantity != "current":
            reason += f"; assumed unit {'V' if quantity == 'voltage' else f'N m at the {side}'}"
        self.facts.voltage = channel == "u"
        self._add(
            channel, column, reason, "likely" if each.sure else "unsure", scale=scale, todo=todo
        )

    def _sensors(self, motor: str | None) -> None:
        """Map of each kind of sensor the axis that correlates best with the motor's motion."""
        for quantity, channel in _SENSORS.items():
            columns = [n for n in self._columns_of(quantity) if np.ptp(self._values(n)) > 0.0]
            if self.has_spatial_links and self._imu(quantity, columns):
                continue
            correlations = {n: self._motion_correlation(n, quantity, motor) for n in columns}
            column = max(columns, key=lambda name: abs(correlations[name]), default=None)
            if column is None:
                continue
            each, r = self.parsed_names[column], correlations[column]
            scale, reason = UNITS[each.quantity or "gyro"].get(each.unit or "", 1.0), ""
            n_columns = len(self._columns_of(quantity))
            if n_columns > 1:
                reason += f"; of {n_columns} columns the one that correlates with the motor"
                reason += f" (r = {r:.2f})"
            if r < _MAX_REVERSED_CORRELATION:
                scale, reason = -scale, f"{reason}; it points the other way, so the sign is turned"
            if each.unit is None:
                reason += f"; assumed unit {_SENSOR_UNITS[quantity]}"
            if not each.placed:
                reason += "; no joint in its name: the last joint is assumed"
            sure: Sure = "likely" if each.sure and each.placed else "unsure"
            self._add(channel, column, _evidence(each) + reason, sure, scale=scale)
            self.facts.link_sensors.add(channel)
            for other in columns:
                if other != column:
                    self.mapping.unused[other] = "another axis of the same sensor"

    def _imu(self, quantity: str, columns: list[str]) -> bool:
        """Map the axes x, y, z of an IMU. Returns False if the columns are not such axes."""
        matches = {name: _AXIS.search(name) for name in columns}
        axes = {name: match[0].lower() for name, match in matches.items() if match}
        if quantity == "deflection" or not columns or len(set(axes.values())) < len(columns):
            return False
        for name, axis in axes.items():
            each = self.parsed_names[name]
            reason = f"{_evidence(each)}; axis {axis} of an IMU"
            if each.unit is None:
                reason += f"; assumed unit {_SENSOR_UNITS[quantity]}"
            if not each.placed:
                reason += "; no joint in its name: the last joint is assumed"
            sure: Sure = "likely" if each.sure and each.placed else "unsure"
            scale = UNITS[each.quantity or "gyro"].get(each.unit or "", 1.0)
            self._add(f"{quantity[0]}{axis}", name, reason, sure, scale=scale)
        self.facts.link_sensors.add("imu")
        return True

    def _motion_correlation(self, column: str, quantity: str, motor: str | None) -> float:
        """Correlation with the motor's acceleration or velocity; 0 if that is unknown."""
        if motor is None or quantity == "deflection":
            return 0.0
        angle, values, time = self._values(motor), self._values(column), self.record.time
        motion = np.gradient(angle, time) if quantity == "acceleration" else angle
        return relation_of(values - values.mean(), motion, time)[0]


def _evidence(each: ParsedName) -> str:
    if each.word:
        return f"{each.quantity} according to its name"
    return f"{each.quantity} according to its {'unit' if each.unit else 'data'}"
