"""Servo designs on an independent plant: `python -m benchmarks.studies.servo_moves`.

The built-in arm with 5 kg and drawn arms, all with three-slope gears, are identified from logs that
MuJoCo simulated, and `tune` designs their servos for the identified parameters. MuJoCo then moves
the true arm, with friction, quantised encoders, the voltage limit and the delay. Printed are

- moves of single joints: steps under the current servo and under the designed loops (a plain PI
  cascade), the step through the recommended shaper, the step with feedback of the observed torsion,
  and the planned move with feed-forward;
- the tracking error of the links on a longer motion of all joints;
- margins measured by a sweep: sines are added to the voltage of one motor while it turns, and the
  loop is the ratio of the servo's answer to the voltage. Predicted are those of the estimates.
"""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.studies.engine import in_mujoco, lab_arm
from strainwave.domain import ControlLaw, FloatArray, Study
from strainwave.domain.control_law import LinearServo
from strainwave.domain.keys import Values
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.simulation import Drive, SensorNoise
from strainwave.export.source import arm_of
from strainwave.io.identified_noise import noise_of
from strainwave.io.joint_covariance import covariance_of
from strainwave.io.results import read_document, result_path
from strainwave.pipeline import identify, write
from strainwave.servo_design.design import ServoDesign, ServoOptions, design_servo
from strainwave.servo_design.feed_forward import FeedForward, feed_forward
from strainwave.servo_design.link_motion import point_to_point
from strainwave.servo_design.margins import effective_plants, margins_of
from strainwave.servo_design.plants import Condition, plants_of
from strainwave.servo_design.sampling import sampled_responses
from strainwave.servo_design.shapers import Impulses
from strainwave.servo_design.verification import shortest_plan
from strainwave.virtual import scara
from strainwave.virtual.experiments import simulate_study

_SIZES = (0.01, 0.05)  # [rad] of moves
_SECONDS, _SETTLED = 1.2, 0.02
_TRACKED, _TRACKED_SECONDS = (0.6, -0.8), 0.8  # [rad] and [s] of the longer motion
_SWEEP_HZ, _N_RUNS = np.geomspace(4.0, 320.0, 48), 4  # each run has every fourth line
_SWEEP_VOLTS, _SWEEP_SPEED, _SWEEP_SECONDS = 0.15, 25.0, 3.0  # [V] each, [rad/s] of the motor, [s]


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


def _arms(count: int, draws: int) -> Iterator[Tuned]:
    """The built-in arm, then drawn ones."""
    study = replace(lab_arm(1)[0], arm=scara.study(Path(), "three-slope").arm)
    yield tuned_arm("built-in, 5 kg", study, scara.parameters(5, "three-slope"), draws, 0)
    for k in range(count):
        seed = 3 * k + 1  # every third arm has three-slope gears
        yield tuned_arm(f"drawn, {seed}", *lab_arm(seed), draws, seed)


def moves(tuned: Tuned) -> Table:
    """Behaviour of single joints."""
    table = Table("joint", "move [rad]", "reference", "settling [s]", "overshoot [%]",
                  "vibration [%]", title=f"{tuned.name}: moves", box=None)  # fmt: skip
    design = tuned.design
    posture = design.conditions[0].posture
    for joint in range(1, tuned.arm.n_joints + 1):
        for size in _SIZES:
            end = posture.copy()
            end[joint - 1] += size
            plan = shortest_plan(design.arm, posture, end, design.clock.period, design.limit)
            for name, drive in _drives(tuned, joint, end - posture, plan):
                link, _ = tuned.run(drive, len(drive.reference))
                share = (link[:, joint - 1] - link[0, joint - 1]) / size
                table.add_row(str(joint), f"{size:g}", name, *_behaviour(share, drive.tick))
    return table


def _drives(
    tuned: Tuned, joint: int, change: FloatArray, plan: FeedForward
) -> Iterator[tuple[str, Drive]]:
    """The references of a move, by name."""
    design = tuned.design
    period, n = design.clock.period, round(_SECONDS / design.clock.period)
    gains = [each.law() for each in design.gains]
    step = np.zeros((n, tuned.arm.n_joints))
    step[0] = tuned.arm.motor_accelerations(change[None])[0] / period
    currents = [each.current for each in design.joints]
    if all(currents):
        laws = [each.law() for each in currents if each is not None]
        yield "step, current servo", _drive(design, laws, step, plan, by_angle=False)
    yield "step", _drive(design, gains, step, plan)
    damping = next(one for one in design.dampings if one.joint == joint)
    if not damping.reason:
        laws = [one.law for one in design.dampings]
        yield "step, torsion feedback", _drive(design, laws, step, plan)
    if design.shapers:
        impulses = design.shapers[0].impulses
        yield "shaped step", _drive(design, gains, _shaped(step, impulses, period), plan)
    held = plan.extended(n)
    reference = held.servo_reference(np.array([each.position_gain for each in design.gains]))
    yield "planned", _drive(design, gains, reference, plan, held.voltage)


def _shaped(reference: FloatArray, impulses: Impulses, period: float) -> FloatArray:
    """Sum of delayed shares of a reference."""
    shaped = np.zeros_like(reference)
    for share, at in zip(impulses.amplitudes, impulses.times, strict=True):
        late = round(at / period)
        shaped[late:] += share * reference[: len(reference) - late]
    return shaped


