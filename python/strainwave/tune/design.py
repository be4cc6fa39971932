"""Design of the servos of an identified arm, and what follows from it."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import product

import numpy as np

from strainwave.domain import FloatArray, IntArray, Payload
from strainwave.domain.keys import JointNumber, label_of
from strainwave.dynamics.arm import Arm
from strainwave.errors import InvalidInput, NotIdentifiable, NumericalFailure
from strainwave.export.randomisation import drawn_values
from strainwave.export.source import IdentifiedArm
from strainwave.io.joint_covariance import IdentifiedNoise, JointCovariance
from strainwave.numerics.parallel import both, one_blas_thread
from strainwave.tune.cascade_tuning import Loops, tune_cascades
from strainwave.tune.closed_loop import (
    Clock,
    Gains,
    SampledPlants,
    Steps,
    close,
)
from strainwave.tune.damping import Damping, design_damping
from strainwave.tune.margins import LoopBand, Margins, Requirements, join
from strainwave.tune.observer import Observer, design_observers
from strainwave.tune.plants import Condition, Plants, plants_of, without_impossible
from strainwave.tune.shapers import COVERAGE, RankedShaper, rank_shapers
from strainwave.tune.verification import (
    EstimationError,
    MoveComparison,
    compare_moves,
    errors_in_a_move,
    plan_moves,
)

_DEFAULT_PERIOD = 1e-3  # [s] of the servo
_DELAY_SHARE = 0.5  # of the period, if no delay is given
_N_POSTURES = 4  # drawn, besides zero angles, if no posture is given
_MAX_MODES = 4  # slowest modes that are shaped
_FIRST_SHARES = (1.0 / 3.0, 1.0 / 2.0, 2.0 / 3.0)
_N_ESTIMATION_DRAWS = 7  # whose links the observers estimate
_N_MOVE_DRAWS = 10  # simulated with friction and the curve of the gear
_NO_LIMIT = 0.75 * np.pi  # [rad] of a joint without limits in the study


@dataclass(frozen=True, slots=True)
class ServoOptions:
    """What a design must hold for; None: from the study, or as documented."""

    postures: tuple[tuple[float, ...], ...] = ()  # link angles [rad]
    payloads: tuple[Payload, ...] = ()  # in addition to none
    draws: int = 1000
    seed: int = 0
    period: float | None = None  # [s]
    delay: float | None = None  # [s] from an encoder reading to its voltage
    bandwidth_hz: float | None = None  # required of each velocity loop
    required: Requirements = field(default_factory=Requirements)


@dataclass(frozen=True, slots=True, eq=False)
class LoopResults:
    """Behaviour of the loop of one joint over all plants."""

    margins: Margins
    band: LoopBand
    steps: Steps


@dataclass(frozen=True, slots=True, eq=False)
class JointServo:
    """Servo of one joint: the designed one, and the current one for comparison."""

    joint: JointNumber
    gains: Gains
    limit: str  # what prevents higher gains: "margins" or "encoder"
    results: LoopResults
    current: Gains | None
    current_results: LoopResults | None  # None if a plant is unstable under the current servo


@dataclass(frozen=True, slots=True, eq=False)
class ServoDesign:
    """Servos and input shapers of an arm."""

    arm: IdentifiedArm
    options: ServoOptions
    clock: Clock
    limits: FloatArray  # (n_joints,) of the drives [V], or [N m] if torques are logged
    conditions: tuple[Condition, ...]
    draw: IntArray  # (n_plants,) drawn parameters of each plant; 0 are the estimates
    condition: IntArray  # (n_plants,) indices of conditions
    n_unstable: int  # plants that the current servo does not stabilise
    joints: tuple[JointServo, ...]
    # of the bandwidth, for the first trial: the smallest that was tried and stabilises all plants
    first_share: float
    modes_hz: FloatArray  # (n_modes, 2) central 95 % of the links' modes behind held motors
    shapers: tuple[RankedShaper, ...]
    observers: tuple[Observer, ...]  # of the elastic joints, at the first posture
    dampings: tuple[Damping, ...]  # by feedback of the observed torsion
    estimation: tuple[EstimationError, ...]  # of the observers; empty if unchecked
    moves: tuple[MoveComparison, ...]  # one per joint, from the first posture; empty if refused
    refusal: str  # why no moves are compared
    unchecked: str  # why the observers are not compared in a move

    @property
    def n_plants(self) -> int:
        """Number of plants: draws, conditions and slopes of curved gears."""
        return len(self.draw)

    @property
    def gains(self) -> list[Gains]:
        """Gains of all joints."""
        return [joint.gains for joint in self.joints]


@one_blas_thread()  # thousands of small matrices
def design_servo(
    arm: IdentifiedArm,
    covariance: JointCovariance | None,
    options: ServoOptions,
    progress: Callable[[str], None] = lambda _: None,
    noise: IdentifiedNoise | None = None,
) -> ServoDesign:
    """Design the servos of all joints for the drawn parameters in all conditions.

    `noise` is that of the observers' sensors; None: by encoder counts.

    Raises `NotIdentifiable` if the result lacks a parameter that the design needs, and
    `InvalidInput` if a posture is outside the limits of a joint, or if encoder, delay or margins do
    not allow the required bandwidth.
    """
    _check_options(options)
    arm = arm.with_identified_drives()
    _check_parameters(arm)
    arm = replace(arm, completion=arm.values)  # which are used often, completed once
    conditions = _conditions(arm, options)
    clock, limits = _drives(arm, options)
    noise = noise or IdentifiedNoise()
    progress("drawing plants")
    drawn = drawn_values(arm, covariance, options.draws, np.random.default_rng(options.seed))
    plants, draws = without_impossible(plants_of(arm, drawn, conditions), drawn)
    loops = Loops.of(plants, clock)
    progress("tuning the loops")
    resolutions = np.array([joint.encoder_resolution for joint in arm.study.arm.joints])
    tuned, judged = tune_cascades(loops, options.required, resolutions=resolutions, limits=limits)
    progress("simulating steps")
    gains, current = [each for each, _ in tuned], _current_gains(arm, clock)
    results = _results(judged, loops.sampled, gains)
    if options.bandwidth_hz is not None:
        _check_bandwidth([limit for _, limit in tuned], results, options.bandwidth_hz, clock)
    if unstable := _count_unstable(loops.sampled, gains):
        raise InvalidInput(
            f"the loops together leave {unstable} of {len(plants)} plants unstable",
            where="the servo design",
            remedy="require larger margins or fewer payloads, or shorten period and delay",
        )
    n_unstable = _count_unstable(loops.sampled, current) if current else 0
    of_current: Sequence[LoopResults | None] = [None] * len(tuned)
    if current and not n_unstable:
        of_current = _results(loops.judge(loops.controllers(current)), loops.sampled, current)
    progress("designing observers")
    observers = design_observers(arm, conditions[0], clock, noise)
    by_encoders, by_motors = (
        design_observers(
            arm, conditions[0], clock, noise, uses_link_sensors=False, knows_interaction=is_known
        )
        for is_known in (True, False)
    )
    dampings = design_damping(
        loops, gains, by_motors, options.required, [each.margins for each in results]
    )
    progress("ranking shapers and comparing moves")
    posture, refusal, unchecked = conditions[0].posture, "", ""
    moves: tuple[MoveComparison, ...] = ()
    estimation: tuple[EstimationError, ...] = ()

    try:
        plans = plan_moves(arm, posture, clock.period, limits)
    except InvalidInput as error:
        plans, refusal, unchecked = [], error.problem, error.problem

    def simulate_moves() -> None:
        nonlocal moves, estimation, refusal, unchecked
        try:
            few = draws[: _N_MOVE_DRAWS + 1]
            moves = compare_moves(arm, (gains, current), few, plans, limits)
            if observers:
                pair, few = (observers, by_encoders), draws[: _N_ESTIMATION_DRAWS + 1]
                estimation = errors_in_a_move(arm, pair, few, gains, posture, limits)
        except (InvalidInput, NumericalFailure) as error:
            unchecked = getattr(error, "problem", str(error))
            refusal = "" if moves else unchecked

    # shapers need the interpreter, as plans do, but simulations do not
    (modes, shapers), _ = both(
        partial(_shapers, plants, clock), simulate_moves if plans else lambda: None
    )
    return ServoDesign(
        arm=arm,
        options=options,
        clock=clock,
        limits=limits,
        conditions=conditions,
        draw=plants.draw,
        condition=plants.condition,
        n_unstable=n_unstable,
        joints=tuple(
            JointServo(i + 1, *each, results[i], current[i] if current else None, of_current[i])
            for i, each in enumerate(tuned)
        ),
        first_share=next(
            (
                share
                for share in _FIRST_SHARES  # arms that stand upright need gain
                if not _count_unstable(loops.sampled, [each.slowed(share) for each in gains])
            ),
            1.0,
        ),
        modes_hz=modes,
        shapers=shapers,
        observers=observers,
        dampings=dampings,
        estimation=estimation,
        moves=moves,
        refusal=refusal,
        unchecked=unchecked,
    )


def _drives(arm: IdentifiedArm, options: ServoOptions) -> tuple[Clock, FloatArray]:
    """Timing and limits of the inputs, from the options, the servo and the limits of the joints."""
    servo = arm.study.arm.servo
    period = options.period or (servo.period if servo else _DEFAULT_PERIOD)
    delay = _DELAY_SHARE * period if options.delay is None else options.delay
    if not 0.0 <= delay <= period:
        raise InvalidInput(
            f"a delay of {delay:g} s is not between zero and the servo period of {period:g} s",
            where="--delay",
            remedy="give the time from an encoder reading to the voltage that follows from it",
        )
    limits = np.full(arm.study.arm.n_joints, servo.limit if servo else math.inf)
    for i, joint in enumerate(arm.study.arm.joints):
        if joint.limits and joint.limits.effort:
            by_effort = joint.limits.effort * abs(joint.gear_ratio) / joint.torque_per_command
            limits[i] = min(limits[i], by_effort)
    if unknown := [str(number) for number in np.flatnonzero(np.isinf(limits)) + 1]:
        raise InvalidInput(
            f"the largest torque of the drive of joint {', '.join(unknown)} is unknown, and a "
            "servo design needs it",
            where=arm.source,
            remedy="pass --study with a study whose [servo] has a limit [V], or whose URDF or "
            "[[joint]] tables have limits = { effort = ... } [N m at the joint]",
        )
    return Clock(period, delay), limits


def _current_gains(arm: IdentifiedArm, clock: Clock) -> list[Gains] | None:
    """Gains of the servo of the study, if it has one."""
    if (servo := arm.study.arm.servo) is None:
        return None
    of_joints = servo.kp, servo.ki, servo.position_gain or (0.0,) * len(servo.kp)
    return [Gains(*each, clock.period) for each in zip(*of_joints, strict=True)]


def _results(
    judged: Sequence[tuple[Margins, LoopBand]], sampled: SampledPlants, gains: Sequence[Gains]
) -> list[LoopResults]:
    laws = [each.law() for each in gains]
    every = range(len(laws))
    parts = sampled.map(lambda part: Steps.of(close(part, laws, every), gains))
    steps = [join(each, "time", ("link",)) for each in zip(*parts, strict=True)]
    return [LoopResults(*each, own) for each, own in zip(judged, steps, strict=True)]


def _count_unstable(sampled: SampledPlants, gains: Sequence[Gains]) -> int:
    laws = [each.law() for each in gains]
    stable = sampled.map(lambda part: close(part, laws).are_stable())
    return int((~np.concatenate(stable)).sum())


def _shapers(plants: Plants, clock: Clock) -> tuple[FloatArray, tuple[RankedShaper, ...]]:
    """Intervals [Hz] of the slowest modes, and the shapers for them."""
    modes = plants.resonances(with_held_motors=True)[:_MAX_MODES]
    if not modes:
        return np.zeros((0, 2)), ()
    omega, damping = (np.array(part) for part in zip(*modes, strict=True))
    tail = 50.0 * (1.0 - COVERAGE)
    intervals = np.percentile(omega, (tail, 100.0 - tail), axis=1).T / (2.0 * np.pi)
    return intervals, tuple(rank_shapers(omega, damping, clock.period))


def _check_options(options: ServoOptions) -> None:
    required = options.required
    ranges = [
        ("--draws", "the number of draws", options.draws, -1.0, math.inf),
        ("--period", "the period", options.period, 0.0, math.inf),
        ("--bandwidth", "the bandwidth", options.bandwidth_hz, 0.0, math.inf),
        ("--gain-margin", "the gain margin", required.gain_db, 0.0, math.inf),
        ("--phase-margin", "the phase margin", required.phase_deg, 0.0, 180.0),
        ("--modulus-margin", "the modulus margin", required.modulus, 0.0, 1.0),
        *(("--payload", "the mass", payload.mass, 0.0, math.inf) for payload in options.payloads),
    ]
    for option, name, value, low, high in ranges:
        if value is not None and not low < value < high:
            wanted = "positive" if math.isinf(high) else f"between 0 and {high:g}"
            wanted = "zero or positive" if low < 0.0 else wanted
            raise InvalidInput(
                f"{name} is {value:g}", where=option, remedy=f"give a number that is {wanted}"
            )


def _check_parameters(arm: IdentifiedArm) -> None:
    """Raise NotIdentifiable if the result lacks a parameter of the linear plants."""
    description, known = arm.study.arm, arm.values
    needed = list(Arm.of(description).base.effective)
    for number, joint in enumerate(description.joints, start=1):
        names = ["motor_inertia", "motor_viscous_friction", "link_viscous_friction"]
        if joint.elastic:
            names += ["gear_damping", *joint.law.slopes]
        needed += [(name, number) for name in names]
    missing = [label_of(*key) for key in needed if key not in known]
    if missing:
        raise NotIdentifiable(
            f"{arm.source} does not determine {', '.join(missing)}, and a servo design needs it; "
            "record PRBS of a larger amplitude and a motion of all joints, and identify again"
        )


def _conditions(arm: IdentifiedArm, options: ServoOptions) -> tuple[Condition, ...]:
    """All postures with and without all payloads; raises InvalidInput beyond the joints' limits."""
    joints = arm.study.arm.joints
    limits = [
        (joint.limits.lower, joint.limits.upper)
        if joint.limits and joint.limits.lower is not None and joint.limits.upper is not None
        else (-_NO_LIMIT, _NO_LIMIT)
        for joint in joints
    ]
    postures = [np.array(posture) for posture in options.postures]
    if not postures:
        rng = np.random.default_rng(options.seed)
        low, high = np.array(limits).T
        postures = [np.clip(np.zeros(len(joints)), low, high)]
        postures += list(rng.uniform(low, high, (_N_POSTURES, len(joints))))
    for posture in postures:
        if len(posture) != len(joints):
            raise InvalidInput(
                f"the posture has {len(posture)} angles, but the arm has {len(joints)} joints",
                where="--posture",
                remedy="give one angle [rad] per joint, separated by commas",
            )
        for number, (angle, (low, high)) in enumerate(zip(posture, limits, strict=True), start=1):
            if not low <= angle <= high:
                raise InvalidInput(
                    f"the angle {angle:g} of joint {number} is outside its limits {low:g} to "
                    f"{high:g}",
                    where="--posture",
                    remedy="give a posture that the arm can reach",
                )
    return tuple(Condition(*pair) for pair in product(postures, (None, *options.payloads)))


def _check_bandwidth(
    limits: Sequence[str], results: Sequence[LoopResults], required_hz: float, clock: Clock
) -> None:
    for number, (limit, result) in enumerate(zip(limits, results, strict=True), start=1):
        reached = float(result.margins.bandwidth_hz.min())
        if reached < required_hz:
            cause = (
                "the resolution of its encoder"
                if limit == "encoder"
                else f"the margins with the period of {clock.period:g} s, the delay of "
                f"{clock.delay:g} s and the resonances"
            )
            raise InvalidInput(
                f"the velocity loop of joint {number} reaches {reached:.3g} Hz, limited by {cause}",
                where="--bandwidth",
                remedy=f"require at most {math.floor(100.0 * reached) / 100.0:g} Hz",
            )
