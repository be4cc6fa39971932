"""Voltages that excite the resonances of one joint: a PRBS, or a multisine of the same band."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from strainwave.domain import Control, Experiment, FloatArray, Prbs
from strainwave.domain.arm.link_sensors import installed_axes
from strainwave.domain.arm.link_sensors.link_space import Quantity
from strainwave.domain.arm.link_sensors.single_axis import Accelerometer
from strainwave.domain.keys import JointNumber
from strainwave.dynamics import excitation
from strainwave.dynamics.simulation import Drive, SensorNoise
from strainwave.errors import InvalidInput
from strainwave.excite.guessed_arm import ExcitationBand, GuessedArm, predicted_motion, run
from strainwave.excite.plan import (
    FREE_CONTROL,
    HELD_CONTROL,
    LimitBroken,
    Planned,
    PredictedMotion,
    clock_of,
)

Kind = Literal["prbs", "multisine"]

_HALF_POWER_RATIO = 0.44  # half-power frequency of a PRBS over its clock rate
SETTLING_PERIODS = 1  # from standstill to the periodic motion
MIN_PERIODS, _MAX_PERIODS = 4, 30  # four periods separate noise from distortion
_TARGET_NOISE_RATIO = 0.03  # noise over signal on the weakest lines after averaging
_MIN_AMPLITUDE_SHARE = 0.02  # of the voltage limit; below, an experiment is useless
_N_BISECTIONS = 7  # of the amplitude
_NOISE_BAND = (0.5, 1.6)  # edges over anti-resonance and over resonance
_SMOOTHING_LINES = 5  # moving average of a spectrum
_MAX_STICTION_SHARE = 0.98  # of a record's time
_SWEEP_SHARES = (0.2, 0.4, 0.6, 0.8)  # of the full amplitude
_MAX_VOLTAGE_SHARE = 0.995  # of the voltage limit; a saturated servo does not control
_ROUNDING = 1e-12  # of limits that an amplitude reaches exactly


@dataclass(frozen=True, slots=True)
class Signal:
    """One joint's excitation of unit amplitude."""

    guess: GuessedArm
    joint: JointNumber
    kind: Kind
    clock: float  # [s]
    order: int  # of the PRBS
    ticks: int  # per period
    lines: FloatArray  # harmonics of the multisine
    shape: FloatArray  # (ticks,) one period with peak 1

    @property
    def period(self) -> float:
        """Period [s]."""
        return self.clock * self.ticks

    @property
    def band_hz(self) -> tuple[float, float]:
        """Excited band."""
        if self.kind == "prbs":
            return 1.0 / self.period, _HALF_POWER_RATIO / self.clock
        return self.lines[0] / self.period, self.lines[-1] / self.period

    def moves(self, motion: PredictedMotion) -> bool:
        """Whether the joint overcomes its friction in a part of the record."""
        return float(motion.rest_share[self.joint - 1]) < _MAX_STICTION_SHARE

    def drive(self, amplitude: float, periods: int, control: tuple[Control, ...]) -> Drive:
        """The excitation of this joint.

        Servos hold the other controlled joints at zero velocity.
        """
        voltage = np.zeros((periods * self.ticks, self.guess.arm.n_joints))
        voltage[:, self.joint - 1] = amplitude * np.tile(self.shape, periods)
        return self.guess.drive(self.clock, control, voltage, np.zeros_like(voltage))


def voltage_record(
    guess: GuessedArm, band: ExcitationBand, joint: int, *, kind: Kind, seed: int
) -> Planned:
    """One joint's excitation with the largest amplitude within the limits.

    The number of periods follows from the sensor noise. Joints are free, or all under their servos
    if this gives a larger gear torque: free joints drift. Under gravity the servos hold the arm.
    `seed` is that of a multisine's phases. Raises InvalidInput if a multisine would need a servo,
    and LimitBroken if no amplitude satisfies the limits.
    """
    arm, signal = guess.arm, _design_signal(guess, band, joint, kind, seed)
    kinds = [FREE_CONTROL, HELD_CONTROL]
    if arm.gravity:
        kinds = [HELD_CONTROL]
    elif kind == "multisine" or arm.servo is None:
        kinds = [FREE_CONTROL]
    controls = [(control,) * arm.n_joints for control in kinds]
    if kind == "multisine" and arm.gravity:
        raise InvalidInput(
            "an arm under gravity needs a servo, and a study cannot describe a multisine "
            "under a servo",
            where="--kind",
            remedy="use --kind prbs",
        )
    periods, reason = SETTLING_PERIODS + MIN_PERIODS, ""
    for _ in range(2):  # a free joint drifts further in more periods
        results = [_largest_amplitude(signal, periods, control) for control in controls]
        feasible = [(a, c, m) for (a, m), c in zip(results, controls, strict=True) if m]
        if not feasible:
            raise _limit_error(signal, periods, controls[0])
        amplitude, control, motion = max(feasible, key=lambda f: f[2].gear_torque[joint - 1])
        required_periods, reason = _required_periods(
            signal, signal.drive(amplitude, periods, control), band
        )
        if required_periods + SETTLING_PERIODS <= periods:
            break
        periods = required_periods + SETTLING_PERIODS
    name = f"{kind}-j{joint}"
    prbs = Prbs(signal.order, signal.clock, periods, amplitude) if kind == "prbs" else None
    return Planned(
        experiment=Experiment(name, f"{name}.csv", "frequency", control, joint=joint, prbs=prbs),
        drive=signal.drive(amplitude, periods, control),
        motor_angle=None,
        band_hz=signal.band_hz,
        predicted=motion,
        reasons=(_describe_excitation(signal, band, amplitude, control), reason),
    )


