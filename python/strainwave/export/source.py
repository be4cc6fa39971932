"""A result and its study as the arm to export; notes on what a format cannot hold."""

from __future__ import annotations

import hashlib
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from strainwave.domain import (
    Diagnostic,
    FloatArray,
    Joint,
    Parameter,
    Place,
    RigidModel,
    Study,
    is_physical,
    physical_range,
)
from strainwave.domain.arm.base_parameters import MOTOR_INERTIA, base_parameters
from strainwave.domain.arm.combinations import is_rigid_drive, lumped_inertias, rigid_columns
from strainwave.domain.arm.description import Urdf
from strainwave.domain.arm.gear_laws import gear_parameters
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.link_sensors import key_texts, sensor_constants
from strainwave.domain.arm.parameter_table import base_name, family_of
from strainwave.domain.arm.parameters import complete_values
from strainwave.domain.keys import JointNumber, Values
from strainwave.errors import InvalidInput
from strainwave.export.read_back import Check, ReadBack
from strainwave.io import results
from strainwave.io.atomic_files import read_bytes
from strainwave.io.joint_covariance import JointCovariance
from strainwave.io.study import read_study
from strainwave.io.urdf import read_urdf


@dataclass(frozen=True, slots=True)
class Export:
    """Contents of a file, and messages for its reader."""

    data: bytes
    warnings: tuple[Diagnostic, ...] = ()  # assumptions behind the numbers
    notes: tuple[str, ...] = ()  # assumed and projected values
    losses: tuple[Diagnostic, ...] = ()  # parts that the format cannot represent
    check: Check | None = None  # reads the written file
    read_back: ReadBack | None = None  # what it finds; None without the reader

    @property
    def losses_of_version(self) -> tuple[Diagnostic, ...]:
        """Parts for which a later version of the format has an element."""
        return tuple(x for x in self.losses if x.clause.template == "left-out/version")


