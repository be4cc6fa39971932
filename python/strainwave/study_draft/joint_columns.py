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
from strainwave.study_draft.names import LINEAR, UNITS, ParsedName
from strainwave.study_draft.signal_features import (
    MAX_UNIT_RATIO_ERROR,
    UnitPair,
    flat_top,
    is_register,
    levels,
    nearest_unit,
    proportion,
    quantum,
    sign_bit,
    slope_error,
    unit_pair,
    usual_counts,
    wrap_modulus,
)
from strainwave.study_draft.signal_features import relation as relation_of

_MAX_REVERSED_CORRELATION = -0.5  # correlation below which the sensor's sign is reversed
_SENSORS = {"acceleration": "a", "gyro": "gyro", "deflection": "deflection"}  # with its channel
_SENSOR_UNITS = {"acceleration": "m/s^2", "gyro": "rad/s", "deflection": "rad"}
_JOINT_STATE = re.compile(r"(?P<topic>/[^.]*)\.position(?P<joint>\[.*[^\d\]].*\])")
_AXIS = re.compile(r"(?<![A-Za-z])[xyz](?![A-Za-z])", re.IGNORECASE)  # of an IMU, in a name
DEGREE = pi / 180.0
_MIN_DETERMINED_CORRELATION = 0.98  # of two angles of one joint, if one determines the other
_MAX_LIMIT_RATIO = 5.0  # of a torque to the effort limit of a URDF, which is a continuous torque
_MAX_ASSUMED_ANGLE = 500.0  # [rad] largest angle that is assumed to be in rad
# [kg m^2] standard deviations of torque over acceleration of arms; others have another unit
_INERTIAS = (1e-7, 1e4)
_COUNTS_SCALE = "2 pi / counts per motor turn [rad]"
_MIN_RATIO_ERROR = 1e-4  # relative; a log of few digits states a ratio no better
_MAX_DERIVATIVE_ERROR = 0.05  # relative, of the ratio of an acceleration to its velocity in SI


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
        self.effort_limit = np.inf  # [N m] of the URDF
        self.degrees = ""  # why angles without a unit are in degrees
        self.facts = JointFacts()
        mapping.joints.append(self.facts)
        self.angle, self.link_angle = self._choose_angles()
        self.facts.joint_side = self._joint_states()

    def map(self) -> None:
        """Map the angles, then classify the other columns by their relation to the motor angle."""
        motor = self.angle
        if motor is None and self._columns_of("velocity"):
            self._velocity_alone(self._columns_of("velocity"))
        elif motor is None:
            self.mapping.missing[f"theta_m{self.number}"] = "the motor angle [rad at the motor]"
        else:
            self._angle(motor)
            self._velocity(motor)
            self._encoder(motor)
            self._reference(motor)
            self._second_derivatives(motor)
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

    def largest_torque(self) -> float:
        """Largest known torque [N m]; zero if there is none."""
        columns = [n for n in self._columns_of("torque") if self._role(n) != "desired"]
        scales = [self.parsed_names[n].scale_or(1.0) or 0.0 for n in columns]
        values = [s * np.abs(self._values(n)).max() for s, n in zip(scales, columns, strict=True)]
        return float(max(values, default=0.0))

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

    def _has_velocity(self, angle: str) -> bool:
        """Whether a column named as a velocity is that of an angle."""
        values, time = self._values(angle), self.record.time
        return any(
            relation_of(self._values(name), values, time)[0] > MIN_RELATED_CORRELATION
            for name in self._columns_of("velocity")
        )

    def _choose_angles(self) -> tuple[str | None, str | None]:
        """Return the columns of motor angle and link angle.

        Names decide; without a side in the name, the angle with the larger range is the motor's. A
        second angle without a side is the link's if the first one's name is of the motor and it
        determines the second. Joint states precede other topics, measured angles others, and angles
        of which a column is the velocity those without.
        """
        names = sorted(self._columns_of("angle"), key=lambda n: -float(np.ptp(self._values(n))))
        if len(names) > 1:
            names.sort(
                key=lambda n: (
                    _JOINT_STATE.fullmatch(n) is None,
                    self._role(n) != "actual",
                    not self._has_velocity(n),
                )
            )
        link = [n for n in names if self.parsed_names[n].side == "link"]
        motor = [n for n in names if self.parsed_names[n].side == "motor"]
        no_side = [n for n in names if n not in link + motor]
        motor_candidates = motor + no_side
        motor_angle = motor_candidates[0] if motor_candidates else link.pop(0) if link else None
        link_angle = next(iter(link), None)
        for name in names:
            if motor_angle is None or name in (motor_angle, link_angle):
                continue
            r, ratio = self._proportion(motor_angle, name)
            determined = abs(r) > _MIN_DETERMINED_CORRELATION
            if determined and link_angle is None and motor and name in no_side:
                link_angle = name
                continue
            reason = f"another angle of joint {self.number}"
            if name in no_side and motor_angle in no_side:
                reason += (
                    f" (r = {r:.2f}, {ratio:.4g} times {motor_angle!r}); if one is the motor's"
                )
                reason += " and the other the link's, or they are two joints, name them so"
                self.mapping.warnings += (f"{name!r} is not used: it is {reason}",)
            self.mapping.unused[name] = reason
        return motor_angle, link_angle

    def _role(self, column: str) -> str | None:
        return self.parsed_names[column].role

    def _proportion(self, x: str, y: str) -> tuple[float, float]:
        """Correlation of two columns, and change of `y` per change of `x`."""
        return proportion(*(self._values(n) - self._values(n).mean() for n in (x, y)))

    def _angle(self, column: str) -> None:
        each = self.parsed_names[column]
        sure: Sure = "likely" if each.sure else "unsure"
        name_reason = _evidence(each)
        scale, unit_reason, todo = self._angle_unit(column)
        if not self.facts.name:
            linear = [e for e in (each, *self._inputs()) if e.unit and e.unit in LINEAR]
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
        modulus = wrap_modulus(self._values(column))
        if modulus is not None:
            unit_reason += f"; it jumps by one turn of {modulus:.4g}"
        self._add("theta_m", column, f"{name_reason}; {unit_reason}", sure, scale=scale, todo=todo)

    def _inputs(self) -> list[ParsedName]:
        return [
            each for each in self.parsed_names.values() if each.quantity in ("torque", "velocity")
        ]

    def _angle_unit(self, column: str) -> _AngleUnit:
        """Unit of an angle: by its name, its turn, its velocity, its limits, else by its size."""
        measure, values = self.parsed_names[column].measure, self._values(column)
        by_data = self._unit_by_turn(values) or self._unit_by_velocity(column)
        largest = np.abs(values).max()
        bit = sign_bit(values, wraps=True)
        if bit is not None:
            todo = f"bit {bit} of the register is the sign: decode the column; then {_COUNTS_SCALE}"
            return _AngleUnit(None, "a register read as unsigned", todo)
        if measure is not None:
            reason = f"unit {measure.text} according to its name"
            return _AngleUnit(measure.scale, reason, measure.todo)
        if by_data is not None:
            return by_data
        if self.degrees:
            return _AngleUnit(DEGREE, self.degrees)
        is_doubtful = largest > _MAX_ASSUMED_ANGLE and column != f"theta_m{self.number}"
        if is_doubtful or not self.parsed_names[column].word:
            todo = f"1 for rad, pi/180 for degrees, {_COUNTS_SCALE}"
            return _AngleUnit(None, f"no unit in its name, and values up to {largest:.4g}", todo)
        assumed = "m" if self.facts.prismatic else "rad"
        return _AngleUnit(1.0, f"assumed unit {assumed}: the log does not state a unit")

    def _unit_by_turn(self, values: FloatArray) -> _AngleUnit | None:
        """Unit of an angle in whole numbers, or of one that wraps at a turn."""
        modulus = wrap_modulus(values)
        if is_register(values):
            return _AngleUnit(None, "whole numbers: counts?", _COUNTS_SCALE)
        if modulus is None:
            return None
        for turn, scale in {2.0 * pi: 1.0, 360.0: DEGREE, 1.0: 2.0 * pi}.items():
            if abs(modulus / turn - 1.0) < MAX_UNIT_RATIO_ERROR:
                return _AngleUnit(scale, f"it wraps at one turn of {turn:.4g}")
        return _AngleUnit(None, "its turn is of no usual unit", f"2 pi / {modulus:.6g}?")

    def _unit_by_velocity(self, column: str) -> _AngleUnit | None:
        """Unit of an angle that is the integral of a velocity in a known or another unit."""
        for velocity in self._columns_of("velocity"):
            rate = self.parsed_names[velocity].scale_or(None)
            units = self._unit_pair(column, velocity) if rate is None else None
            if units and units.ratio != 1.0:
                return _AngleUnit(units.angle_scale, f"with {velocity!r}: {units.text}")
            r, ratio = self._relation(velocity, column)
            if rate and r > MIN_RELATED_CORRELATION and ratio > 0.0:
                scale = nearest_unit(rate / ratio)
                return _AngleUnit(scale, f"unit from {velocity!r}, of which it is the integral")
        return None

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
            each = self.parsed_names[column]
            if not agrees:
                reason = f"a velocity according to its name, but not of {angle!r} (r = {r:.2f})"
                self.mapping.unused[column] = reason
                continue
            if angle_scale is None:
                self._velocity_of_open_angle(column, angle)
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
            stated = each.scale_or(nearest) or nearest
            if abs(stated / nearest - 1.0) > 2.0 * MAX_UNIT_RATIO_ERROR:
                todo = f"{stated:.6g} according to its name, {nearest:.6g} according to {angle!r}"
                self._add("omega_m", column, reason, "unsure", scale=None, todo=todo)
                continue
            sure: Sure = "sure" if each.unit else "likely"
            self._add("omega_m", column, reason, sure, scale=nearest)

    def _velocity_of_open_angle(self, column: str, angle: str) -> None:
        """Map the velocity of an angle whose scale is open: by its name, else open too."""
        each = self.parsed_names[column]
        side = self.parsed_names[angle].side
        if side == "link":
            self.mapping.unused[column] = "a velocity of the link"
            return
        scale = each.scale_or(None)
        todo = each.todo if scale is None else ""
        reason = f"its integral is {angle!r}, whose unit is open"
        if scale is None and not todo:
            factor = self._relation(column, angle)[1]
            todo = f"{factor:.6g} times the scale of theta_m{self.number}"
        sure: Sure = "likely" if scale is not None else "unsure"
        self._add("omega_m", column, reason, sure, scale=scale, todo=todo)

    def _velocity_alone(self, columns: Sequence[str]) -> None:
        """Map the velocity of a motor without a logged angle."""
        column = min(columns, key=lambda name: self._role(name) != "actual")
        each = self.parsed_names[column]
        scale, todo = each.scale_or(1.0), each.todo
        reason = f"{_evidence(each)}; there is no angle"
        if each.unit is None and is_register(self._values(column)):
            scale, todo = None, "2 pi / counts per turn [rad/s per unit]"
        elif each.unit is None:
            reason += "; assumed unit rad/s"
        self._add("omega_m", column, reason, "likely", scale=scale, todo=todo)

    def _second_derivatives(self, angle: str) -> None:
        """Set accelerations of the joint aside: they are neither angles nor sensors of a link."""
        for column in self._columns_of("second_derivative"):
            velocities = [*self._columns_of("velocity"), angle]
            source = next((n for n in velocities if self._is_derivative(column, n)), None)
            self.mapping.unused[column] = (
                f"it is the derivative of {source!r}"
                if source
                else f"an acceleration of the joint; map a{self.number} if it is an accelerometer"
            )

    def _is_derivative(self, column: str, source: str) -> bool:
        """Whether a column is the derivative of a velocity, or the second one of an angle."""
        values, time = self._values(source), self.record.time
        is_angle = self.parsed_names[source].quantity == "angle"
        rate = np.gradient(values, time) if is_angle else values
        return relation_of(self._values(column), rate, time)[0] > MIN_RELATED_CORRELATION

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
        """Map the reference of the velocity; without any input, that of a position servo."""
        has_input = any(self._columns_of(q) for q in ("torque", "voltage", "current"))
        angle_scale = self.mapping.guesses[f"theta_m{self.number}"].scale
        for column in self._by_relation("reference", angle):
            if f"ref{self.number}" in self.mapping.guesses:
                self.mapping.unused[column] = f"another reference of joint {self.number}"
                continue
            each = self.parsed_names[column]
            velocity_r, ratio = self._relation(column, angle)
            angle_r, angle_ratio = self._proportion(column, angle)
            is_velocity = velocity_r > MIN_RELATED_CORRELATION
            if angle_r > max(velocity_r, MIN_RELATED_CORRELATION):
                ratio, is_velocity = angle_ratio, False
                if has_input:
                    self.mapping.unused[column] = (
                        f"a reference of {angle!r}; only velocity references are used"
                    )
                    continue
                reason = f"{_evidence(each)}; the angle that a position servo tracks"
            else:
                reason = f"{_evidence(each)}; {angle!r} is its integral (r = {velocity_r:.2f})"
            scale, todo = each.scale_or(1.0), each.todo
            if each.unit is None and max(velocity_r, angle_r) > MIN_RELATED_CORRELATION:
                # a servo follows within some per cent, so that the unit is that of the angle
                scale = None if angle_scale is None else nearest_unit(abs(ratio) * angle_scale)
                todo = "" if scale else f"the scale of theta_m{self.number}"
            elif each.unit is None and is_register(self._values(column)):
                scale, todo = None, f"whole numbers: {_COUNTS_SCALE}"
            sure: Sure = "sure" if is_velocity else "likely" if angle_r > 0.9 else "unsure"
            self._add("ref", column, reason, sure, scale=scale, todo=todo)

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
            measured = ratio * scale / motor_scale
            turns = max(1.0, round(1.0 / measured))
            tolerance = max(_MIN_RATIO_ERROR, 3.0 * slope_error(of_motor, of_link))
            is_whole = abs(turns * measured - 1.0) < tolerance
            self.facts.gear_ratio = (
                1.0 / turns if is_whole else measured,
                f"{link!r} over {motor!r}: {measured:.5g}"
                + ("" if is_whole else f", which is not 1/{turns:.0f} within {tolerance:.1g}"),
            )

    def _input(self) -> None:
        """Map the input of the drive, and the torque that a sensor measures behind the gear."""
        torques = sorted(self._columns_of("torque"), key=self._distance_from_drive)
        voltages, currents = self._columns_of("voltage"), self._columns_of("current")
        sensors = [name for name in torques if self.parsed_names[name].side == "link"]
        if sensors and (len(sensors) < len(torques) or voltages or currents):
            self._torque_sensor(sensors.pop(0))
            torques = [n for n in torques if self.parsed_names[n].side != "link"] + sensors
        for column in sorted(torques + currents + voltages, key=self._input_rank):
            quantity = self.parsed_names[column].quantity or "voltage"
            other = self._mapped_input()
            if other is not None:
                reason = f"a {quantity} according to its name; {other!r} is used. If both act: "
                self.mapping.unused[column] = reason + "see `add` in docs/study.md"
                continue
            is_command = quantity == "current" and self._role(column) == "desired"
            channel = "u" if quantity == "voltage" or is_command else "torque"
            self._add_input(column, quantity, channel)
        if self._mapped_input() is None:
            channel, description = (
                ("torque", "the torque [N m at the joint]; for a voltage, map u instead")
                if self.facts.joint_side
                else ("u", "the drive voltage [V]; for a torque, map torque instead")
            )
            self.mapping.missing[f"{channel}{self.number}"] = description

    def _input_rank(self, column: str) -> int:
        """Order of inputs: channel names, then measured torques and currents, then commands."""
        each = self.parsed_names[column]
        if column in (f"torque{self.number}", f"u{self.number}"):
            return 0
        ranks = (("torque", False), ("current", False), ("torque", True), ("voltage", False))
        key = each.quantity or "", each.role == "desired" and each.quantity != "voltage"
        return 1 + (ranks.index(key) if key in ranks else len(ranks))

    def _distance_from_drive(self, torque: str) -> tuple[bool, bool, bool]:
        """Order of torques: of the angle's topic, of the motor, then without unknown words."""
        each = self.parsed_names[torque]
        topic = torque.partition(".")[0] if torque.startswith("/") else ""
        is_elsewhere = not (topic and (self.angle or "").startswith(f"{topic}."))
        return is_elsewhere, each.side != "motor", bool(each.rest)

    def _torque_sensor(self, column: str) -> None:
        each = self.parsed_names[column]
        reason = f"{_evidence(each)}, of the link" + ("" if each.unit else "; assumed unit N m")
        scale, todo = each.scale_or(1.0), each.todo
        sure: Sure = "likely" if each.sure else "unsure"
        self._add("tau_l", column, reason, sure, scale=scale, todo=todo)
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
        each, values = self.parsed_names[column], self._values(column)
        reason = _evidence(each)
        side = "joint" if self.facts.joint_side else "motor"
        scale, todo = each.scale_or(1.0), each.todo
        bit = sign_bit(values)
        if each.unit is None and quantity == "current":
            scale, todo = None, "torque constant [N m/A] at the motor; times 1e-3 for mA"
        elif each.unit is None and each.word in ("pwm", "duty", "duty_cycle"):
            scale, todo = None, "volts at full duty"
        elif each.unit is None and column != f"{channel}{self.number}":
            doubt = self._doubt_of_input(column)
            if doubt:
                scale, todo = None, f"{doubt}; {'volts' if channel == 'u' else 'N m'} per unit"
        if bit is not None:
            scale, todo = None, f"bit {bit} of the register is the sign: decode it; then {todo}"
        if quantity == "current" and channel == "u":
            scale = UNITS["current"].get(each.unit or "a")
            todo = "torque_per_volt is the torque constant [N m/A]" if scale else todo
        input_levels = levels(values)
        if input_levels is not None and len(input_levels) > 1:
            reason += f"; it has {len(input_levels)} levels"
        limit = flat_top(values)
        if input_levels is None and limit is not None:
            reason += f"; it repeatedly stays at {limit:.4g}: the limit of the drive?"
        if each.unit is None and scale is not None and quantity != "current":
            reason += f"; assumed unit {'V' if quantity == 'voltage' else f'N m at the {side}'}"
        if each.role == "desired":
            reason += "; commanded, not measured"
            self.facts.command = "A" if quantity == "current" else "V"
        elif channel == "torque" and quantity == "torque" and each.side is None:
            reason += '; if a sensor behind the gear measures it, add meaning = "sensor"'
        self.facts.voltage = channel == "u"
        self._add(
            channel, column, reason, "likely" if each.sure else "unsure", scale=scale, todo=todo
        )

    def _doubt_of_input(self, column: str) -> str:
        """Why a torque or a voltage without a unit cannot be in SI units; empty if it can."""
        values = self._values(column)
        if is_register(values):
            return "whole numbers, as of a register"
        if not self.parsed_names[column].word:
            return "an input by its data alone"
        if np.abs(values).max() > _MAX_LIMIT_RATIO * self.effort_limit:
            return (
                f"up to {np.abs(values).max():.4g}, and the URDF allows {self.effort_limit:.4g} N m"
            )
        if self.parsed_names[column].quantity != "torque" or self.angle is None:
            return ""
        return self._doubt_of_torque(values)

    def _doubt_of_torque(self, values: FloatArray) -> str:
        """Why a torque cannot be in N m, from the acceleration of the angle; empty if it can."""
        if not self.scaled_angle().any():
            return "the unit of the angle is open, so that its size proves nothing"
        velocity = np.gradient(self.scaled_angle(), self.record.time)
        width = max(1, round(0.02 / self.record.period))
        acceleration = (velocity[width:] - velocity[:-width]) / (width * self.record.period)
        spread = float(np.std(acceleration))
        inertia = float(np.std(values)) / spread if spread > 0.0 else 0.0
        if inertia and not _INERTIAS[0] < inertia < _INERTIAS[1]:
            return f"an inertia of {inertia:.1g} kg m^2 would follow"
        return ""

    def _sensors(self, motor: str | None) -> None:
        """Map of each kind of sensor the axis that correlates best with the motor's motion."""
        for quantity, channel in _SENSORS.items():
            columns = [n for n in self._columns_of(quantity) if np.ptp(self._values(n)) > 0.0]
            columns = [n for n in columns if not self._is_joint_acceleration(n, motor)]
            if self.has_spatial_links and self._imu(quantity, columns):
                continue
            correlations = {n: self._motion_correlation(n, quantity, motor) for n in columns}
            column = max(columns, key=lambda name: abs(correlations[name]), default=None)
            if column is None:
                continue
            each, r = self.parsed_names[column], correlations[column]
            scale, reason = each.scale_or(1.0), ""
            todo = each.todo
            n_columns = len(self._columns_of(quantity))
            if n_columns > 1:
                reason += f"; of {n_columns} columns the one that correlates with the motor"
                reason += f" (r = {r:.2f})"
            if r < _MAX_REVERSED_CORRELATION and scale is not None:
                scale, reason = -scale, f"{reason}; it points the other way, so the sign is turned"
            if each.unit is None:
                reason += f"; assumed unit {_SENSOR_UNITS[quantity]}"
            if not each.placed:
                reason += "; no joint in its name: the last joint is assumed"
            sure: Sure = "likely" if each.sure and each.placed else "unsure"
            self._add(channel, column, _evidence(each) + reason, sure, scale=scale, todo=todo)
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
            scale, todo = each.scale_or(1.0), each.todo
            self._add(f"{quantity[0]}{axis}", name, reason, sure, scale=scale, todo=todo)
        self.facts.link_sensors.add("imu")
        return True

    def _is_joint_acceleration(self, column: str, motor: str | None) -> bool:
        """Whether a column without a word of a sensor is the joint's acceleration in SI units."""
        each = self.parsed_names[column]
        guess = self.mapping.guesses.get(f"theta_m{self.number}")
        is_sensor = each.side == "link" or _AXIS.search(column) is not None or len(each.word) > 12
        if each.quantity != "acceleration" or is_sensor or motor is None or guess is None:
            return False
        if guess.scale is None or not self._is_derivative(column, motor):
            return False
        velocity = np.gradient(guess.scale * self._values(motor), self.record.time)
        scale = each.scale_or(1.0) or 1.0
        ratio = relation_of(scale * self._values(column), velocity, self.record.time)[1]
        if self.facts.prismatic or abs(ratio - 1.0) > _MAX_DERIVATIVE_ERROR:
            return False
        self.mapping.unused[column] = f"it is the derivative of the velocity of {motor!r}"
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
