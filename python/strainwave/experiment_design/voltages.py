"""Voltages that make one joint's gear ring: a PRBS, or a multisine of the same band."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from strainwave.domain import Control, Experiment, FloatArray, Prbs
from strainwave.domain.parameters import Values
from strainwave.dynamics import excitation
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, Quantity, SensorNoise, Trajectory
from strainwave.errors import InvalidInput
from strainwave.experiment_design.band import Band
from strainwave.experiment_design.plan import (
    FREE,
    HELD,
    LimitBroken,
    Limits,
    Planned,
    PredictedMotion,
    clock_of,
)
from strainwave.experiment_design.predicted_motion import predicted_motion, run

Kind = Literal["prbs", "multisine"]

_HALF_POWER = 0.44  # of a PRBS's clock rate: its spectrum has half its power there
_LEAD = 1  # periods that bring the arm from standstill to its periodic motion
_LEAST_PERIODS, _MOST_PERIODS = 4, 30  # four separate noise from distortion
_WANTED = 0.03  # noise over signal on the weakest lines, after averaging
_SMALLEST = 0.02  # of the drive's voltage: less is no experiment
_BISECTIONS = 7
_AROUND = (0.5, 1.6)  # of anti-resonance and resonance, where the noise must be low
_SMOOTH = 5  # lines over which a signal's size is taken
_STANDING = 0.98  # of a record
_SWEEP = (0.2, 0.4, 0.6, 0.8)  # of the full amplitude
_SATURATED = 0.995  # of the limit: a servo that reaches it no longer acts


@dataclass(frozen=True, slots=True)
class Signal:
    """One joint's excitation with amplitude left open."""

    arm: Arm
    values: Values
    joint: int  # from 1
    kind: Kind
    clock: float  # [s]
    order: int  # of a PRBS
    ticks: int  # of a period
    lines: FloatArray  # harmonics of a multisine
    shape: FloatArray  # (ticks,) one period, of peak one

    @property
    def period(self) -> float:
        """[s] of the excitation."""
        return self.clock * self.ticks

    def voltage(self, amplitude: float, periods: int) -> FloatArray:
        """The excitation, one value a clock."""
        return amplitude * np.tile(self.shape, periods)

    def drive(self, amplitude: float, periods: int, control: tuple[Control, ...]) -> Drive:
        """The excitation of this joint; servos hold what they control at zero velocity."""
        excited = self.voltage(amplitude, periods)
        voltage = np.zeros((len(excited), self.arm.n_joints))
        voltage[:, self.joint - 1] = excited
        start = (0.0,) * self.arm.n_joints
        return Drive(
            tick=self.clock,
            voltage=voltage,
            reference=np.zeros_like(voltage),
            servo=tuple(c == "servo" for c in control),
            motor_angle=start,
            initial_voltage=self.arm.holding_voltage(self.values, start),
        )


def voltage_record(
    arm: Arm,
    values: Values,
    limits: Limits,
    band: Band,
    joint: int,
    *,
    kind: Kind,
    seed: int,
) -> Planned:
    """One joint's excitation, as large as the limits let it be and as long as the noise asks.

    Joints are free, or all under their servos where that lets more torque through the gear:
    free joints drift. Under gravity only servos hold the arm.

    `values`: (name, joint) -> value of the guessed arm. `band`: Of this joint. `joint`: From 1.
    `seed`: Of a multisine's phases. Raises `InvalidInput`: A multisine would have to be held by a
    servo. Raises `LimitBroken`: No amplitude keeps to the limits.
    """
    signal = _signal(arm, values, band, joint, kind, seed)
    free: tuple[Control, ...] = (FREE,) * arm.n_joints
    held: tuple[Control, ...] = (HELD,) * arm.n_joints
    controls: tuple[tuple[Control, ...], ...] = (
        (held,)
        if arm.gravity
        else (free,)
        if kind == "multisine" or arm.servo is None
        else (free, held)
    )
    if kind == "multisine" and arm.gravity:
        raise InvalidInput(
            "under gravity a servo holds the arm, and a study cannot describe a multisine there",
            where="--kind",
            remedy="use --kind prbs",
        )
    periods, reason = _LEAD + _LEAST_PERIODS, ""
    for _ in range(2):  # more periods, and a free joint drifts further
        found = [_largest(signal, periods, limits, control) for control in controls]
        feasible = [(a, c, seen) for (a, seen), c in zip(found, controls, strict=True) if seen]
        if not feasible:
            raise _too_strong(signal, periods, limits, controls[0])
        amplitude, control, seen = max(feasible, key=lambda f: f[2].gear_torque[joint - 1])
        needed, reason = _periods(signal, signal.drive(amplitude, periods, control), band)
        if needed + _LEAD <= periods:
            break
        periods = needed + _LEAD
    name = f"{kind}-j{joint}"
    prbs = Prbs(signal.order, signal.clock, periods, amplitude) if kind == "prbs" else None
    return Planned(
        experiment=Experiment(name, f"{name}.csv", "frequency", control, joint=joint, prbs=prbs),
        drive=signal.drive(amplitude, periods, control),
        motor_angle=None,
        band_hz=_excited(signal),
        predicted=seen,
        reasons=(_why_so(signal, band, amplitude, control), reason),
    )


