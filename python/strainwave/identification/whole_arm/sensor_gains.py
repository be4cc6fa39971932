"""What a link sensor that an arm does not have would add, by the Fisher information of the fit.

Each record is gone through once more with the sensors that its links lack: their rows are never
measured, but their derivatives by the unknowns, over their noise, are all that information asks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from strainwave.domain import FloatArray, Joint, LinkSensor, Parameter, SensorGain
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.link_sensors import is_sensor_constant
from strainwave.dynamics.simulation import Quantity, SensorNoise
from strainwave.errors import InvalidInput, NumericalFailure
from strainwave.identification.whole_arm.covariance import inverse_information
from strainwave.identification.whole_arm.dataset import Channel, Dataset
from strainwave.identification.whole_arm.estimates import Fit
from strainwave.identification.whole_arm.objective import LEAST_ERROR, Rows, repetitions_of
from strainwave.identification.whole_arm.parametrisation import Key, combination
from strainwave.numerics.linalg import triangular_factor
from strainwave.numerics.parallel import side_by_side

_ACCELEROMETER_HZ = 300.0
_GYRO_HZ = 100.0
_GYRO_DENSITY = float(np.radians(0.01))  # [rad/s/sqrt(Hz)]
_LINK_COUNTS = 2**17  # per turn of the link
_DISTANCE = 0.3  # [m] of an accelerometer, where the study has no length at all
_ROBUST_WEIGHT = 0.79  # mean of (1 + r^2)^(-1/2) over normal errors: what the soft L1 loss counts
_NAMES = ("gear_", "motor_inertia", "link_inertia")


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A sensor that a link does not have."""

    sensor: LinkSensor
    channel: Channel
    assumed: str  # its data sheet


def sensor_gains(fit: Fit, arm: Arm, parameters: Sequence[Parameter]) -> list[SensorGain]:
    """What one more link sensor in the same records would make of each interval.

    Two rules give a variance, and the larger one counts. In a sandwich B (H C H + S) B the rows
    that are there err as the fit's covariance C says, and the sensor's by its data sheet: H is
    the information without and S that of the sensor, B the inverse of both. It is right where the
    fit's errors are noise. Where they are the model's, a sensor's rows have them as well: then the
    variance shrinks no more than that of all information does.

    Robust weights, repetitions and unknowns of the records are the fit's own, and each sensor has
    an unknown constant. It errs by no less than a thousandth of what it shows: no model is better.

    `fit`: At its minimum.
    `parameters`: As published, with their standard deviations.

    Returns: Of gears and inertias, for each sensor that an elastic joint's link lacks in all
    records; empty where none lacks any, or the arm cannot be simulated with them.
    """
    candidates = list(_candidates(fit.objective.records, arm))
    asked = [p for p in parameters if p.name.startswith(_NAMES) and p.value and p.std]
    if not candidates or not asked:
        return []
    try:
        parts = _information(fit, arm, candidates)
    except (InvalidInput, NumericalFailure):
        return []
    space = fit.objective.space
    slope = space.slope(fit.z)
    prior = space.beforehand(fit.z)[0]
    known = prior.T @ prior
    W = np.array([_weights(p, space.keys, arm) for p in asked]) @ slope
    here, *each = [sum(own, known) for own in zip(*parts, strict=True)]
    own = np.linalg.inv(space.slope(fit.z))
    meat = here @ own @ fit.confidence.combined @ own.T @ here
    local = _variances(W, inverse_information(here))
    found = []
    for candidate, information in zip(candidates, each, strict=True):
        inverse = inverse_information(information)
        stds = np.array([p.std for p in asked])
        sandwich = _variances(W, inverse @ (meat + information - here) @ inverse)
        shares = np.maximum(sandwich / stds**2, _variances(W, inverse) / local)
        shares = np.sqrt(np.minimum(1.0, shares))
        for parameter, share in zip(asked, shares.tolist(), strict=True):
            found.append(_gain(candidate, parameter, share))
    return found


def _variances(rows: FloatArray, covariance: FloatArray) -> FloatArray:
    """Of combinations of what has a covariance: (n_rows,)."""
    return np.asarray(np.einsum("ij,jk,ik->i", rows, covariance, rows))


def _gain(candidate: _Candidate, parameter: Parameter, share: float) -> SensorGain:
    assert parameter.std is not None
    return SensorGain(
        sensor=candidate.sensor,
        link=candidate.channel.joint,
        assumed=candidate.assumed,
        name=parameter.name,
        joint=parameter.joint,
        std=parameter.std,
        predicted_std=share * parameter.std,
        value=parameter.value or 0.0,
    )


def _weights(parameter: Parameter, keys: Sequence[Key], arm: Arm) -> FloatArray:
    """A parameter as a combination of the unknowns' values: (n_unknowns,)."""
    key = (parameter.name, parameter.joint)
    if key in keys or parameter.joint is None:
        return combination(keys, {key: 1.0})
    return combination(keys, arm.link_inertia(parameter.joint))