def sweep_records(
    guess: GuessedArm, band: ExcitationBand, full: Planned, *, seed: int
) -> tuple[tuple[Planned, ...], tuple[str, ...]]:
    """Copies of a joint's PRBS at lower amplitudes, and the reasons why others are omitted.

    `full` is the record at full amplitude. The copies show the equivalent stiffness over the
    amplitude.
    """
    original = full.experiment
    if original.prbs is None or original.joint is None:
        return (), ()
    signal = _design_signal(guess, band, original.joint, "prbs", seed)
    limits, planned, omissions = guess.limits, list[Planned](), list[str]()
    for share in _SWEEP_SHARES:
        amplitude = float(f"{share * original.prbs.amplitude:.2g}")
        drive = signal.drive(amplitude, original.prbs.periods, original.control)
        motion = predicted_motion(guess, drive)
        if motion.use_of(limits) > 1.0 + _ROUNDING:  # a free arm drifts even at low amplitudes
            omissions.append(f"at {amplitude:g} V {motion.broken(limits)}")
            continue
        if not signal.moves(motion):
            omissions.append(f"at {amplitude:g} V the motor of joint {original.joint} sticks")
            continue
        name = f"sweep-j{original.joint}-{amplitude:g}V"
        prbs = replace(original.prbs, amplitude=amplitude)
        planned.append(
            Planned(
                experiment=replace(original, name=name, file=f"{name}.csv", use="sweep", prbs=prbs),
                drive=drive,
                motor_angle=None,
                band_hz=full.band_hz,
                predicted=motion,
                reasons=(
                    f"{original.name} at {amplitude:g} V: equivalent stiffness over the amplitude",
                ),
            )
        )
    return tuple(planned), tuple(omissions)


def _limit_error(signal: Signal, periods: int, control: tuple[Control, ...]) -> LimitBroken:
    """Error with the limits that the smallest useful amplitude violates."""
    limits = signal.guess.limits
    top = limits.voltage[signal.joint - 1]
    amplitude = _MIN_AMPLITUDE_SHARE * top
    while True:
        drive = signal.drive(amplitude, periods, control)
        motion = predicted_motion(signal.guess, drive)
        if (signal.moves(motion) and motion.broken(limits)) or amplitude >= top:
            break
        amplitude = min(1.5 * amplitude, top)
    violation = motion.broken(limits) or "a servo would saturate"
    return LimitBroken(
        f"no voltage on joint {signal.joint} keeps the guessed arm within the limits: with "
        f"{amplitude:.2g} V {violation}",
        where=f"{signal.kind}-j{signal.joint}",
        remedy="widen the limit if the arm allows it, or check the parameters",
    )