def _drive(
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
        linear_servo=LinearServo(tuple(laws), design.clock.period, design.limit),
    )


def _behaviour(share: FloatArray, period: float) -> Iterator[str]:
    """Settling, overshoot and vibration of a link, as text."""
    is_apart = np.abs(share - 1.0) > _SETTLED
    last = len(share) - int(np.argmax(is_apart[::-1])) if is_apart.any() else 0
    yield "does not settle" if is_apart[-1] else f"{last * period:.3f}"
    yield f"{100.0 * max(0.0, float(share.max()) - 1.0):.2g}"
    # swing of the link in the last half, in which every reference rests
    yield f"{50.0 * float(np.ptp(share[len(share) // 2 :])):.2g}"


def tracking(tuned: Tuned) -> str:
    """Largest distance of the links from a motion of all joints."""
    design = tuned.design
    posture = design.conditions[0].posture
    end = posture + np.resize(_TRACKED, len(posture))
    plan = feed_forward(
        design.arm, point_to_point(posture, end, _TRACKED_SECONDS, design.clock.period)
    )
    gains = [each.law() for each in design.gains]
    position = np.array([each.position_gain for each in design.gains])
    errors = []
    for voltage in (np.tile(plan.voltage[0], (len(plan.time), 1)), plan.voltage):
        drive = _drive(design, gains, plan.servo_reference(position), plan, voltage)
        link, _ = tuned.run(drive, len(plan.time))
        errors.append(1e3 * float(np.abs(link - plan.link_angle).max()))
    return (
        f"{tuned.name}: largest tracking error of a motion of {_TRACKED_SECONDS:g} s: "
        f"{errors[0]:.2f} mrad without feed-forward, {errors[1]:.2f} mrad with it"
    )


def sweep(tuned: Tuned) -> Table:
    """Margins measured with sines in the voltage, beside those of the estimates."""
    table = Table("joint", "margins", "gain [dB]", "phase [deg]", "modulus", box=None,
                  title=f"{tuned.name}: margins by a sweep")  # fmt: skip
    design = tuned.design
    period, n = design.clock.period, round(_SWEEP_SECONDS / design.clock.period)
    time = period * np.arange(n)
    posture = design.conditions[0].posture
    plan = feed_forward(design.arm, point_to_point(posture, posture, 0.1, period))
    laws = [each.law() for each in design.gains]
    # whole periods within the second half of the record
    used = n // 2
    hz = np.unique(np.round(_SWEEP_HZ * used * period)) / (used * period)
    omega = math.tau * hz
    rng = np.random.default_rng(0)
    for i in range(tuned.arm.n_joints):
        measured = np.empty(len(hz), dtype=complex)
        for run in range(_N_RUNS):
            lines = slice(run, None, _N_RUNS)
            phases = rng.uniform(0.0, math.tau, len(hz[lines]))
            injected = np.zeros((n, tuned.arm.n_joints))
            waves = np.sin(np.outer(time, omega[lines]) + phases)
            injected[:, i] = _SWEEP_VOLTS * waves.sum(axis=1)
            reference = np.zeros_like(injected)
            reference[:, i] = _SWEEP_SPEED * np.minimum(time / 0.2, 1.0)  # so that the motor slides
            drive = _drive(design, laws, reference, plan, injected + plan.voltage[0])
            _, voltage = tuned.run(replace(drive, initial_voltage=tuple(plan.voltage[0])), n)
            at = np.round(hz[lines] * used * period).astype(int)
            total = np.fft.rfft(voltage[-used:, i])[at]
            # a late voltage is that of the last reading when the next one is sampled
            own = injected[-used - 1 : -1, i] if design.clock.delay else injected[-used:, i]
            measured[lines] = np.fft.rfft(own)[at] / total - 1.0
        z = np.exp(1j * omega * period)
        closed = np.stack([each.response(z) for each in design.gains], axis=1)
        middle = posture.copy()  # of the used part of the record
        middle[i] += tuned.arm.gear_ratios[i] * _SWEEP_SPEED * (0.75 * _SWEEP_SECONDS - 0.1)
        plants = plants_of(design.arm, [design.arm.values], [Condition(middle)])
        each = effective_plants(sampled_responses(plants, omega, design.clock), closed, i)
        loops = {"predicted, lowest slope": each[0], "predicted, highest slope": each[-1]}
        loops = {name: plant * closed[:, i] for name, plant in loops.items()}
        for name, loop in {**loops, "measured": measured}.items():
            margin = margins_of(loop[None], omega)
            table.add_row(str(i + 1), name, *(f"{float(x[0]):.3g}" for x in
                          (margin.gain_db, margin.phase_deg, margin.modulus)))  # fmt: skip
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=1, help="drawn arms, after the built-in one")
    parser.add_argument("--draws", type=int, default=1000)
    options = parser.parse_args()
    console = Console(width=110)
    for tuned in _arms(options.arms, options.draws):
        console.print(moves(tuned))
        console.print(tracking(tuned))
        console.print(sweep(tuned))


if __name__ == "__main__":
    main()
