"""Both sides of a joint, decoupled -> JointModel: its physical parameters, with deviations.

Without link sensors the motors' own responses lead there (`models_from_motors`). With them there
are two ways: straight from the equations of motion (`identify_joint`), and through a
state-space model and its transfer functions (`state_space_of`, `from_state_space`), the paper's.
`identify_record` goes both, or only the second where the options ask for it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

import numpy as np

from strainwave.domain import (
    Decoupled,
    Diagnostic,
    FloatArray,
    JointModel,
    LinearOptions,
    LinkSignals,
    Modes,
    PhysicalOptions,
    RecordModel,
    RigidModel,
    StateSpace,
)
from strainwave.dynamics.arm import Arm
from strainwave.dynamics.two_inertia import NAMES, anti_resonance, resonance
from strainwave.errors import StrainwaveError
from strainwave.identification.joint_model.agreement import compared
from strainwave.identification.joint_model.estimates import parameters_of, status_of, warnings_of
from strainwave.identification.joint_model.grey_box import (
    FIRST_BAND_HZ,
    GreyBoxFit,
    RigidKnowledge,
    Solved,
    solve,
)
from strainwave.identification.joint_model.linear import (
    LinearFit,
    band_for,
    fit_linear,
    judge,
    modes_of,
    other_bands,
    physical_order,
    state_space_of,
)
from strainwave.identification.joint_model.motor_side import (
    models_from_catalogue,
    models_from_motors,
)
from strainwave.identification.joint_model.rigid_knowledge import rigid_knowledge
from strainwave.identification.joint_model.transfer import from_state_space
from strainwave.numerics.parallel import one_blas_thread

__all__ = [
    "JointFit",
    "LinearFit",
    "LinearOptions",
    "PhysicalOptions",
    "RecordFit",
    "RecordOptions",
    "compared",
    "fit_joint",
    "fit_linear",
    "fit_record",
    "from_state_space",
    "identify_joint",
    "identify_record",
    "joint_by_transfer",
    "judge",
    "models_from_catalogue",
    "models_from_motors",
    "modes_of",
    "rigid_knowledge",
    "state_space_of",
]

Result = TypeVar("Result")


@dataclass(frozen=True, slots=True)
class RecordOptions:
    """What may be set by hand of both ways."""

    physical: PhysicalOptions = field(default_factory=PhysicalOptions)
    linear: LinearOptions = field(default_factory=LinearOptions)
    state_space: bool = True  # whether a state-space model is estimated beside
    # whether the data choose the model's order, and the model is judged on held-out samples and
    # gives physical parameters; else it has three states in the band of the equations of motion,
    # which takes a twentieth of the time
    judged: bool = True


@dataclass(frozen=True, slots=True)
class JointFit:
    """One joint's model, and the solution behind it, from which its records alone can start."""

    model: JointModel
    solved: Solved

    def of_record(self, name: str) -> JointModel:
        """The model from one of the records alone.

        `name`: Of the experiment.
        """
        if self.model.experiments == (name,):
            return self.model
        with one_blas_thread():
            return _joint_model(self.solved.of_record(self.model.experiments.index(name)))


def identify_joint(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    model: RigidModel | None,
    arm: Arm,
    options: PhysicalOptions | None = None,
    *,
    search_from_hz: tuple[float, float] = FIRST_BAND_HZ,
) -> JointModel:
    """Physical parameters of one joint from its equations of motion, (S6) and (S7).

    `records`: Of one joint, all fitted at once.
    `search_from_hz`: The band where the data are first asked for the equations' filter.

    Returns: A parameter that the records hardly identify has the value None, and a warning says so;
    an impossible one is reported as it came, with a warning.
    """
    return fit_joint(records, model, arm, options, search_from_hz=search_from_hz).model


