"""Bodies and parameters that a format needs: identified, projected or assumed.

Rigid bodies have the base parameters of an arm.

A parameter without value has the estimate of the last stage that has one, which may be rejected, or
that of the rigid model, which predicts the records: the least-squares solution of smallest norm.
Without these, friction is zero, the gear is rigid and the links are those nearest to the prior.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from strainwave.domain import (
    ArmDescription,
    BoolArray,
    Diagnostic,
    FloatArray,
    LinkPrior,
    Place,
    RigidModel,
)
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA
from strainwave.domain.arm.combinations import LINK_INERTIA, is_rigid_drive, rigid_columns
from strainwave.domain.arm.consistent_links import standard_parameters
from strainwave.domain.arm.description import unit_in
from strainwave.domain.arm.effects import all_effects
from strainwave.domain.arm.kinds import arm_keys, kind_of
from strainwave.domain.arm.kinds.base import Body
from strainwave.domain.arm.parameter_table import family_of
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.results.estimates import is_physical
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import inverse_dynamics
from strainwave.errors import InvalidInput
from strainwave.export.source import IdentifiedArm
from strainwave.io.base_parameters import (
    friction_laws,
    motor_regressor,
    standard_of_torques,
    torque_errors,
)

FORMATS_OF_RIGID_LINKS = ("urdf", "srdf", "usd", "sdf", "drake", "isaaclab", "mjlab", "pace")
"""Formats with joints behind rigid gears, whose friction is that of the joint."""
_MAX_GRAVITY_ERROR = 0.01  # relative; errors of torque constants are smaller


def link_bodies(arm: IdentifiedArm, gravity: float) -> tuple[Body, ...]:
    """One body per link, from the base, with the base parameters of the arm.

    Motion identifies only base parameters; the kind of arm chooses one of the sets of masses that
    have them. Under `gravity` [m/s^2] link 1 has the measured gravity torque; without, its centre
    of mass is on the axis. Raises `InvalidInput` if a base parameter is missing or no bodies
    have these parameters.
    """
    with _source_in_message(arm):
        return kind_of(arm.study.arm).bodies(arm.study.arm, arm.need, gravity)


def standard_links(arm: IdentifiedArm, gravity: float) -> list[LinkPrior]:
    """Standard parameters of `link_bodies`."""
    links = []
    for body in link_bodies(arm, gravity):
        xx, yy, zz, xy, xz, yz = body.inertia
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        links.append(standard_parameters(body.mass, np.array(body.centre), inertia))
    return links


def rotor_inertias(arm: IdentifiedArm) -> list[float]:
    """Inertias of the motors that the links do not include."""
    numbers = range(1, arm.study.arm.n_joints + 1)
    if is_rigid_drive(arm.study.arm):
        return [0.0 for _ in numbers]  # the link of a single rigid joint includes its motor
    return [arm.need(MOTOR_INERTIA, number) for number in numbers]


def chain_of(arm: IdentifiedArm, gravity: float) -> ArmDescription:
    """The arm as a chain of bodies under a gravity [m/s^2] of the study's direction."""
    description = arm.study.arm
    vector = np.array(description.gravity or (0.0, 0.0, 0.0))
    x, y, z = (vector * gravity / (description.gravity_size or 1.0)).tolist()
    return replace(description, kind="serial", gravity=(x, y, z) if gravity else None)


def body_torques(arm: IdentifiedArm, motion: FloatArray, gravity: float) -> FloatArray:
    """Torques of links, rotors and link friction for a motion of the motors: (n_samples, n)."""
    bodies = np.concatenate([*standard_links(arm, gravity), rotor_inertias(arm)])
    description = Arm.of(arm.study.arm)
    viscous = [arm.need("link_viscous_friction", i + 1) for i in range(description.n_joints)]
    friction = description.motors_of(description.links_of(motion[1]) * viscous)
    return np.asarray(motor_regressor(chain_of(arm, gravity), motion) @ bodies + friction)


def effective_gravity(arm: IdentifiedArm) -> float:
    """Gravity [m/s^2] under which rigid bodies have all measured gravity torques.

    It differs from that of the study by the errors of the estimates, and is zero for a horizontal
    arm. Raises `InvalidInput` if a parameter is missing or the gravity torques contradict.
    """
    with _source_in_message(arm):
        return kind_of(arm.study.arm).effective_gravity(arm.study.arm, arm.need)