def sweep_records(
    arm: Arm,
    values: Values,
    limits: Limits,
    band: Band,
    full: Planned,
    *,
    seed: int,
) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """Weaker copies of a joint's PRBS, by which stiffness over the amplitude shows.

    `values`: (name, joint) -> value of the guessed arm. `band`: Of this joint. `full`: The record
    at full amplitude, of a PRBS. Returns: Why others are left out, a sentence each.
    """
    of = full.experiment
    if of.prbs is None or of.joint is None:
        return (), ()
    signal = _signal(arm, values, band, of.joint, "prbs", seed)
    planned, left_out = [], []
    for share in _SWEEP:
        amplitude = float(f"{share * of.prbs.amplitude:.2g}")
        drive = signal.drive(amplitude, of.prbs.periods, of.control)
        seen = predicted_motion(run(arm, values, drive, clock_of(arm)))
        if seen.use_of(limits) > 1.0 + 1e-12:  # a free arm drifts, less strongly driven or not
            left_out.append(f"at {amplitude:g} V {seen.broken(limits)}")
            continue
        if not _moves(seen, of.joint):
            left_out.append(f"at {amplitude:g} V friction holds the motor of joint {of.joint}")
            continue
        name = f"sweep-j{of.joint}-{amplitude:g}V"
        prbs = replace(of.prbs, amplitude=amplitude)
        planned.append(
            Planned(
                experiment=replace(of, name=name, file=f"{name}.csv", use="sweep", prbs=prbs),
                drive=drive,
                motor_angle=None,
                band_hz=full.band_hz,
                predicted=seen,
                reasons=(f"{of.name} at {amplitude:g} V: how stiffness changes over the torque",),
            )
        )
    return tuple(planned), tuple(left_out)


def _too_strong(
    signal: Signal, periods: int, limits: Limits, control: tuple[Control, ...]
) -> LimitBroken:
    """What about the smallest excitation that moves the joint would do."""
    top = limits.voltage[signal.joint - 1]
    least = _SMALLEST * top
    while True:
        drive = signal.drive(least, periods, control)
        seen = predicted_motion(run(signal.arm, signal.values, drive, clock_of(signal.arm)))
        if (_moves(seen, signal.joint) and seen.broken(limits)) or least >= top:
            break
        least = min(1.5 * least, top)
    would = seen.broken(limits) or "a servo would be at its limit"
    return LimitBroken(
        f"no voltage on joint {signal.joint} keeps the guessed arm within the limits: with "
        f"{least:.2g} V {would}",
        where=f"{signal.kind}-j{signal.joint}",
        remedy="give a wider limit if the arm bears it, or check the parameters",
    )


