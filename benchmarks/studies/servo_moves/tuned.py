"""Arms that are identified and tuned from logs of MuJoCo, and their motion in MuJoCo."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from benchmarks.studies.engine import in_mujoco, lab_arm
from strainwave.domain import ControlLaw, FloatArray, Study
from strainwave.domain.arm.description import LinearServo
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, SensorNoise
from strainwave.export.source import arm_of
from strainwave.io.results import covariance_of, noise_of, read_document, result_path
from strainwave.pipeline import identify, write
from strainwave.tune.design import ServoDesign, ServoOptions, design_servo
from strainwave.tune.feed_forward import FeedForward
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study


@dataclass(frozen=True, slots=True, eq=False)
class Tuned:
    """A design and the true arm."""

    name: str
    arm: Arm
    values: Values
    design: ServoDesign

    def run(self, drive: Drive, samples: int) -> tuple[FloatArray, FloatArray]:
        """Link angles and voltages (n_samples, n_joints) of the true arm in MuJoCo."""
        run = in_mujoco(
            self.arm,
            self.values,
            drive,
            sample_time=drive.tick,
            samples=samples,
            record=["link_angle", "voltage"],
            delay=self.design.clock.delay,
        )
        return run["link_angle"], run["voltage"]


def tuned_arm(name: str, study: Study, values: Values, draws: int, seed: int) -> Tuned:
    """Simulate the logs of an arm in MuJoCo, identify it, and design its servos."""
    with TemporaryDirectory() as text:
        folder = Path(text)
        simulate_study(
            study,
            values,
            folder,
            seed=seed,
            noise=SensorNoise(),
            as_recorded=False,
            simulator=in_mujoco,
        )
        write(identify(folder / "study.toml"), folder)
        path = result_path(folder)
        document = read_document(path)
        arm = arm_of(document, path, None)
        chosen = ServoOptions(draws=draws)
        noise = noise_of(document)
        design = design_servo(arm, covariance_of(document), chosen, noise=noise)
    return Tuned(name, Arm.of(study.arm), values, design)


def arms(count: int, draws: int) -> Iterator[Tuned]:
    """The built-in arm, then `count` drawn ones."""
    study = replace(lab_arm(1)[0], arm=scara.STIFF.study(Path(), "three-slope").arm)
    yield tuned_arm("built-in, 5 kg", study, scara.STIFF.parameters(5, "three-slope"), draws, 0)
    for k in range(count):
        seed = 3 * k + 1  # every third arm has three-slope gears
        yield tuned_arm(f"drawn, {seed}", *lab_arm(seed), draws, seed)


def drive_under(
    design: ServoDesign,
    laws: Sequence[ControlLaw],
    reference: FloatArray,
    plan: FeedForward,
    voltage: FloatArray | None = None,
    *,
    by_angle: bool = True,
) -> Drive:
    """All motors under laws, from the planned start; without a plan the start is held.

    With `by_angle` a reference without feed-forward acts through its angle alone.
    """
    if by_angle and voltage is None:
        used = np.array([1.0, 0.0, 1.0])
        laws = [replace(law, B=law.B * used, D=law.D * used) for law in laws]
    held = np.tile(plan.voltage[0], (len(reference), 1)) if voltage is None else voltage
    return Drive(
        tick=design.clock.period,
        voltage=held,
        reference=reference,
        servo=(True,) * reference.shape[1],
        motor_angle=tuple(plan.motor_angle[0].tolist()),
        initial_voltage=tuple(plan.voltage[0].tolist()),
        linear_servo=LinearServo(tuple(laws), design.clock.period, design.limits[0]),
    )