@contextmanager
def _source_in_message(arm: IdentifiedArm) -> Iterator[None]:
    try:
        yield
    except InvalidInput as error:
        where = error.where or f"{arm.source}: parameters"
        raise InvalidInput(error.problem, where=where, remedy=error.remedy) from error


def gravity_warnings(arm: IdentifiedArm) -> tuple[Diagnostic, ...]:
    """A warning if bodies under the gravity of the study miss a measured gravity torque."""
    gravity = arm.study.arm.gravity_size
    if not gravity:
        return ()
    error = effective_gravity(arm) / gravity - 1.0
    if abs(error) < _MAX_GRAVITY_ERROR:
        return ()
    law, keys = kind_of(arm.study.arm).gravity_note, tuple(arm_keys(arm.study.arm))
    place = Place(file=arm.source)
    return (Diagnostic("gravity-torque", place, law=law, error=error, keys=keys),)


FRICTION = ("motor_viscous_friction", "motor_coulomb_friction", "friction_offset")
DAMPING = ("motor_damping_2", "motor_damping_3")
"""Torque per v |v| and v^3 of a motor, in formats with polynomial damping."""
# of damping with powers, over that of viscous friction: powers that follow a law of the velocity,
# not a dependence on load, leave almost nothing; others are wrong at higher speeds
_MAX_CUBIC_ERROR = 0.5
_MAX_ERROR = 1e-3  # of friction that is held as identified, relative to the torque of the joint
_N_SAMPLES = 100  # of a motion in place of a recorded one, in each direction
_ACCELERATION = 10.0  # [rad/s^2] of its joints; their velocity is 1 rad/s


def completed(
    arm: IdentifiedArm,
    form: str = "json",
    held: Collection[str] = (),
    *,
    has_powers: bool | None = None,
) -> IdentifiedArm:
    """The arm without missing values; `assumptions` lists the values that are not identified.

    `form` is the format, and `held` are effects that it represents. MuJoCo has damping with powers
    of the velocity, unless an old version does not: `has_powers`.
    """
    has_powers = form == "mjcf" if has_powers is None else has_powers
    before, identified = arm.values, arm.identified
    description, notes = arm.study.arm, list[str]()
    fallback: Values = {}
    if arm.rigid is not None:
        keys = [column.key for column in rigid_columns(description)]
        fallback = dict(zip(keys, arm.rigid.solution.tolist(), strict=True))
    for key, value in (fallback | arm.estimates).items():
        identified.setdefault(key, value if is_physical(key[0], value) else 0.0)
    known = arm.complete(identified)
    for number, joint in enumerate(description.joints, start=1):
        needed = [MOTOR_INERTIA, *joint.law.names]
        needed += [LINK_INERTIA] if description.n_joints == 1 and not arm.standard else []
        missing = [name for name in needed if not known.get((name, number))]
        if joint.elastic and missing:
            description = description.with_joint(number, spring="rigid", effects=())
            notes.append(f"assumed: joint {number} is rigid: {', '.join(missing)} not identified")
    arm = replace(arm, study=replace(arm.study, arm=description))
    original, values = arm, arm.complete(identified)
    for key in _needed(arm):
        values.setdefault(key, 0.0)
    arm, rigid = replace(arm, completion=values), arm.rigid
    if rigid is not None:
        try:
            link_bodies(arm, effective_gravity(arm))
        except InvalidInput as error:
            arm, note = _as_chain(arm, rigid, error)
            notes.append(note)
            values |= arm.standard
        if rigid.motion.size:
            arm = _with_projected_friction(original, arm, rigid, notes, held, has_powers)
            if form not in FORMATS_OF_RIGID_LINKS:  # they have other friction
                bodies = body_torques(arm, rigid.motion, effective_gravity(arm))
                notes.append(loss_note(arm, bodies + motor_friction(arm, rigid.motion)))
    servo = description.position_servo
    for number in range(1, description.n_joints + 1):
        if servo and servo.gain(number) is None and ("servo_kp", number) not in values:
            notes.append(
                f"torques, inertias, masses and friction are per N m/rad of servo {number}'s gain, "
                "which is not determined: the motion is that of the arm, forces are not"
            )
    law_keys = [(name, i + 1) for i, j in enumerate(description.joints) for name in j.law.names]
    listed = [
        f"{label_of(*key)} = {values[key]:.4g} {unit_in(description, key)}"
        for key in dict.fromkeys((*_needed(arm), *law_keys, *Arm.of(description).base_names))
        if key not in before and key in values
    ]
    if listed:
        notes.append(f"assumed, because they are not identified: {', '.join(listed)}")
    return replace(arm, completion=values, assumptions=tuple(notes))