@dataclass(frozen=True, slots=True)
class IdentifiedArm:
    """A study and the parameters identified for it."""

    study: Study
    parameters: tuple[Parameter, ...]  # of the final table; value None: not identified
    source: str  # file of the parameters, for messages
    warnings: tuple[Diagnostic, ...] = ()  # of every export
    rejected: tuple[str, ...] = ()  # "gear_damping 2": rejected by the verdict, here without value
    # consistent standard parameters of a serial arm, and motor inertias that agree with them
    standard: Values = field(default_factory=dict)
    rigid: RigidModel | None = None  # that predicts torques, with samples of the fitted motion
    estimates: Values = field(default_factory=dict)  # of all stages, also rejected ones
    completion: Values | None = None  # in place of `values`; see `strainwave.export.completion`
    assumptions: tuple[str, ...] = ()  # behind it
    torques: FloatArray | None = None  # of the motors over `rigid.motion`, which exports follow
    covariance: JointCovariance | None = None  # of the estimates; None: they are independent
    # arms drawn from it, for formats with ranges; see `strainwave.export.randomisation`
    draws: tuple[IdentifiedArm, ...] = ()

    @property
    def values(self) -> Values:
        """(name, joint) -> value, including values that follow from the identified ones."""
        return self.complete(self.identified) if self.completion is None else self.completion

    def complete(self, identified: Values) -> Values:
        """Values that follow from identified ones.

        If the viscous friction of the link is not identified, the motor has the total. A serial arm
        has its standard parameters, with the motor inertias of rigid joints.
        """
        totals = self._joints_with_total_friction(identified)
        identified = {
            key: value
            for key, value in identified.items()
            if key[0] != "motor_viscous_friction" or key[1] not in totals
        }
        return complete_values(identified, self.study.arm) | {
            (name, joint): value
            for (name, joint), value in self.standard.items()
            if not (name == MOTOR_INERTIA and joint and self.joint(joint).elastic)
        }

    def need(self, name: str, joint: int | None = None) -> float:
        """The value of a parameter [SI]; `InvalidInput` if it is missing, null or not physical."""
        value = self.values.get((name, joint))
        if value is None:
            matches = [p for p in self.parameters if p.key == (name, joint)]
            if matches and matches[0].label in self.rejected:
                raise self._refuse(name, joint, "rejected by the verdict of the result")
            raise self._refuse(name, joint, "null" if matches else "missing")
        is_rigid = joint is not None and not self.joint(joint).elastic
        if value == 0.0 and is_rigid and name in ("motor_inertia", "link_inertia"):
            return value  # the other side of a rigid gear may have all inertia
        if not is_physical(name, value):
            limit = physical_range(name).replace("non-negative", "zero or positive")
            raise self._refuse(name, joint, f"{value:g} and not {limit}")
        return value

    def with_identified_drives(self) -> IdentifiedArm:
        """The arm with its identified torques per volt in place of unknown ones."""
        arm = self.study.arm
        for number in arm.unknown_drives:
            arm = arm.with_joint(number, torque_per_volt=self.need("torque_per_volt", number))
        return replace(self, study=replace(self.study, arm=arm))

    def joint(self, number: JointNumber) -> Joint:
        """The configuration of a joint; `InvalidInput` if there is none."""
        if not 1 <= number <= self.study.arm.n_joints:
            raise InvalidInput(
                f"there is no joint {number}: the arm has {self.study.arm.n_joints}",
                where=self.source,
                remedy="joints are numbered from 1, from the base",
            )
        return self.study.arm.joints[number - 1]

    def assumed(self) -> tuple[Diagnostic, ...]:
        """Warnings, and assumptions where only a sum of parameters is identified, or a body not."""
        assumptions = [
            Diagnostic("assumed", Place(joint=number), "friction")
            for number in self._joints_with_total_friction(self.identified)
            if self.joint(number).elastic
        ]
        identified, arm = self.identified, self.study.arm
        # the link of a rigid drive has the sum; standard parameters are split by consistency
        is_split = bool(kind_of(arm).standard_rows(arm)) and not is_rigid_drive(arm)
        lumped = lumped_inertias(arm) if is_split else {}
        for (name, number), row in lumped.items():
            parts = {*row, ("link_inertia", number)}
            if (name, number) in identified and identified.keys().isdisjoint(parts):
                names = tuple(part for part, _ in row)
                place = Place(joint=number)
                assumptions.append(Diagnostic("assumed", place, "inertia", parts=names, sum=name))
        columns = base_parameters(arm).columns if self.standard else ()
        labels = tuple(column.label for column in columns if column.key not in identified)
        if labels:
            place = Place(file=self.source)
            assumptions.append(Diagnostic("assumed", place, "bodies", names=labels))
        return (*self.warnings, *assumptions)

    @property
    def identified(self) -> Values:
        """(name, joint) -> value of the final table."""
        return {p.key: p.value for p in self.parameters if p.value is not None}

    def _joints_with_total_friction(self, identified: Values) -> list[int]:
        """Joints whose total viscous friction is identified without the part of the link."""
        return [
            number
            for number in range(1, self.study.arm.n_joints + 1)
            if ("total_viscous_friction", number) in identified
            and ("link_viscous_friction", number) not in identified
        ]

    def _refuse(self, name: str, joint: int | None, problem: str) -> InvalidInput:
        of_joint = f" of joint {joint}" if joint else ""
        return InvalidInput(
            f"{name}{of_joint} is {problem}, and this format needs it",
            where=f"{self.source}: parameters",
            remedy="follow the warnings of the result, or export to json or c",
        )


def read_arm(path: Path | str, study_path: Path | str | None = None) -> IdentifiedArm:
    """Read the arm of a result.json or of a directory that contains one.

    Gear ratios, lengths and torques per volt come from the result. Results of earlier versions do
    not contain them: then, and where `study_path` is given, they come from the study file. The
    study file is searched for in the folder of the result, at the path in the result, relative to
    the folder of the result or one above, and where it was identified. Logs need not exist.
    """
    path = results.result_path(Path(path))
    return arm_of(results.read_document(path), path, study_path)