def fit_joint(
    records: Sequence[tuple[LinkSignals, Decoupled]],
    model: RigidModel | None,
    arm: Arm,
    options: PhysicalOptions | None = None,
    *,
    search_from_hz: tuple[float, float] = FIRST_BAND_HZ,
) -> JointFit:
    """Fit one joint as `identify_joint` does, and keep the solution of its equations."""
    chosen = options or PhysicalOptions()
    number = records[0][1].joint
    known = rigid_knowledge(model, arm, number, [signals for signals, _ in records])
    if not chosen.use_rigid:
        known = RigidKnowledge(None, None, None, known.errors)
    with one_blas_thread():  # many small systems, as in the rigid step
        solved = solve(records, arm, known, chosen.band_hz, search_from_hz)
        return JointFit(_joint_model(solved), solved)


def _joint_model(solved: Solved) -> JointModel:
    fit, number = solved.fit(), solved.records[0][1].joint
    names = tuple(signals.experiment.name for signals, _ in solved.records)
    values = _values(fit)
    covariance = _with_delay(fit.covariance, values, solved.records, number)
    said = values, covariance, fit.determined, solved.arm.joints[number - 1], number
    warnings = tuple(warnings_of(*said, ", ".join(names)))
    return JointModel(
        joint=number,
        experiments=names,
        method="grey-box",
        parameters=tuple(parameters_of(*said)),
        values=values,
        covariance=covariance,
        anti_resonance=anti_resonance(fit.joint, fit.covariance[:6, :6]),
        resonance=resonance(fit.joint, fit.covariance[:6, :6]),
        band_hz=fit.band_hz,
        fit_percent={"torque": fit.torque_fit_percent, "torsion": fit.torsion_fit_percent},
        status=status_of(warnings),
        warnings=warnings,
    )


@dataclass(frozen=True, slots=True)
class RecordFit:
    """The models of one record, and the state-space fit from which those of others can start."""

    record: RecordModel
    linear: LinearFit | None  # None: not wanted, or it failed


def identify_record(
    signals: LinkSignals,
    decoupled: Decoupled,
    model: RigidModel | None,
    arm: Arm,
    options: RecordOptions | None = None,
) -> RecordModel:
    """Identify the joint that one record excites, by every route that the options ask for.

    What fails is None in the result, and a warning of the result gives the reason.
    """
    return fit_record(signals, decoupled, model, arm, options).record


def fit_record(
    signals: LinkSignals,
    decoupled: Decoupled,
    model: RigidModel | None,
    arm: Arm,
    options: RecordOptions | None = None,
    together: JointFit | None = None,
    near: StateSpace | None = None,
) -> RecordFit:
    """Identify one record as `identify_record` does, from the results of other records.

    `together` is the fit of several records of the joint, from which this record starts, or whose
    solution for this record it uses. `near` is a state-space model of another record, from which
    a model that is not judged starts.
    """
    chosen = options or RecordOptions()
    where = decoupled.experiment.name
    warnings: list[Diagnostic] = []

    def tried(code: str, step: Callable[[], Result]) -> Result | None:
        try:
            return step()
        except (StrainwaveError, np.linalg.LinAlgError) as problem:
            warnings.append(Diagnostic(code, where, str(problem)))
            return None

    def grey_box() -> JointModel:
        if together is not None and where in together.model.experiments:
            return together.of_record(where)
        # it looks first where all together ring
        first = FIRST_BAND_HZ if together is None else together.model.band_hz
        pair = [(signals, decoupled)]
        return identify_joint(pair, model, arm, chosen.physical, search_from_hz=first)

    by_equations = chosen.physical.route == "equations"
    physical = tried("grey-box-failed", grey_box) if by_equations else None
    linear = modes = transfer = check = None
    judged = chosen.judged or not by_equations
    if chosen.state_space or not by_equations:
        how = chosen.linear if judged else _in_known_band(decoupled, physical, chosen.linear)
        start = None if judged else near
        linear = tried("state-space-failed", lambda: fit_linear(decoupled, how, start))
    if linear is not None:
        fit = linear
        warnings += [replace(each, where=where) for each in fit.model.warnings]
        modes = tried("modes-failed", lambda: modes_of(fit.model))
    if linear is not None and judged:
        check = tried("not-judged", lambda: judge(fit))
        transfer = tried(
            "transfer-function-failed", lambda: _by_transfer(fit, model, arm, chosen.physical)
        )
    state_space = None if linear is None else linear.model
    record = RecordModel(
        decoupled, physical, state_space, modes, transfer, check, warnings=tuple(warnings)
    )
    return RecordFit(record, linear)