def _as_chain(
    arm: IdentifiedArm, model: RigidModel, error: InvalidInput
) -> tuple[IdentifiedArm, str]:
    """The arm as a chain of bodies that have the torques of its rigid model; raises `error`."""
    joints = enumerate(arm.study.arm.joints, start=1)
    motors = [arm.values[MOTOR_INERTIA, i] if joint.elastic else None for i, joint in joints]
    standard = standard_of_torques(arm.study.arm, model, motors)
    if standard is None:
        raise error
    chain = replace(arm.study.arm, kind="serial")
    note = (
        "assumed: the links are the bodies nearest to typical ones with the torques of the rigid "
        f"model over the recorded motion: {error.problem}"
    )
    return replace(arm, study=replace(arm.study, arm=chain), standard=standard), note


def _needed(arm: IdentifiedArm) -> Iterator[Key]:
    """Parameters that are zero, or as in the rigid model, where they have no value."""
    description = arm.study.arm
    for number, joint in enumerate(description.joints, start=1):
        yield MOTOR_INERTIA, number
        for name in (*FRICTION, "link_viscous_friction", *["gear_damping"] * joint.elastic):
            yield name, number
    if description.gravity:
        yield from (key for key in Arm.of(description).base_names if family_of(key[0]) == "gravity")


def _with_projected_friction(
    original: IdentifiedArm,
    arm: IdentifiedArm,
    model: RigidModel,
    notes: list[str],
    held: Collection[str],
    has_powers: bool,
) -> IdentifiedArm:
    """The arm with friction of the motors whose law no format has, or that is not identified.

    With the bodies, it has the nearest torque to that of the rigid model over the recorded motion.
    `notes` get the laws and the loss. The values of `arm` change.
    """
    motion, description, values = model.motion, original.study.arm, arm.values
    torques = inverse_dynamics(Arm.of(description), model, motion)
    of_bodies = body_torques(arm, motion, effective_gravity(arm))
    identified, size = motor_friction(arm, motion), np.std(torques, axis=0)
    for i, joint in enumerate(description.joints):
        keys: list[Key] = [(name, i + 1) for name in (*FRICTION, *DAMPING)]
        known = {p.name for p in arm.parameters if p.joint == i + 1 and p.value}
        effects = {term.effect for term in model.friction_terms if term.joint == i + 1}
        effects |= {effect.name for effect in all_effects() if known.intersection(effect.names)}
        effects = effects.difference(held)
        v, wanted = motion[1, :, i], torques[:, i] - of_bodies[:, i]
        is_held = not effects and original.values.keys() >= set(keys[: len(FRICTION)])
        error = np.std((wanted - identified[:, i])[v != 0.0])
        if is_held and (joint.elastic or error < _MAX_ERROR * size[i]):
            torques[:, i] = of_bodies[:, i] + identified[:, i]
            continue
        projection = project_friction(wanted, v, is_polynomial=has_powers and bool(effects))
        if effects:
            powers = (
                ", and damping with powers, read since MuJoCo 3.7" if projection[3:].any() else ""
            )
            notes.append(
                f"projected: {', '.join(sorted(effects))} (joint {i + 1}): friction has viscous, "
                f"Coulomb and constant torque{powers}, nearest over the recorded motion"
            )
        values.update(zip(keys, projection.tolist(), strict=True))
    return replace(arm, torques=torques)