def arm_of(
    document: Mapping[str, Any],
    path: Path,
    study_path: Path | str | None = None,
    identified: Study | None = None,
) -> IdentifiedArm:
    """The arm of a result document; `path` names it in messages. See `read_arm`.

    `identified` is the study of a result that was not read from a file.
    """
    if not isinstance(document.get("parameters"), list) or not document["parameters"]:
        raise InvalidInput(
            "contains no parameters",
            where=f"{path}: parameters",
            remedy="identify again; the reason in the result states the cause",
        )
    parameters = results.parameters_of(document, str(path))
    study = None if study_path else identified or results.study_of(document, path)
    warnings: tuple[Diagnostic, ...] = ()
    if study is None:
        study, warnings = study_file_of(document, path, study_path)
    elif identified is None and "urdf" in document["study"]:
        study, warnings = _with_urdf(study, document, path)
    _check_parameters(parameters, study, path)
    study = replace(study, arm=study.arm.with_selected_laws([p.key for p in parameters]))
    accepted, rejected = _drop_rejected(parameters, document, path)
    standard = results.standard_parameters_of(document, study.arm, str(path))
    rigid = results.rigid_model_of(document, len(rigid_columns(study.arm)))
    estimates = results.stage_estimates_of(document)
    arm = IdentifiedArm(study, accepted, str(path), warnings, rejected, standard, rigid, estimates)
    return replace(arm, covariance=results.covariance_of(document, str(path)))


def study_file_of(
    document: Mapping[str, Any], path: Path, study_path: Path | str | None = None
) -> tuple[Study, tuple[Diagnostic, ...]]:
    """The study file of a result, and a warning if the file has changed since."""
    entry = document.get("study")
    texts = [entry.get(key) for key in ("path", "sha256")] if isinstance(entry, dict) else []
    if not texts or not all(isinstance(text, str) for text in texts):
        raise InvalidInput(
            "does not name its study file", where=f"{path}: study", remedy=results.NOT_A_RESULT
        )
    named, sha256 = map(str, texts)
    if study_path is None:
        study_path = _find_study(path, named, sha256, _folders(document, path))
    study_file = Path(study_path)
    study = read_study(study_file, logs_exist=False)
    if study.sha256 == sha256:
        return study, ()
    place = Place(file=str(study_file))
    return study, (Diagnostic("study-changed", place, file=str(study_file)),)


def _with_urdf(
    study: Study, document: Mapping[str, Any], path: Path
) -> tuple[Study, tuple[Diagnostic, ...]]:
    """The study with the URDF that places its joints; a warning if there is no such file."""
    entry = document["study"]["urdf"]
    file, held = str(entry.get("file")), tuple(entry.get("held", ()))
    for folder in _folders(document, path):
        for found in (folder / study.path.parent / file, folder / file):
            if _is_file(found):
                joints = read_urdf(found, held)
                if [joint.name for joint in joints] == list(study.arm.joint_names):
                    urdf = Urdf(str(found.resolve()), tuple(j.prior for j in joints), held)
                    return replace(study, arm=replace(study.arm, urdf=urdf)), ()
    return study, (Diagnostic("no-urdf", Place(file=str(path)), file=file),)


def _folders(document: Mapping[str, Any], path: Path) -> list[Path]:
    """Folder of a result and those above; then that of the study when it was identified."""
    folder = document["study"].get("folder")
    return [*path.resolve().parents, *([Path(folder)] if isinstance(folder, str) else [])]


def _drop_rejected(
    parameters: Sequence[Parameter], document: Mapping[str, Any], path: Path
) -> tuple[tuple[Parameter, ...], tuple[str, ...]]:
    """Parameters with rejected and impossible values set to None, and the labels of these."""
    verdict = document.get("verdict", {})
    labels = verdict.get("rejected", []) if isinstance(verdict, dict) else None
    if not isinstance(labels, list) or not all(isinstance(label, str) for label in labels):
        raise InvalidInput(
            "is not a list of names", where=f"{path}: verdict.rejected", remedy=results.NOT_A_RESULT
        )
    impossible = [p.label for p in parameters if p.value and not is_physical(p.name, p.value)]
    rejected = tuple(dict.fromkeys([*labels, *impossible]))
    accepted = tuple(
        replace(p, value=None, std=None, ci95=None) if p.label in rejected else p
        for p in parameters
    )
    return accepted, rejected


def _check_parameters(parameters: Sequence[Parameter], study: Study, path: Path) -> None:
    """Check that names are unique identifiers, and that the arm has their joints.

    The name of a record may follow in brackets.
    """
    labels = [parameter.label for parameter in parameters]
    for k, parameter in enumerate(parameters):
        problem, remedy, joint = "", results.NOT_A_RESULT, parameter.joint
        if not re.fullmatch(r"[a-z][a-z0-9_]*(\[.*\])?", parameter.name):
            problem = f"{parameter.name!r} is not a parameter name"
        elif parameter.label in labels[:k]:
            problem = f"{parameter.label} is listed twice"
        elif joint is not None and not 1 <= joint <= study.arm.n_joints:
            problem = (
                f"{parameter.name} belongs to joint {joint}, but the arm of {study.path} has "
                f"{study.arm.n_joints}"
            )
            remedy = "give the study that was identified, with --study"
        if problem:
            place = f"{path}: parameters, entry {k + 1}"
            raise InvalidInput(problem, where=place, remedy=remedy)


