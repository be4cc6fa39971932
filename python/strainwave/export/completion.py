"""A value of every parameter that a format needs: identified, projected or assumed.

A parameter without value has the estimate of the last stage that has one, which may be rejected, or
that of the rigid model, which predicts the records: the least-squares solution of smallest norm.
Without these, friction is zero, the gear is rigid and the links are those nearest to the prior.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from strainwave.domain import FloatArray, RigidModel
from strainwave.domain.base_parameters import MOTOR_INERTIA, base_parameters
from strainwave.domain.combinations import LINK_INERTIA, rigid_columns
from strainwave.domain.effects import all_effects
from strainwave.domain.keys import Key, Values, label_of
from strainwave.domain.parameter_table import family_of
from strainwave.domain.ranges import is_physical
from strainwave.domain.units import unit_in
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.rigid_prediction import torque_parts
from strainwave.errors import InvalidInput
from strainwave.export.bodies import effective_gravity, link_bodies
from strainwave.export.source import IdentifiedArm
from strainwave.io.base_parameters import motor_regressor, standard_of_torques

FRICTION = ("motor_viscous_friction", "motor_coulomb_friction", "friction_offset")
DAMPING = ("motor_damping_2", "motor_damping_3")
"""Torque per v |v| and v^3 of a motor, in formats with polynomial damping."""
# of damping with powers, over that of viscous friction: powers that follow a law of the velocity,
# not a dependence on load, leave almost nothing; others are wrong at higher speeds
_MAX_CUBIC_ERROR = 0.5
_MAX_ERROR = 1e-3  # of friction that is held as identified, relative to the torque of the joint
_POINT = 0.01  # of a fit; smaller differences of torques are not noted
_N_SAMPLES = 100  # of a motion in place of a recorded one, in each direction
_ACCELERATION = 10.0  # [rad/s^2] of its joints; their velocity is 1 rad/s


def completed(arm: IdentifiedArm, *, is_polynomial: bool = False) -> IdentifiedArm:
    """The arm without missing values; `assumptions` lists the values that are not identified.

    `is_polynomial`: the format has polynomial damping.
    """
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
    arm = replace(arm, completion=values)
    if arm.rigid is not None:
        try:
            link_bodies(arm, effective_gravity(arm))
        except InvalidInput as error:
            arm, note = _as_chain(arm, arm.rigid, error)
            notes.append(note)
            values |= arm.standard
        values |= dict(_projected_friction(original, arm.standard, values, notes, is_polynomial))
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


def _projected_friction(
    arm: IdentifiedArm, standard: Values, values: Values, notes: list[str], is_polynomial: bool
) -> Iterator[tuple[Key, float]]:
    """Friction of the motors whose law no format has, or that is not identified.

    With the bodies, it has the nearest torque to that of the rigid model over the recorded motion.
    """
    model, description = arm.rigid, Arm.of(arm.study.arm)
    assert model is not None
    _, velocity, _ = model.motion
    parts = torque_parts(description, model.solution, model.motion, model.friction_terms)
    torque = parts.friction(np.sign(velocity))
    total = parts.body + torque
    if standard:  # not all arms have bodies with the torques of the model
        chain = replace(arm.study.arm, kind="serial")
        motors = ((MOTOR_INERTIA, i + 1) for i in range(chain.n_joints))
        bodies = [standard.get(key, 0.0) for key in (*base_parameters(chain).links, *motors)]
        is_rigid = [not joint.elastic for joint in chain.joints]
        torque += (parts.body - motor_regressor(chain, model.motion) @ bodies) * is_rigid
    of_links = [values.get(("link_viscous_friction", i + 1), 0.0) for i in range(len(velocity.T))]
    torque -= description.motors_of(np.array(of_links) * description.links_of(velocity))
    lost = []
    for number in range(1, description.n_joints + 1):
        keys: list[Key] = [(name, number) for name in (*FRICTION, *DAMPING)]
        known = {p.name for p in arm.parameters if p.joint == number and p.value}
        laws = {term.effect for term in model.friction_terms if term.joint == number}
        laws |= {effect.name for effect in all_effects() if known.intersection(effect.names)}
        v, wanted = velocity[:, number - 1], torque[:, number - 1]
        slides = v != 0.0
        size = np.std(total[slides, number - 1])
        torques_of = _laws(v)[slides]
        error = np.std(wanted[slides] - torques_of @ [values.get(key, 0.0) for key in keys])
        is_held = not laws and arm.values.keys() >= set(keys[: len(FRICTION)])
        if is_held and (arm.study.arm.joints[number - 1].elastic or error < _MAX_ERROR * size):
            continue
        projection = project_friction(
            wanted, v, has_offset=True, is_polynomial=is_polynomial and bool(laws)
        )
        if laws:
            powers = ", and damping with powers, read by MuJoCo 4" if projection[3:].any() else ""
            notes.append(
                f"projected: {', '.join(sorted(laws))} (joint {number}): friction has viscous, "
                f"Coulomb and constant torque{powers}, nearest over the recorded motion"
            )
        lost.append((number, np.std(wanted[slides] - torques_of @ projection) / size))
        yield from zip(keys, projection.tolist(), strict=True)
    notes += lost_note("bodies and friction that a format has", lost)


def lost_note(cause: str, shares: Iterable[tuple[int, float]]) -> list[str]:
    """Note on joints whose torque differs by shares of its standard deviation, from one point."""
    listed = [f"{100.0 * share:.2g} (joint {i})" for i, share in shares if share >= _POINT]
    if not listed:
        return []
    return [
        f"{cause} lower the fits of the torques over the recorded motion by at most "
        f"{', '.join(listed)} points"
    ]


def project_friction(
    torque: FloatArray, velocity: FloatArray, *, has_offset: bool, is_polynomial: bool = False
) -> FloatArray:
    """Friction nearest to torques, in the order of `FRICTION` and `DAMPING`: (5,).

    `torque` and `velocity` (n_samples,); samples without velocity do not count. Friction is
    Coulomb friction, an offset and damping v (d + d_2 |v| + d_3 v^2), without `is_polynomial` d
    alone. It is a sum of laws that increase with the velocity, with positive weights: dissipative
    at all velocities.
    """
    slides = velocity != 0.0
    v = velocity[slides]
    if not v.size:
        return np.zeros(len(FRICTION + DAMPING))
    laws = _laws(v)
    plain, top = np.eye(5)[: 2 + has_offset], np.abs(v).max()
    projection, error = _nearest(torque[slides], laws, plain)
    if is_polynomial:  # powers, and laws whose slope (1 - |v|/w)^2 falls up to w
        curved = [[1.0, 0, 0, -1.0 / w, w**-2 / 3.0] for w in (0.5 * top, top)]
        cubic, cubic_error = _nearest(
            torque[slides], laws, np.vstack([plain, np.eye(5)[3:], curved])
        )
        if cubic_error < _MAX_CUBIC_ERROR * error:
            return cubic
    return projection


def _laws(v: FloatArray) -> FloatArray:
    """Torques (n_samples, 5) of unit coefficients in the order of `FRICTION` and `DAMPING`."""
    return np.column_stack([v, np.sign(v), np.ones_like(v), v * np.abs(v), v**3])


def _nearest(torque: FloatArray, laws: FloatArray, parts: FloatArray) -> tuple[FloatArray, float]:
    """Coefficients of the laws (n_samples, 5) nearest to a torque, and the distance.

    They are a sum of rows of `parts` with positive weights, apart from the offset.
    """
    from scipy.optimize import lsq_linear  # takes half a second

    A = laws @ parts.T
    sizes, low = np.linalg.norm(A, axis=0), np.where(parts[:, 2], -np.inf, 0.0)
    shares = lsq_linear(A / sizes, torque, (low, np.inf)).x
    return np.asarray(shares / sizes @ parts), float(np.linalg.norm(torque - A / sizes @ shares))


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