def loss_note(arm: IdentifiedArm, predicted: FloatArray) -> str:
    """Note on the loss of the fits by `predicted` torques instead of `arm.torques`.

    Differences are taken as independent of the residuals of the fit.
    """
    assert arm.torques is not None
    slides = motion_of(arm)[1] != 0.0
    difference = np.where(slides, predicted - arm.torques, 0.0)
    rms = np.sqrt(np.sum(difference**2, axis=0) / np.maximum(1, slides.sum(axis=0)))
    residual = torque_errors(arm.rigid, arm.torques)
    size = np.std(arm.torques, axis=0) + np.finfo(float).tiny
    points = 100.0 * (np.hypot(residual, rms) - residual) / size
    listed = ", ".join(f"{x:.1f} (motor {i})" for i, x in enumerate(points.tolist(), start=1))
    return (
        f"expected loss of the torques' fits over the recorded motion, in points: {listed}; other "
        "motions may lose more"
    )


def project_friction(
    torque: FloatArray, velocity: FloatArray, *, is_polynomial: bool = False
) -> FloatArray:
    """Friction nearest to torques, in the order of `FRICTION` and `DAMPING`: (5,).

    `torque` and `velocity` (n_samples,); samples without velocity do not count. Friction is
    Coulomb friction, an offset and damping v (d + d_2 |v| + d_3 v^2), without `is_polynomial` d
    alone. It is a sum of laws that increase with the velocity, with positive weights: dissipative
    at all velocities.
    """
    slides = velocity != 0.0
    v, wanted = velocity[slides], torque[slides]
    if not v.size:
        return np.zeros(len(FRICTION + DAMPING))
    plain, top = np.eye(5)[: len(FRICTION)], np.abs(v).max()
    # powers, and laws whose slope (1 - |v|/w)^2 falls up to w
    curved = [[1.0, 0, 0, -1.0 / w, w**-2 / 3.0] for w in (0.5 * top, top)]
    bases = [plain] + [np.vstack([plain, np.eye(5)[3:], curved])] * is_polynomial
    nearest = [nonnegative_fit(_laws(v) @ basis.T, wanted, basis[:, 2] > 0.0) for basis in bases]
    fits = [shares @ basis for shares, basis in zip(nearest, bases, strict=True)]
    errors = [float(np.linalg.norm(wanted - _laws(v) @ fit)) for fit in fits]
    return np.asarray(fits[-1] if errors[-1] < _MAX_CUBIC_ERROR * errors[0] else fits[0])


def _laws(v: FloatArray) -> FloatArray:
    """Torques (..., 5) of unit coefficients in the order of `FRICTION` and `DAMPING`."""
    return np.concatenate([friction_laws(v), np.stack([v * np.abs(v), v**3], axis=-1)], axis=-1)


def motor_friction(arm: IdentifiedArm, motion: FloatArray) -> FloatArray:
    """Friction torques of the motors for a motion: (n_samples, n_joints)."""
    names, numbers = (*FRICTION, *DAMPING), range(1, motion.shape[2] + 1)
    sizes = [[arm.values.get((name, number), 0.0) for name in names] for number in numbers]
    return np.asarray(np.sum(_laws(motion[1]) * sizes, axis=2))


def nonnegative_fit(A: FloatArray, b: FloatArray, is_free: BoolArray | bool = False) -> FloatArray:
    """Least squares A x = b with x >= 0 apart from free ones: (n_columns,)."""
    from scipy.optimize import lsq_linear  # takes half a second

    sizes = np.linalg.norm(A, axis=0) + np.finfo(float).tiny
    low = np.where(is_free, -np.inf, np.zeros(len(sizes)))
    return np.asarray(lsq_linear(A / sizes, b, (low, np.inf)).x / sizes)


def motion_of(arm: IdentifiedArm) -> FloatArray:
    """Motion of the motors over which formats approximate the arm: (3, n_samples, n_joints).

    That of the fitted records; without a rigid model a random one, in both directions.
    """
    if arm.rigid is not None and arm.rigid.motion.size:
        return arm.rigid.motion
    n, random = arm.study.arm.n_joints, np.random.default_rng(0)
    angle = random.uniform(-np.pi, np.pi, (_N_SAMPLES, n))
    velocity, acceleration = random.standard_normal((2, _N_SAMPLES, n))
    links = np.stack([angle, velocity, _ACCELERATION * acceleration])
    both = np.concatenate([links, links * [[[1.0]], [[-1.0]], [[1.0]]]], axis=1)
    return Arm.of(arm.study.arm).motor_accelerations(both)