def _in_known_band(
    record: Decoupled, physical: JointModel | None, options: LinearOptions
) -> LinearOptions:
    """Three states, in the band around the resonances where these are known already."""
    options = physical_order(options)
    if physical is None or physical.anti_resonance is None or physical.resonance is None:
        return options
    rings = physical.anti_resonance.frequency_hz, physical.resonance.frequency_hz
    return replace(options, band_hz=band_for(rings, [record], options))


def joint_by_transfer(
    records: Sequence[Decoupled],
    model: RigidModel | None,
    arm: Arm,
    options: RecordOptions | None = None,
) -> JointModel:
    """Physical parameters of one joint by the paper's route, (15) to (18).

    `records`: Of one joint; one state-space model is fitted to all of them.

    Raises `InvalidInput`: records of different joints or rates; `NotIdentifiable`: no stretch of a
    record is long enough, or the state-space model does not ring.
    """
    chosen = options or RecordOptions()
    with one_blas_thread():
        fit = fit_linear(records, physical_order(chosen.linear))
        return _by_transfer(fit, model, arm, chosen.physical)


def _by_transfer(
    fit: LinearFit, model: RigidModel | None, arm: Arm, options: PhysicalOptions
) -> JointModel:
    """Physical parameters from a state-space model of three states, the order of (17).

    If that model does not converge or has no resonance, the least damped pairs of the model of
    the chosen order are used.
    """
    reduced, records = fit.of_physical_order(), fit.records
    known = rigid_knowledge(model if options.use_rigid else None, arm, records[0].joint)
    others = _in_other_bands(records, reduced, modes_of(reduced), fit.options)
    return from_state_space(reduced, records, arm, known, others)


def _in_other_bands(
    records: Sequence[Decoupled], near: StateSpace, modes: Modes | None, options: LinearOptions
) -> list[StateSpace]:
    """Models that show how much the band matters; none where they fail or make no sense."""
    if modes is None or modes.anti_resonance is None or modes.resonance is None:
        return []
    if options.filter != "band":
        return []
    rings = modes.anti_resonance.frequency_hz, modes.resonance.frequency_hz
    found = []
    for other in other_bands(band_for(rings, records, options), records):
        how = replace(options, band_hz=other, decimation=None)  # the rate follows the band
        try:
            fitted = state_space_of(records, how, near)
            model = replace(fitted, covariance=None)
            if model.status == "converged" and modes_of(model).resonance:
                found.append(model)
        except (StrainwaveError, np.linalg.LinAlgError):
            continue
    return found


def _with_delay(
    covariance: FloatArray,
    values: Mapping[str, float],
    records: Sequence[tuple[LinkSignals, Decoupled]],
    number: int,
) -> FloatArray:
    """With what a link sensor's delay, once taken off, may still be wrong by.

    A link seen late by D has the torsion n theta_m - theta_l + D theta_l', so that k of it reads as
    gear damping of k D more or less: a variance of (k std_D)^2. It is alike in all records.
    """
    removed = [s.removed_delay[number - 1] for s, _ in records if s.removed_delay]
    if not removed or not removed[0].value:
        return covariance
    at = list(values).index("gear_damping")
    larger = covariance.copy()
    larger[at, at] += (values["gear_stiffness"] * removed[0].std) ** 2
    return larger


def _values(fit: GreyBoxFit) -> dict[str, float]:
    values = [*fit.joint.vector.tolist(), fit.coulomb_friction]
    return dict(zip((*NAMES, "motor_coulomb_friction"), values, strict=True))
