"""Records compared with an arm of trial values, within the time between two pictures.

Behind rigid gears the torques of the motors are predicted from the measured motion: a motion that
is simulated from torques drifts away under gravity. Otherwise the motion is simulated, with the
servo of the study or by the recorded voltages.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from strainwave.domain import (
    FrictionTerm,
    Log,
    Parameter,
    Prediction,
    Signals,
    channel_parts,
)
from strainwave.domain.arm.assumed_values import OF_LINKS, AssumedValues, assume_missing
from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.description import ArmDescription
from strainwave.domain.arm.effects import effect_named
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.results.estimates import is_physical
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.identification.closed_loop import restrict_to_values
from strainwave.identification.validation import predict_torques
from strainwave.identification.whole_arm.inference.fit_tests import (
    InputCorrelation,
    assess_channel,
    has_noise_spectrum,
    strongest_input,
)
from strainwave.identification.whole_arm.records.dataset import Dataset
from strainwave.identification.whole_arm.records.preparation import (
    cutoff_of,
    dataset_of,
    lengthen_steps,
)
from strainwave.io.atomic_files import read_json
from strainwave.io.parameters import read_assumptions, read_parameters
from strainwave.io.results import NOT_A_RESULT, stage_estimates_of
from strainwave.numerics.spectra import correlate_residuals
from strainwave.signals.motor import SignalOptions, motion_bands, prepare_motor_signals
from strainwave.signals.prepared_record import prepare_record

_DEFAULT_RESONANCE_HZ = 30.0  # where no joint has a linear model
_SIGNAL_BAND = 4.0  # of motor signals over the compared band
_SAMPLES_PER_PERIOD = 8.0  # of the band of motor signals
_MIN_LINES = 8.0  # of a spectrum in which a test of torques sees a colour
_MIN_MOTION_TO_NOISE = 3.0  # a channel with less has no fit
_MIN_MOTION_SHARE = 0.02  # of the largest motion of a channel of its kind
_OF_STAGE = "an estimate that the verdict of the result does not confirm"
_OF_RIGID = "the smallest value with which the rigid model fits the records"


def starting_values(description: ArmDescription, file: Path) -> AssumedValues:
    """Values of all parameters from a result or a parameter file, also where it has none."""
    given = read_parameters(file)
    document = read_json(file, "the start", NOT_A_RESULT)
    entries = document.get("parameters")
    listed = entries if isinstance(entries, list) else []
    known = {(p["name"], p.get("joint")) for p in listed if p.get("value") is not None}
    values, reasons = dict(given), dict[Key, str]()
    if isinstance(document.get("stages"), dict):
        reasons = dict.fromkeys(given.keys() - known, OF_LINKS)  # `standard_parameters`
        for table, reason in (
            (stage_estimates_of(document), _OF_STAGE),
            (read_assumptions(file), _OF_RIGID),
        ):
            added = {k: v for k, v in table.items() if k not in values and is_physical(k[0], v)}
            values |= added
            reasons |= dict.fromkeys(added, reason)
    assumed = assume_missing(values, restrict_to_values(Arm.of(description), values))
    return AssumedValues(assumed.values, {**assumed.reasons, **reasons})


@dataclass(frozen=True, slots=True)
class ChannelTest:
    """Residual of one channel, which is sensor noise if the model is complete."""

    channel: str
    deviation: float  # standard deviation of the residual, in the channel's unit
    noise: float | None  # that of the sensor noise after the same low-pass; None: unknown
    whiteness: float  # p-value: the residual has the spectrum of the sensor noise
    by_input: InputCorrelation


@dataclass(frozen=True, slots=True)
class MotionWindow:
    """A window of a record, filtered and in long integrator steps."""

    record: Dataset

    def predict(self, given: Values, names: Collection[str] = ()) -> Prediction:
        """Simulated channels, all unless some are named; link sensors without their bias.

        Raises NotIdentifiable if these values cannot be simulated.
        """
        record = self.record
        values = assume_missing(given, record.arm).values
        kinds = np.array([channel_parts(name)[0] for name in record.channel_names])
        motion = record.measured.std(axis=0)
        # a channel with little motion of its kind only reacts to the motion of others
        largest = np.array([motion[kinds == kind].max() for kind in kinds])
        rests = motion < np.maximum(
            _MIN_MOTION_TO_NOISE * record.noise, _MIN_MOTION_SHARE * largest
        )
        columns = [k for k, name in enumerate(record.channel_names) if name in names]
        columns = columns or list(range(len(kinds)))
        record = replace(
            record,
            channels=tuple(record.channels[k] for k in columns),
            measured=record.measured[:, columns],
            step_error_correction=record.step_error_correction[:, columns],
        )
        try:
            simulated, _ = record.linearise(values, record.start(), ())
        except (NumericalFailure, InvalidInput) as error:
            raise NotIdentifiable(f"these values cannot be simulated: {error}") from error
        except KeyError as error:  # a constant of a sensor that neither start nor study has
            raise NotIdentifiable(f"there is no value of {label_of(*error.args[0])}") from error
        if not np.all(np.isfinite(simulated)):
            raise NotIdentifiable(
                "these values cannot be simulated: the motion grows without limit"
            )
        measured = record.advance_measured(values)
        residual = measured - simulated
        of_link = kinds[columns] != "omega_m"  # a sensor on the link has a bias
        residual[:, of_link] -= residual[:, of_link].mean(axis=0)
        errors = np.sqrt(np.mean(residual**2, axis=0))
        fits = 100.0 * (1.0 - errors / np.where(rests[columns], np.nan, motion[columns]))
        return Prediction(
            record.log.name,
            record.time,
            tuple(record.channel_names),
            measured,
            measured - residual,
            dict(zip(record.channel_names, fits.tolist(), strict=True)),
        )

    def residual_tests(self, prediction: Prediction) -> list[ChannelTest]:
        """Test the residuals of moving channels, of a prediction of all, against the inputs."""
        record, tests = self.record, list[ChannelTest]()
        voltage = prepare_record(record.log, record.arm).voltage
        inputs = record.kernels.rows(voltage, slope=False)
        residuals = (prediction.measured - prediction.predicted).T
        for k, residual in enumerate(residuals):
            if not np.isfinite(prediction.fit_percent[prediction.channels[k]]):
                continue
            test = assess_channel(record, k, residual, inputs)
            by_input = InputCorrelation(
                test.input_joint, test.input_correlation, test.input_delay, test.input_probability
            )
            tests.append(
                ChannelTest(test.channel, test.deviation, test.noise, test.whiteness, by_input)
            )
        return tests


@dataclass(frozen=True, slots=True)
class TorqueWindow:
    """Motor signals of a window of a record at a low rate."""

    arm: Arm
    signals: Signals
    bandwidth_hz: float  # that is compared

    def predict(self, given: Values, names: Collection[str] = ()) -> Prediction:
        """Torques of all motors; the regressor of one takes as long as that of all."""
        values, terms = assume_missing(given, self.arm).values, list[FrictionTerm]()
        solution = [value_of(column.parts, values) for column in self.arm.rigid_columns]
        for number, joint in enumerate(self.arm.joints, start=1):
            for effect in map(effect_named, joint.named_effects):
                size, *shape = (values[name, number] for name in effect.names)
                of_size = Parameter(effect.sizes[0], number, size, None, "", "rigid")
                terms.append(FrictionTerm(effect.name, number, of_size, shape[0] if shape else 0.0))
        return predict_torques(np.array(solution), self.signals, self.arm, self.bandwidth_hz, terms)

    def residual_tests(self, prediction: Prediction) -> list[ChannelTest]:
        """Test the residuals of moving motors against the motor velocities, the inputs here."""
        T, tests = self.signals.sample_time, list[ChannelTest]()
        if len(prediction.time) * T * self.bandwidth_hz < _MIN_LINES:
            return tests
        rows = np.searchsorted(self.signals.time, prediction.time)
        inputs = self.signals.motor_velocity[rows]
        residuals = (prediction.measured - prediction.predicted).T
        for channel, residual in zip(prediction.channels, residuals, strict=True):
            if not np.isfinite(prediction.fit_percent[channel]):
                continue
            by_input = strongest_input(correlate_residuals(residual, inputs, T))
            whiteness = has_noise_spectrum(residual, T, np.ones(1), T, self.bandwidth_hz)
            tests.append(ChannelTest(channel, float(np.std(residual)), None, whiteness, by_input))
        return tests


def window_of(
    log: Log,
    window: tuple[float, float],
    arm: Arm,
    bandwidth_hz: float | None = None,
    *,
    exact_at: Values | None = None,
) -> MotionWindow | TorqueWindow:
    """Prepare a window [s] of a record for an arm with the effects and gears of the values.

    `bandwidth_hz` is that of the compared torques; the default is that of the motion. Steps of the
    integrator are long, with errors that a slider hardly changes; at the values `exact_at` they
    have none, which takes longer. Raises InvalidInput if the record cannot be compared.
    """
    cut = _cut(log, window)
    if not any(joint.elastic for joint in arm.joints):
        return _torque_window(cut, arm, bandwidth_hz)
    cutoff = cutoff_of([cut], arm, _DEFAULT_RESONANCE_HZ)
    # under gravity the error of a simulation by recorded voltages grows; a servo holds it
    closed_loop = arm.servo is not None and "servo" in cut.experiment.control
    record = dataset_of(cut, arm, cutoff, closed_loop=closed_loop)
    if exact_at is None:
        return MotionWindow(lengthen_steps(record))
    return MotionWindow(record.correct_step_error(exact_at, record.start()))


def _torque_window(log: Log, arm: Arm, bandwidth_hz: float | None) -> TorqueWindow:
    signals = prepare_motor_signals(log, arm)
    highest = signals.bandwidth_hz or np.inf
    if bandwidth_hz is None:
        bands = motion_bands(signals.motor_angle, signals.sample_time, slow=True)
        bandwidth_hz = max(bands, default=highest)
    bandwidth = min(bandwidth_hz, highest)
    band = min(_SIGNAL_BAND * bandwidth, highest)
    signals = prepare_motor_signals(log, arm, SignalOptions(bandwidth_hz=band))
    step = max(1, int(1.0 / (_SAMPLES_PER_PERIOD * band * signals.sample_time)))
    rows = slice(None, None, step)
    decimated = replace(
        signals,
        sample_time=step * signals.sample_time,
        time=signals.time[rows],
        motor_torque=signals.motor_torque[rows],
        motor_angle=signals.motor_angle[rows],
        motor_velocity=signals.motor_velocity[rows],
        motor_acceleration=signals.motor_acceleration[rows],
        direction=signals.direction[rows],
        valid=signals.valid[rows],
    )
    return TorqueWindow(arm, decimated, bandwidth)


def _cut(log: Log, window: tuple[float, float]) -> Log:
    first, last = np.searchsorted(log.time, window)
    rows = slice(int(first), int(last))
    if first == 0 and last >= len(log):
        return log
    return log.cut(rows)