def _find_study(path: Path, named: str, sha256: str, folders: Sequence[Path]) -> Path:
    """The study file, preferably the one with the hash in the result."""
    candidates = [folders[0] / Path(named).name, *(folder / named for folder in folders)]
    candidates += [Path(named), folders[-1] / Path(named).name]
    existing = [candidate for candidate in candidates if _is_file(candidate)]
    same = [c for c in existing if hashlib.sha256(read_bytes(c, "study")).hexdigest() == sha256]
    if existing:
        return (same or existing)[0]
    raise InvalidInput(
        f"the study file {named!r} does not exist any more",
        where=f"{path}: study",
        remedy="name it with --study STUDY.toml",
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # not a valid file name
        return False


GEAR, SENSORS, ERRORS = "gear", "sensors", "standard deviations and correlations"
LINEAR = (
    *("motor_inertia", "motor_viscous_friction", "link_viscous_friction"),
    *(GEAR, "gravity", "transmission"),
)
"""Parts of a linear model of the whole arm."""

CORRELATIONS = Diagnostic("left-out", Place(), "part", part="correlations between parameters")
"""Loss of formats that contain standard deviations."""


def losses(arm: IdentifiedArm, held: Collection[str]) -> tuple[Diagnostic, ...]:
    """The parts of an arm that are not `held`, with their joints.

    Parts are parameters, effects and keys of the study by name, and all of `GEAR`, `SENSORS`. Every
    format has the links, and sums of parameters.
    """
    parts: dict[str, set[int]] = {}
    for p in arm.parameters:
        name = base_name(p.name)
        is_sum = name == "total_viscous_friction" or family_of(name) in ("inertia", "gravity")
        if p.value is not None and (not is_sum or name == "motor_inertia"):
            is_gear = name == "gear_damping" or name in gear_parameters()
            part = GEAR if is_gear else SENSORS if name in sensor_constants() else name
            parts.setdefault(part, set()).update(() if p.joint is None else (p.joint,))
    for number, joint in enumerate(arm.study.arm.joints, start=1):
        drive = [key for key in ("torque_per_volt", "current_loop_hz") if getattr(joint, key)]
        has_sensor = any(getattr(joint, key) for key in ("encoder_counts", *key_texts()))
        for part in (*joint.named_effects, *drive, *[SENSORS] * has_sensor):
            parts.setdefault(part, set()).add(number)
    description = arm.study.arm
    present = {
        "gravity": description.gravity,
        "transmission": description.is_coupled,
        "servo": description.servo or description.position_servo,
        ERRORS: True,
    }
    parts |= {part: set() for part, value in present.items() if value}
    return tuple(loss(part, sorted(joints)) for part, joints in parts.items() if part not in held)


def loss(part: str, joints: Sequence[int] = (), variant: str = "", /, **values: Any) -> Diagnostic:
    """A part of some joints that a format cannot represent; `values` are those of the variant."""
    places = tuple(Place(joint=number) for number in joints) or Place()
    return Diagnostic("left-out", places, variant or "part", part=part, **values)


def loss_note(losses: Iterable[Diagnostic]) -> tuple[str, ...]:
    """One note on all losses, for a comment in the file; none without losses."""
    listed = [each.observation + (f" ({each.where})" if each.where else "") for each in losses]
    return (f"lost: {', '.join(listed)}",) if listed else ()


def sentence_of(note: str) -> str:
    """Note as a sentence."""
    return f"{note[:1].upper()}{note[1:]}."


def numbers(*values: float) -> str:
    """Numbers separated by blanks, with all digits."""
    return " ".join(repr(float(value) + 0.0) for value in values)  # no -0.0


def comment_text(text: str) -> str:
    """Text of a comment; two hyphens in a row, which XML forbids, become one."""
    return text.replace("--", "-")