def _signal(arm: Arm, values: Values, band: Band, joint: int, kind: Kind, seed: int) -> Signal:
    """Clock and order, or the lines, of a band."""
    tick = clock_of(arm)
    slower = max(1, int(_HALF_POWER / band.high_hz / tick)) if kind == "prbs" else 1
    clock = tick * slower
    order = int(np.ceil(np.log2(band.period / clock + 1.0)))
    ticks = 2**order - 1 if kind == "prbs" else int(np.ceil(band.period / clock))
    first = max(1, int(band.low_hz * clock * ticks))
    last = min(int(np.ceil(band.high_hz * clock * ticks)), (ticks - 1) // 2)
    lines = np.arange(first, last + 1, dtype=float)
    shape = (
        excitation.prbs(Prbs(order, clock, 1, 1.0))
        if kind == "prbs"
        else excitation.multisine(
            lines,
            period=clock * ticks,
            clock=clock,
            periods=1,
            peak=1.0,
            rng=np.random.default_rng([seed, joint]),
        )
    )
    return Signal(arm, values, joint, kind, clock, order, ticks, lines, shape)


def _excited(signal: Signal) -> tuple[float, float]:
    if signal.kind == "prbs":
        return 1.0 / signal.period, _HALF_POWER / signal.clock
    return signal.lines[0] / signal.period, signal.lines[-1] / signal.period


def _largest(
    signal: Signal, periods: int, limits: Limits, control: tuple[Control, ...]
) -> tuple[float, PredictedMotion | None]:
    """The largest amplitude within the limits, rounded down, and its predicted motion."""
    top = limits.voltage[signal.joint - 1]
    sample_time = clock_of(signal.arm)

    def within(amplitude: float, count: int) -> PredictedMotion | None:
        drive = signal.drive(amplitude, count, control)
        seen = predicted_motion(run(signal.arm, signal.values, drive, sample_time))
        free = "servo" not in control
        unsaturated = free or (seen.voltage <= _SATURATED * np.array(limits.voltage)).all()
        return seen if unsaturated and seen.use_of(limits) <= 1.0 + 1e-12 else None

    def seen_at(amplitude: float) -> PredictedMotion | None:
        # what breaks a limit in the first period need not be run whole
        return within(amplitude, periods) if within(amplitude, _LEAD) else None

    whole = seen_at(top)
    if whole:
        return top, whole
    low, high = 0.0, 1.0
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if seen_at(middle * top) else (low, middle)
    # a free arm's drift is no monotone function of the amplitude, so the rounded one is tried
    amplitude = float(f"{low * top:.2g}")
    while amplitude >= _SMALLEST * top:
        seen = seen_at(amplitude)
        if seen:
            return (amplitude, seen) if _moves(seen, signal.joint) else (0.0, None)
        amplitude = float(f"{0.95 * amplitude:.2g}")
    return 0.0, None


def _moves(seen: PredictedMotion, joint: int) -> bool:
    """Whether a joint's friction is overcome now and then: else there is nothing to record."""
    return float(seen.rest_share[joint - 1]) < _STANDING


def _periods(signal: Signal, drive: Drive, band: Band) -> tuple[int, str]:
    """Periods, besides the first, that the sensors' noise asks for, and why.

    A line's amplitude has the deviation sqrt(2 S/T) in a period T of noise of density S. The
    encoder's rounding has S = 2 t q^2/12, times w^2 for the velocity.
    """
    arm = signal.arm
    tick = clock_of(arm)
    seen = run(arm, signal.values, drive, tick)
    drive_of = arm.joints[signal.joint - 1]
    ratios = {}
    if drive_of.encoder_counts:
        q = 2.0 * np.pi / drive_of.encoder_counts
        lines, size = _lines(signal, seen, "motor_velocity", tick, band)
        density = 2.0 * tick * q * q / 12.0 * (2.0 * np.pi * lines) ** 2
        ratios["encoder's rounding"] = np.sqrt(2.0 * density / signal.period) / size
    if drive_of.accelerometer_distance:
        lines, size = _lines(signal, seen, "accelerometer", tick, band)
        density = np.full_like(lines, SensorNoise().accelerometer_density ** 2)
        ratios["accelerometer's noise"] = np.sqrt(2.0 * density / signal.period) / size
    always = f"{_LEAD} period to settle and {_LEAST_PERIODS} that separate noise from distortion"
    if not ratios:
        return _LEAST_PERIODS, f"{always}; the sensors' noise is not known"
    sensor, worst = max(
        ((sensor, float(ratio.max())) for sensor, ratio in ratios.items()), key=lambda r: r[1]
    )
    needed = int(np.ceil((worst / _WANTED) ** 2))
    periods = min(max(needed, _LEAST_PERIODS), _MOST_PERIODS)
    left = f"{100.0 * worst / periods**0.5:.2g} % on the weakest line near the resonances"
    if needed <= _LEAST_PERIODS:
        return periods, f"{always}; the {sensor} is then {left}"
    many = f"{periods}" if needed == periods else f"{periods} at most"
    return periods, f"{_LEAD} period to settle and {many}, as the {sensor} is then {left}"


def _lines(
    signal: Signal, seen: Trajectory, name: Quantity, tick: float, band: Band
) -> tuple[FloatArray, FloatArray]:
    """Frequencies [Hz] around the resonances and the size of a signal's lines there."""
    samples = round(signal.period / tick)
    last = seen[name][-samples:, signal.joint - 1]
    size = 2.0 / samples * np.abs(np.fft.rfft(last))
    smooth = np.sqrt(np.convolve(size**2, np.ones(_SMOOTH) / _SMOOTH, mode="same"))
    frequency: FloatArray = np.asarray(np.fft.rfftfreq(samples, tick), dtype=float)
    low, high = _AROUND[0] * band.anti_resonance_hz, _AROUND[1] * band.resonance_hz
    near = (frequency >= low) & (frequency <= high)
    return frequency[near], np.maximum(smooth[near], 1e-300)


def _why_so(signal: Signal, band: Band, amplitude: float, control: tuple[Control, ...]) -> str:
    """What the excitation is, and why."""
    low, high = _excited(signal)
    what = f"order {signal.order}, clock {1e3 * signal.clock:g} ms"
    if signal.kind == "multisine":
        what = f"{len(signal.lines)} lines, clock {1e3 * signal.clock:g} ms"
    lines = band.width_hz * signal.period
    state = "all joints under their servos" if "servo" in control else "all joints free"
    return (
        f"{what}, {amplitude:g} V, {state}: {low:.2g} to {high:.3g} Hz around "
        f"{band.anti_resonance_hz:.3g} and {band.resonance_hz:.3g} Hz, with {lines:.1f} lines in "
        "the anti-resonance's width"
    )
