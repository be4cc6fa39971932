"""Map the angles of one joint, and the columns that are their derivatives, integrals or copies.

Guessed channels and joint properties, each with its reason.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from math import log2, pi
from pathlib import Path
from typing import Literal, NamedTuple

import numpy as np

from strainwave.domain import FloatArray
from strainwave.init.inspection import InspectedLog
from strainwave.init.names import LINEAR, ParsedName, Quantity, find_unit, words_of
from strainwave.init.signal_features import (
    MAX_UNIT_RATIO_ERROR,
    is_register,
    nearest_unit,
    quantum,
    relation,
    sign_bit,
    slope_error,
    unit_pair,
    usual_counts,
    wrap_modulus,
)

Sure = Literal["sure", "likely", "unsure"]

MIN_RELATED_CORRELATION = 0.9
"""Minimum correlation at which two columns count as related."""
MIN_TRACKING_CORRELATION = 0.5
"""Minimum correlation of a commanded angle and the angle; chirps beyond the bandwidth have 0.6."""
MIN_RANGE_SHARE = 0.1
"""Share of its largest range above which a joint moves in a record."""


@dataclass(frozen=True, slots=True)
class Guess:
    """Guessed source column of one channel."""

    channel: str
    column: str
    reason: str
    sure: Sure
    scale: float | None = 1.0  # factor to SI units; None: the user must fill it in
    meaning: str = ""  # of a torque: "sensor" behind the gear
    todo: str = ""  # description of the value that the user must fill in, here or in [[joint]]


@dataclass(slots=True)
class JointFacts:
    """Properties of one joint derived from the columns, or from a URDF."""

    name: str = ""  # in the URDF
    joint_side: str = ""  # why its signals are measured behind the gear; empty if they are not
    position_servo: bool = False  # whether the log has its commanded angle, and no input
    prismatic: bool = False
    gear_ratio: tuple[float, str] | None = None  # with its reason
    encoder_counts: tuple[int | None, str] | None = None  # None: the step matches no common encoder
    voltage: bool = False  # whether the drive's input is a voltage
    command: str = ""  # unit of the input if it is a command of the drive: V or A
    link_sensors: set[str] = field(default_factory=set)


@dataclass(slots=True)
class Mapping:
    """Channels of a study, and the columns without a channel."""

    guesses: dict[str, Guess] = field(default_factory=dict)
    joints: list[JointFacts] = field(default_factory=list)
    urdf: Path | None = None  # file that places the joints
    held: tuple[str, ...] = ()  # joints of the file that stay at zero
    unused: dict[str, str] = field(default_factory=dict)  # column -> reason
    missing: dict[str, str] = field(default_factory=dict)  # channel -> description
    limit: str = ""  # why the arm exceeds the supported models
    notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()  # notes that the user needs before completing the study

    @property
    def columns(self) -> set[str]:
        """Columns that have a channel."""
        return {guess.column for guess in self.guesses.values()}

    @property
    def position_servos(self) -> bool:
        """Whether the logs have the commanded angles of all joints, and no input of a drive."""
        return bool(self.joints) and all(facts.position_servo for facts in self.joints)

    @property
    def shows_elasticity(self) -> bool:
        """Whether a sensor on a link shows the elasticity of a gear."""
        return any(facts.link_sensors and not facts.joint_side for facts in self.joints)


DEGREE = pi / 180.0
_JOINT_STATE = re.compile(r"(?P<topic>/[^.]*)\.position(?P<joint>\[.*[^\d\]].*\])")
_MIN_DETERMINED_CORRELATION = 0.98  # of two angles of one joint, if one determines the other
_MAX_ASSUMED_ANGLE = 500.0  # [rad] largest angle that is assumed to be in rad
_COUNTS_SCALE = "2 pi / counts per motor turn [rad]"
_MIN_RATIO_ERROR = 1e-4  # relative; a log of few digits states a ratio no better
_REGISTER, _SHORT_REGISTER = 4096, 1024  # counts of Dynamixel and Feetech; short ones: no turn
_SERVO_COUNTS = frozenset(2**bits for bits in range(10, 17))  # of servos, per turn
_COUNTS_TOLERANCE = 2e-3  # relative, for rounding in the log
_MAX_SERVO_ANGLE = 7.0  # [rad] of a joint, just above a turn
ON_LINK: tuple[Quantity, ...] = ("acceleration", "gyro", "deflection")
"""Quantities of sensors on a link."""
_TICKS = find_unit("ticks", "angle")
_TURNS = {2.0 * pi: 1.0, 360.0: DEGREE, 1.0: 2.0 * pi}  # jump of a wrapped angle -> SI factor


class _AngleUnit(NamedTuple):
    scale: float | None  # SI factor; None: see `todo`
    reason: str
    todo: str = ""  # what the user must enter as the scale


@dataclass
class JointColumns:
    """Mapping of one joint's columns in progress."""

    record: InspectedLog
    parsed_names: dict[str, ParsedName]
    number: int
    mapping: Mapping
    has_spatial_links: bool
    exceeded: str = ""  # URDF with limits that the angles of the arm exceed
    effort_limit: float = np.inf  # [N m] of the URDF
    degrees: str = ""  # why angles without a unit are in degrees
    facts: JointFacts = field(default_factory=JointFacts)
    angle: str | None = None  # column of the motor angle
    link_angle: str | None = None

    def __post_init__(self) -> None:
        self.mapping.joints.append(self.facts)
        self._choose_angles()
        match = _JOINT_STATE.fullmatch(self.angle or "")
        if match and f"{match['topic']}.effort{match['joint']}" in self.parsed_names:
            reason = f"{match['topic']} has positions and efforts of the joints"
            self.facts.joint_side = reason
        if self._has_position_servo():
            self.facts.position_servo = True
            self.facts.joint_side = "a position servo measures the angle that it controls"

    def _has_position_servo(self) -> bool:
        """Whether an angle follows a commanded angle, without any sensor on a link."""
        if self.angle is None or self.link_angle is not None or self.parsed_names[self.angle].side:
            return False
        if any(map(self.columns_of, ("torque", "voltage", "current", *ON_LINK))):
            return False
        return any(self.is_commanded_angle(name) for name in self.columns_of("reference"))

    def is_commanded_angle(self, column: str) -> bool:
        """Whether the angle follows a reference itself, rather than its integral."""
        if self.angle is None:
            return False
        r, r_integral = (
            abs(f(column, self.angle)[0]) for f in (self.record.proportion, self.record.relation)
        )
        return r > max(r_integral, MIN_TRACKING_CORRELATION)

    def columns_of(self, quantity: str) -> list[str]:
        """The columns of a quantity."""
        return [name for name, each in self.parsed_names.items() if each.quantity == quantity]

    def values(self, column: str) -> FloatArray:
        """The samples of a column."""
        return self.record.columns[column]

    def evidence(self, column: str) -> str:
        """The quantity of a column, and what determined it."""
        each = self.parsed_names[column]
        source = "name" if each.word else "unit" if each.unit else "data"
        return f"{each.quantity} according to its {source}"

    def add(
        self,
        channel: str,
        column: str,
        *reasons: str,
        unit: tuple[float | None, str] | None = None,
        assumed: str = "",
        sure: Sure | None = None,
    ) -> None:
        """Map a column to a channel of this joint.

        `unit` is the scale and what the user must enter for it, by default those of the name;
        `assumed` is the unit of a column whose name has none.
        """
        each, key = self.parsed_names[column], f"{channel}{self.number}"
        scale, todo = unit or (each.scale_or(1.0), each.todo)
        texts = [text for text in reasons if text]
        texts += [f"assumed unit {assumed}"] if assumed and each.unit is None else []
        texts += [] if each.placed else ["no joint in its name: the last joint is assumed"]
        sure = sure or ("likely" if each.sure and each.placed else "unsure")
        if column == key and scale == 1.0:
            texts, sure = ["a channel name, in SI units"], "sure"
        is_sensor = channel == "torque" and each.side == "link"
        self.mapping.guesses[key] = Guess(
            key, column, "; ".join(texts), sure, scale, "sensor" if is_sensor else "", todo
        )

    @property
    def sided_by_guess(self) -> str:
        """Column of a joint-side torque that the motor or a sensor may measure; empty if none."""
        guess = self.mapping.guesses.get(f"torque{self.number}")
        if guess is None or not self.facts.joint_side or guess.column == guess.channel:
            return ""
        each = self.parsed_names[guess.column]
        is_open = each.quantity == "torque" and each.role != "desired" and each.side is None
        return guess.column if is_open else ""

    def map_motion(self) -> None:
        """Map the angles, and the columns that their relation to the motor angle determines."""
        motor, velocities = self.angle, self.columns_of("velocity")
        if motor is not None:
            self._angle(motor)
            self._velocity(motor)
            self._encoder(motor)
            self._reference(motor)
            self._second_derivatives(motor)
            if self.link_angle is not None and self.facts.joint_side:
                self.mapping.unused[self.link_angle] = f"another angle of joint {self.number}"
            elif self.link_angle is not None:
                self._link(motor, self.link_angle)
        elif velocities:
            column = min(velocities, key=lambda name: self.parsed_names[name].role != "actual")
            is_open = self.parsed_names[column].unit is None and is_register(self.values(column))
            unit = (None, "2 pi / counts per turn [rad/s per unit]") if is_open else None
            reasons = (self.evidence(column), "there is no angle")
            assumed = "" if is_open else "rad/s"
            self.add("omega_m", column, *reasons, unit=unit, assumed=assumed, sure="likely")
        else:
            self.mapping.missing[f"theta_m{self.number}"] = "the motor angle [rad at the motor]"

    def choose_record(self, others: Sequence[InspectedLog]) -> None:
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
        if self.angle is not None and (scale := next(self._angle_units(self.angle)).scale):
            return scale * self.values(self.angle)
        return np.zeros(len(self.record.time))

    def largest_torque(self) -> float:
        """Largest known torque [N m]; zero if there is none."""
        sizes = [0.0]
        for name in self.columns_of("torque"):
            each = self.parsed_names[name]
            if each.role != "desired":
                sizes.append((each.scale_or(1.0) or 0.0) * float(np.abs(self.values(name)).max()))
        return max(sizes)

    def is_derivative(self, column: str, source: str) -> bool:
        """Whether a column is the derivative of a velocity, or the second one of an angle."""
        values, time = self.values(source), self.record.time
        is_angle = self.parsed_names[source].quantity == "angle"
        rate = np.gradient(values, time) if is_angle else values
        return relation(self.values(column), rate, time)[0] > MIN_RELATED_CORRELATION

    def _choose_angles(self) -> None:
        """Choose the columns of motor angle and link angle.

        Names decide; without a side in the name, the angle with the larger range is the motor's. A
        second angle without a side is the link's if the first one's name is of the motor and it
        determines the second. Joint states precede other topics, measured angles others, and angles
        of which a column is the velocity those without.
        """

        def order(name: str) -> tuple[bool, bool, bool, float]:
            has_velocity = any(
                self.record.relation(velocity, name)[0] > MIN_RELATED_CORRELATION
                for velocity in self.columns_of("velocity")
            )
            is_other = _JOINT_STATE.fullmatch(name) is None
            is_actual = self.parsed_names[name].role == "actual"
            return is_other, not is_actual, not has_velocity, -float(np.ptp(self.values(name)))

        names = sorted(self.columns_of("angle"), key=order)
        of_side = {
            side: [n for n in names if self.parsed_names[n].side == side]
            for side in ("motor", None, "link")
        }
        motor = next((n for side in of_side.values() for n in side), None)
        link = next((n for n in of_side["link"] if n != motor), None)
        for name in names:
            if motor is None or name in (motor, link):
                continue
            r, ratio = self.record.proportion(motor, name)
            is_open = self.parsed_names[name].side is None
            is_determined = abs(r) > _MIN_DETERMINED_CORRELATION
            if is_determined and is_open and link is None and of_side["motor"]:
                link = name
                continue
            reason = f"another angle of joint {self.number}"
            if is_open and self.parsed_names[motor].side is None:
                reason += (
                    f" (r = {r:.2f}, {ratio:.4g} times {motor!r}); if one is the motor's"
                    " and the other the link's, or they are two joints, name them so"
                )
                self.mapping.warnings += (f"{name!r} is not used: it is {reason}",)
            self.mapping.unused[name] = reason
        self.angle, self.link_angle = motor, link

    def _angle(self, column: str) -> None:
        each, unit, side = self.parsed_names[column], next(self._angle_units(column)), ""
        if not self.facts.name:
            others = [*self.columns_of("torque"), *self.columns_of("velocity")]
            units = {self.parsed_names[name].unit for name in (column, *others)}
            self.facts.prismatic = not units.isdisjoint(LINEAR)
        if self.facts.joint_side:
            side = "of the joint"
        elif each.side == "link":
            reason = "an angle of the link; there is no motor angle"
            unit = _AngleUnit(None, reason, "1/gear_ratio: motor turns per link turn")
        elif self.exceeded:
            side = f"angles exceed the limits of {self.exceeded}: those of motors"
        elif each.side is None and not self.facts.prismatic:
            side = "assumed to be the motor angle: if it is the link angle, divide the scale by"
            side += " gear_ratio"
        modulus = wrap_modulus(self.values(column))
        wrap = "" if modulus is None else f"it jumps by one turn of {modulus:.4g}"
        reasons = (self.evidence(column), unit.reason, side, wrap)
        self.add("theta_m", column, *reasons, unit=(unit.scale, unit.todo))

    def _angle_units(self, column: str) -> Iterator[_AngleUnit]:
        """Yield units of an angle: by name, turn, velocity, limits of the URDF, and size."""
        each, values = self.parsed_names[column], self.values(column)
        bit = sign_bit(values, wraps=True)
        if bit is not None:
            todo = f"bit {bit} of the register is the sign: decode the column; then {_COUNTS_SCALE}"
            yield _AngleUnit(None, "a register read as unsigned", todo)
        yield from self._servo_units(column)
        if each.measure is not None:
            reason = f"unit {each.unit} according to its name"
            yield _AngleUnit(each.measure.scale, reason, each.todo)
        if is_register(values):
            yield _AngleUnit(None, "whole numbers: counts?", _COUNTS_SCALE)
        modulus = wrap_modulus(values)
        if modulus is not None:
            for turn, scale in _TURNS.items():
                if abs(modulus / turn - 1.0) < MAX_UNIT_RATIO_ERROR:
                    yield _AngleUnit(scale, f"it wraps at one turn of {turn:.4g}")
            yield _AngleUnit(None, "its turn is of no usual unit", f"2 pi / {modulus:.6g}?")
        for velocity in self.columns_of("velocity"):
            rate, (r, ratio) = self.parsed_names[velocity], self.record.relation(velocity, column)
            if r <= MIN_RELATED_CORRELATION:
                continue
            if known := rate.scale_or(None):
                reason = f"unit from {velocity!r}, of which it is the integral"
                yield _AngleUnit(nearest_unit(known / ratio), reason)
            if pair := unit_pair(ratio):
                yield _AngleUnit(pair[0], f"with {velocity!r}: {pair[1]}")
        if self.degrees:
            yield _AngleUnit(DEGREE, self.degrees)
        largest = np.abs(values).max()
        is_doubtful = largest > _MAX_ASSUMED_ANGLE and column != f"theta_m{self.number}"
        if is_doubtful or not each.word:
            todo = f"1 for rad, pi/180 for degrees, {_COUNTS_SCALE}"
            yield _AngleUnit(None, f"no unit in its name, and values up to {largest:.4g}", todo)
        assumed = "m" if self.facts.prismatic else "rad"
        yield _AngleUnit(1.0, f"assumed unit {assumed}: the log does not state a unit")

    def _servo_units(self, column: str) -> Iterator[_AngleUnit]:
        """Yield units of a position servo's angle that its steps and its size show."""
        values, measure = self.values(column), self.parsed_names[column].measure
        if not self.facts.position_servo or measure not in (None, _TICKS):
            return
        step, largest = quantum(values), float(np.abs(values).max())
        if is_register(values):
            if measure and values.min() >= 0.0 and _SHORT_REGISTER <= largest < _REGISTER:
                reason = f"whole numbers up to {largest:g}: {_REGISTER} per turn; for gravity, add"
                reason += " here and to ref the offset: -scale times the count of a link along +x"
                yield _AngleUnit(2.0 * pi / _REGISTER, reason)
            yield _AngleUnit(None, "whole numbers: counts?", _COUNTS_SCALE)
        for turn, scale in _TURNS.items():
            counts = turn / step if step else 1.0
            power = 2 ** round(log2(counts))
            if power in _SERVO_COUNTS and abs(counts / power - 1.0) < _COUNTS_TOLERANCE:
                yield _AngleUnit(scale, f"steps of {step:.5g}, {power} per turn of {turn:.4g}")
        if any(words_of(name)[:2] == ("command", "position") for name in self.parsed_names):
            yield _AngleUnit(None, "no unit", "2 pi for turns, as moteus logs them; 1 for rad")
        if largest > _MAX_SERVO_ANGLE:
            todo = "pi/180 for degrees; of a normalised range (LeRobot's -100 to 100), the angle"
            todo += " [rad] that the joint's calibrated range spans over 200"
            if step:
                todo += f"; {2.0 * pi / _REGISTER / step:.6g} if an encoder of 4096 counts made it"
            yield _AngleUnit(None, f"no unit in its name, and values up to {largest:.4g}", todo)

    def _by_relation(self, quantity: str, angle: str) -> list[str]:
        """Columns of a quantity; first the one that is most like the derivative of the angle."""
        return sorted(self.columns_of(quantity), key=lambda n: -self.record.relation(n, angle)[0])

    def _velocity(self, angle: str) -> None:
        key, unused = f"theta_m{self.number}", self.mapping.unused
        angle_scale = self.mapping.guesses[key].scale
        for column in self._by_relation("velocity", angle):
            each, (r, ratio) = self.parsed_names[column], self.record.relation(column, angle)
            if f"omega_m{self.number}" in self.mapping.guesses:
                unused[column] = f"another velocity of joint {self.number}"
            elif r <= MIN_RELATED_CORRELATION:
                reason = f"a velocity according to its name, but not of {angle!r} (r = {r:.2f})"
                unused[column] = reason
            elif angle_scale is not None:
                self._scaled_velocity(column, angle, ratio * angle_scale, r)
            elif self.parsed_names[angle].side == "link":
                unused[column] = "a velocity of the link"
            else:
                scale = each.scale_or(None)
                todo = each.todo or ("" if scale else f"{ratio:.6g} times the scale of {key}")
                reason = f"its integral is {angle!r}, whose unit is open"
                sure: Sure = "unsure" if scale is None else "likely"
                self.add("omega_m", column, reason, unit=(scale, todo), sure=sure)

    def _scaled_velocity(self, column: str, angle: str, scale: float, r: float) -> None:
        """Map a velocity whose scale is that of its angle, unless they are on two sides."""
        each, nearest = self.parsed_names[column], nearest_unit(scale)
        if abs(scale / nearest - 1.0) > 2.0 * MAX_UNIT_RATIO_ERROR:
            self.mapping.unused[column] = (
                f"a velocity, but {angle!r} changes {scale:.4g} times as fast: is one of them"
                " measured at the link?"
            )
            if 5.0 < scale < 1000.0:
                self.facts.gear_ratio = (1.0 / round(scale), f"{angle!r} over {column!r}")
            return
        stated, todo = each.scale_or(nearest) or nearest, ""
        sure: Sure = "sure" if each.unit else "likely"
        if abs(stated / nearest - 1.0) > 2.0 * MAX_UNIT_RATIO_ERROR:
            todo = f"{stated:.6g} according to its name, {nearest:.6g} according to {angle!r}"
            sure = "unsure"
        reason = f"its integral is {angle!r} (r = {r:.3f})"
        self.add("omega_m", column, reason, unit=(None if todo else nearest, todo), sure=sure)

    def _second_derivatives(self, angle: str) -> None:
        """Set accelerations of the joint aside: they are neither angles nor sensors of a link."""
        for column in self.columns_of("second_derivative"):
            sources = [*self.columns_of("velocity"), angle]
            source = next((n for n in sources if self.is_derivative(column, n)), None)
            self.mapping.unused[column] = (
                f"it is the derivative of {source!r}"
                if source
                else f"an acceleration of the joint; map a{self.number} if it is an accelerometer"
            )

    def _encoder(self, angle: str) -> None:
        scale, step = self.mapping.guesses[f"theta_m{self.number}"].scale, None
        # drivers of robots round angles to decimals, not to counts
        if self.facts.position_servo or not self.facts.joint_side:
            step = quantum(self.values(angle))
        if scale is None or step is None or self.facts.prismatic:
            return
        counts = 2.0 * pi / (step * scale)
        if 16.0 < counts < 5e6:
            reason = f"{angle!r} changes in steps of {step * scale:.6g} rad, {counts:.6g} per turn"
            common_counts = usual_counts(counts)
            if common_counts is not None and round(counts) != common_counts:
                reason += f"; {common_counts} is the nearest common encoder resolution"
            self.facts.encoder_counts = (common_counts, reason)

    def _reference(self, angle: str) -> None:
        """Map the reference of the velocity; without any input, that of a position servo."""
        has_input = any(self.columns_of(q) for q in ("torque", "voltage", "current"))
        angle_scale = self.mapping.guesses[f"theta_m{self.number}"].scale
        for column in self._by_relation("reference", angle):
            r, ratio = self.record.relation(column, angle)
            angle_r, angle_ratio = self.record.proportion(column, angle)
            is_angle = angle_r > max(r, MIN_RELATED_CORRELATION)
            is_angle |= self.facts.position_servo and self.is_commanded_angle(column)
            if f"ref{self.number}" in self.mapping.guesses:
                self.mapping.unused[column] = f"another reference of joint {self.number}"
                continue
            if is_angle and has_input:
                reason = f"a reference of {angle!r}; only velocity references are used"
                self.mapping.unused[column] = reason
                continue
            reason = f"{angle!r} is its integral (r = {r:.2f})"
            sure: Sure = "sure" if r > MIN_RELATED_CORRELATION else "unsure"
            if is_angle:
                reason, sure = "the angle that a position servo tracks", "likely"
            unit: tuple[float | None, str] | None = None
            if self.parsed_names[column].unit is None and sure != "unsure":
                # a servo follows within some per cent, so that the unit is that of the angle
                unit = (None, f"the scale of theta_m{self.number}")
                if angle_scale is not None and is_angle and self.facts.position_servo:
                    expected = abs(angle_ratio) * angle_scale  # within a factor of 2, units of 6
                    units = (angle_scale, *_TURNS.values(), 2.0 * pi / _REGISTER)
                    unit = min(units, key=lambda scale: abs(log2(scale / expected))), ""
                elif angle_scale is not None:
                    unit = nearest_unit(abs(angle_ratio if is_angle else ratio) * angle_scale), ""
            elif self.parsed_names[column].unit is None and is_register(self.values(column)):
                unit = None, f"whole numbers: {_COUNTS_SCALE}"
            self.add("ref", column, self.evidence(column), reason, unit=unit, sure=sure)

    def _link(self, motor: str, link: str) -> None:
        """Map the link angle and derive the gear ratio: link turns per motor turn."""
        r, ratio = self.record.proportion(motor, link)
        unit, is_related = next(self._angle_units(link)), r > MIN_RELATED_CORRELATION
        reasons = (f"{self.evidence(link)}; it correlates with {motor!r} (r = {r:.3f})",)
        sure: Sure = "likely" if is_related else "unsure"
        self.add("theta_l", link, *reasons, unit.reason, unit=(unit.scale, unit.todo), sure=sure)
        self.facts.link_sensors.add("theta_l")
        motor_scale = self.mapping.guesses[f"theta_m{self.number}"].scale
        measured = ratio * unit.scale / motor_scale if motor_scale and unit.scale else 0.0
        if is_related and 0.0 < measured <= 1.05:
            turns = max(1.0, round(1.0 / measured))
            error = slope_error(self.values(motor), self.values(link))
            tolerance = max(_MIN_RATIO_ERROR, 3.0 * error)
            value, reason = 1.0 / turns, f"{link!r} over {motor!r}: {measured:.5g}"
            if abs(turns * measured - 1.0) >= tolerance:
                value = measured
                reason += f", which is not 1/{turns:.0f} within {tolerance:.1g}"
            self.facts.gear_ratio = (value, reason)
