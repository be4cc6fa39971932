"""Effects that the core does not know: what it is given in their place, record by record.

A size s of such an effect acts through parameters and initial states u of the core alone, so that
the derivative of a channel is dy/ds = (dy/du) (du/ds).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from strainwave.domain import FloatArray
from strainwave.domain.effects import Input, RecordEffect, all_effects, effect_named
from strainwave.domain.kinds import Key, Values
from strainwave.domain.parameter_table import base_name, of_record
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive

_MOTOR_ANGLE, _LINK_ANGLE = "initial_motor_angle", "initial_link_angle"
_INITIAL = (_MOTOR_ANGLE, _LINK_ANGLE)


@dataclass(frozen=True, slots=True)
class RecordInputs:
    """What the core is given for one record, and how it follows from the parameters."""

    values: Values  # parameters
    offsets: Mapping[Key, float]  # initial state -> what is added to it
    slopes: Mapping[Key, Mapping[Key, float]]  # input of the core -> parameter -> derivative

    def begun(self, drive: Drive) -> Drive:
        """A drive with the initial states moved."""
        if not self.offsets:
            return drive
        motor = self._moved(_MOTOR_ANGLE, drive.motor_angle)
        link = drive.link_angle and self._moved(_LINK_ANGLE, drive.link_angle)
        return replace(drive, motor_angle=motor, link_angle=link)

    def _moved(self, name: str, angles: Sequence[float]) -> tuple[float, ...]:
        each = enumerate(angles, start=1)
        return tuple(angle + self.offsets.get((name, joint), 0.0) for joint, angle in each)

    def read(self, angles: FloatArray, gear_ratios: FloatArray | None = None) -> FloatArray:
        """What encoders with these zeros say.

        `angles` (n_samples, n_joints) [rad]: Of the motors. `gear_ratios` (n_joints,): Where the
        angles are those of the links. Returns (n_samples, n_joints) [rad].
        """
        zeros = np.array(self._moved(_MOTOR_ANGLE, [0.0] * angles.shape[1]))
        return angles - (zeros if gear_ratios is None else zeros * gear_ratios)

    def directions(self, parameters: Sequence[Key]) -> list[Key]:
        """What the core differentiates by, so that derivatives by parameters follow."""
        own = _sizes()
        found = [key for key in parameters if base_name(key[0]) not in own]
        asked = set(parameters)
        found += [
            key for key, row in self.slopes.items() if key not in asked and asked & row.keys()
        ]
        return found

    def by_parameters(
        self, tangent: FloatArray, directions: Sequence[Key], parameters: Sequence[Key]
    ) -> FloatArray:
        """Derivatives by parameters from those by the core's directions.

        `tangent`: The last ones stay as they are.
        """
        if not self.slopes and list(directions) == list(parameters):
            return tangent
        chain = np.zeros((len(directions), len(parameters)))
        at = {key: k for k, key in enumerate(parameters)}
        for row, key in enumerate(directions):
            for by, slope in self.slopes.get(key, {key: 1.0}).items():
                if by in at:
                    chain[row, at[by]] = slope
        n = len(directions)
        return np.concatenate([tangent[..., :n] @ chain, tangent[..., n:]], axis=-1)


def inputs_in(arm: Arm, values: Values, record: str, *, hanging: bool) -> RecordInputs:
    """What the core is given for a record on an arm with some effects.

    `arm`: Those effects of its joints count that the core does not know. `values`: (name, joint) ->
    value; an effect whose size is not among them is absent. `record`: Its name. `hanging`: Whether
    the links hang on their gears at the start, and so follow the motors.
    """
    changed: dict[Key, tuple[Input, Mapping[str, str]]] = {
        (own.name, number): (own, names)
        for number, joint in enumerate(arm.joints, start=1)
        for effect in map(effect_named, joint.named_effects)
        if isinstance(effect, RecordEffect)
        for own, names in _inputs_of(effect, number, joint.gear_ratio, values, record)
        if not (hanging and own.name == _LINK_ANGLE)
    }
    parameters = {key: own.value for key, (own, _) in changed.items() if key[0] not in _INITIAL}
    offsets = {key: own.value for key, (own, _) in changed.items() if key[0] in _INITIAL}
    slopes: dict[Key, dict[Key, float]] = {
        key: {(names.get(by, by), key[1]): slope for by, slope in own.slopes.items()}
        for key, (own, names) in changed.items()
    }
    return RecordInputs({**values, **parameters}, offsets, slopes)


def _inputs_of(
    effect: RecordEffect, number: int, gear_ratio: float, values: Values, record: str
) -> Iterator[tuple[Input, Mapping[str, str]]]:
    """What one effect changes, each with the names that its sizes have among the values."""
    names = {name: of_record(name, record) if effect.by_record else name for name in effect.sizes}
    own = {name: value for (name, joint), value in values.items() if joint == number}
    own |= {name: values.get((here, number), 0.0) for name, here in names.items()}
    for one in effect.inputs(own, gear_ratio):
        yield one, names


def _sizes() -> set[str]:
    """Names of sizes that the core does not know."""
    own = (effect for effect in all_effects() if isinstance(effect, RecordEffect))
    return {name for effect in own for name in effect.sizes}