def _design_signal(
    guess: GuessedArm, band: ExcitationBand, joint: int, kind: Kind, seed: int
) -> Signal:
    """PRBS with clock and order, or multisine with lines, for a band."""
    tick = clock_of(guess.arm)
    divider = max(1, int(_HALF_POWER_RATIO / band.high_hz / tick)) if kind == "prbs" else 1
    clock = tick * divider
    order = int(np.ceil(np.log2(band.period / clock + 1.0)))
    ticks = 2**order - 1 if kind == "prbs" else int(np.ceil(band.period / clock))
    first = max(1, int(band.low_hz * clock * ticks))
    last = min(int(np.ceil(band.high_hz * clock * ticks)), (ticks - 1) // 2)
    lines = np.arange(first, last + 1, dtype=float)
    if kind == "prbs":
        shape = excitation.prbs(Prbs(order, clock, 1, 1.0))
    else:
        rng, period = np.random.default_rng([seed, joint]), clock * ticks
        shape = excitation.multisine(
            lines, period=period, clock=clock, periods=1, peak=1.0, rng=rng
        )
    return Signal(guess, joint, kind, clock, order, ticks, lines, shape)


def _largest_amplitude(
    signal: Signal, periods: int, control: tuple[Control, ...]
) -> tuple[float, PredictedMotion | None]:
    """Largest amplitude within the limits, rounded down, and its predicted motion."""
    limits = signal.guess.limits
    top = limits.voltage[signal.joint - 1]

    def predict_within_limits(amplitude: float, count: int) -> PredictedMotion | None:
        drive = signal.drive(amplitude, count, control)
        motion = predicted_motion(signal.guess, drive)
        is_saturated = (motion.voltage > _MAX_VOLTAGE_SHARE * np.array(limits.voltage)).any()
        if "servo" in control and is_saturated:
            return None
        return motion if motion.use_of(limits) <= 1.0 + _ROUNDING else None

    def motion_at(amplitude: float) -> PredictedMotion | None:
        # the first period alone often violates a limit
        first = predict_within_limits(amplitude, SETTLING_PERIODS)
        return first and predict_within_limits(amplitude, periods)

    motion = motion_at(top)
    if motion:
        return top, motion
    low, high = 0.0, 1.0
    for _ in range(_N_BISECTIONS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if motion_at(middle * top) else (low, middle)
    # the drift of a free arm is not monotone in the amplitude, so the rounded one is checked
    amplitude = float(f"{low * top:.2g}")
    while amplitude >= _MIN_AMPLITUDE_SHARE * top:
        motion = motion_at(amplitude)
        if motion:
            return (amplitude, motion) if signal.moves(motion) else (0.0, None)
        amplitude = float(f"{0.95 * amplitude:.2g}")
    return 0.0, None


def _required_periods(signal: Signal, drive: Drive, band: ExcitationBand) -> tuple[int, str]:
    """Number of periods after settling that the sensor noise requires, and its reason.

    The amplitude of a line has the standard deviation sqrt(2 S/T) for a period T and noise of
    density S. The encoder's rounding has S = 2 t q^2/12, times w^2 for the velocity.
    """
    arm, tick = signal.guess.arm, clock_of(signal.guess.arm)
    samples = round(signal.period / tick)
    frequency: FloatArray = np.asarray(np.fft.rfftfreq(samples, tick), dtype=float)
    low, high = _NOISE_BAND[0] * band.anti_resonance_hz, _NOISE_BAND[1] * band.resonance_hz
    in_band = (frequency >= low) & (frequency <= high)
    densities: dict[str, tuple[Quantity, float | FloatArray]] = {}
    if resolution := arm.joints[signal.joint - 1].encoder_resolution:
        density = 2.0 * tick * resolution**2 / 12.0 * (2.0 * np.pi * frequency[in_band]) ** 2
        densities["encoder rounding"] = "motor_velocity", density
    for axis in installed_axes(arm, signal.joint, ()):
        if isinstance(axis.sensor, Accelerometer):
            (name,) = axis.quantities
            of_sensor = SensorNoise().accelerometer_density ** 2
            densities[f"{axis.sensor.noun} noise"] = name, of_sensor
    trajectory, ratios = run(signal.guess, drive), dict[str, float]()
    for sensor, (name, density_of_noise) in densities.items():
        last = trajectory[name][-samples:, signal.joint - 1]
        power = (2.0 / samples * np.abs(np.fft.rfft(last))) ** 2
        smooth = np.convolve(power, np.full(_SMOOTHING_LINES, 1.0 / _SMOOTHING_LINES), mode="same")
        size = np.maximum(np.sqrt(smooth[in_band]), 1e-300)
        ratios[sensor] = float((np.sqrt(2.0 * density_of_noise / signal.period) / size).max())
    default_reason = (
        f"{SETTLING_PERIODS} period to settle and {MIN_PERIODS} to separate noise from distortion"
    )
    if not ratios:
        return MIN_PERIODS, f"{default_reason}; the sensor noise is unknown"
    sensor, worst = max(ratios.items(), key=lambda pair: pair[1])
    required_periods = int(np.ceil((worst / _TARGET_NOISE_RATIO) ** 2))
    periods = min(max(required_periods, MIN_PERIODS), _MAX_PERIODS)
    level = f"{100.0 * worst / periods**0.5:.2g} % of the weakest line near the resonances"
    if required_periods <= MIN_PERIODS:
        return periods, f"{default_reason}; the {sensor} is then {level}"
    count = f"{periods}" if required_periods == periods else f"the maximum of {periods}"
    return periods, f"{SETTLING_PERIODS} period to settle and {count}; the {sensor} is then {level}"


def _describe_excitation(
    signal: Signal, band: ExcitationBand, amplitude: float, control: tuple[Control, ...]
) -> str:
    low, high = signal.band_hz
    kind = f"order {signal.order}, clock {1e3 * signal.clock:g} ms"
    if signal.kind == "multisine":
        kind = f"{len(signal.lines)} lines, clock {1e3 * signal.clock:g} ms"
    lines = band.width_hz * signal.period
    state = "all joints under their servos" if "servo" in control else "all joints free"
    return (
        f"{kind}, {amplitude:g} V, {state}: {low:.2g} to {high:.3g} Hz around "
        f"{band.anti_resonance_hz:.3g} and {band.resonance_hz:.3g} Hz, with {lines:.1f} lines in "
        "the width of the anti-resonance"
    )