def _candidates(records: Sequence[Dataset], arm: Arm) -> Iterator[_Candidate]:
    """Sensors of the links of elastic joints that have none in any record."""
    have = {c.joint for r in records for c in r.channels if c.quantity != "motor_angle"}
    for number, joint in enumerate(arm.joints, start=1):
        if number in have or not joint.elastic:
            continue
        density = SensorNoise().accelerometer_density
        place = ""
        if joint.motion == "revolute":
            place = f", {_distance(joint, arm):.2g} m from the joint's axis"
        hz = joint.accelerometer_hz or _ACCELEROMETER_HZ
        yield _Candidate(
            "accelerometer",
            Channel(f"a{number}", number, "accelerometer", rate=False, shifted=True),
            f"{hz:g} Hz, {1e3 * density:.2g} mm/s^2/sqrt(Hz){place}",
        )
        if joint.motion == "prismatic":
            continue
        yield _Candidate(
            "link-encoder",
            Channel(f"theta_l{number}", number, "link_angle", rate=True, shifted=False),
            f"{_LINK_COUNTS} counts per turn",
        )
        yield _Candidate(
            "gyro",
            Channel(f"gyro{number}", number, "gyro", rate=False, shifted=True),
            f"{joint.gyro_hz or _GYRO_HZ:g} Hz, 0.01 deg/s/sqrt(Hz)",
        )


def _distance(joint: Joint, arm: Arm) -> float:
    """[m] from the axis at which an accelerometer would sit: the study's, or the first link's."""
    return joint.accelerometer_distance or arm.link_length or _DISTANCE


def _information(fit: Fit, arm: Arm, candidates: Sequence[_Candidate]) -> list[list[FloatArray]]:
    """Each record's information, (n_unknowns, n_unknowns): as it is, then with each candidate."""
    objective, values = fit.objective, fit.objective.space.values(fit.z)
    keys, slope = objective.space.keys, objective.space.slope(fit.z)
    public = [k for k, key in enumerate(keys) if not is_sensor_constant(key)]

    def one(record: Dataset, rows: Rows) -> list[FloatArray]:
        rich = _with_candidates(record, arm, candidates)
        n_begin, n_own = len(record.local), len(rows.step)
        begun = (rows.evaluated.own + rows.step)[:n_begin]
        seen, tangent = rich.linearised(values, begun, [keys[k] for k in public])
        scale = np.sqrt(_ROBUST_WEIGHT / repetitions_of(rich))
        scale = scale / np.maximum(rich.noise, LEAST_ERROR * np.std(seen, axis=0))
        own = rows.evaluated.columns * (rows.root / rows.deviation)[..., None]
        R = triangular_factor(own.reshape(-1, own.shape[2]))
        found = [_shared(R, n_own)]
        for k, candidate in enumerate(candidates):
            # its constant, then the record's own unknowns, then the shared ones
            more = np.zeros((len(seen), 1 + own.shape[2]))
            more[:, 0] = candidate.channel.shifted
            more[:, 1 : 1 + n_begin] = tangent[:, k, len(public) :]
            more[:, 1 + n_own :] = tangent[:, k, : len(public)] @ slope[public]
            stacked = np.concatenate([np.pad(R, ((0, 0), (1, 0))), scale[k] * more])
            if not candidate.channel.shifted:
                stacked = stacked[:, 1:]
            found.append(_shared(triangular_factor(stacked), n_own + candidate.channel.shifted))
        return found

    pairs = zip(objective.records, objective.rows(fit.z), strict=True)
    return side_by_side([partial(one, *pair) for pair in pairs])


def _shared(factor: FloatArray, n_own: int) -> FloatArray:
    """R'R of what a record's own unknowns cannot imitate."""
    R = factor[n_own:, n_own:]
    return np.asarray(R.T @ R)


def _with_candidates(record: Dataset, arm: Arm, candidates: Sequence[_Candidate]) -> Dataset:
    """The record with the candidates for its channels, and their noise behind its low-pass."""
    lacking = {candidate.channel.joint for candidate in candidates}
    joints = tuple(
        replace(
            joint,
            accelerometer_distance=_distance(joint, arm),
            accelerometer_hz=joint.accelerometer_hz or _ACCELEROMETER_HZ,
            gyro_hz=joint.gyro_hz or _GYRO_HZ,
        )
        if number in lacking
        else joint
        for number, joint in enumerate(record.arm.joints, start=1)
    )
    channels = tuple(candidate.channel for candidate in candidates)
    white = np.sqrt(0.5 / record.log.sample_time)  # deviation of a sample for a density of one
    sample: dict[Quantity, float] = {
        "accelerometer": SensorNoise().accelerometer_density * white,
        "gyro": _GYRO_DENSITY * white,
        "link_angle": 2.0 * np.pi / _LINK_COUNTS / np.sqrt(12.0),
    }
    noise = [
        sample[c.quantity] * np.linalg.norm(record.kernels.taps(rate=c.rate)) for c in channels
    ]
    return replace(
        record,
        arm=record.arm.with_joints(joints),
        channels=channels,
        noise=np.array(noise),
        lacking=np.zeros((len(record.time), len(channels))),
    )
