"""result.json and its study -> the arm to export, every fault named by file, place and remedy."""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from strainwave.domain import Diagnostic, Joint, Parameter, Study, is_physical, physical_range
from strainwave.domain.parameters import Values, completed
from strainwave.errors import InvalidInput
from strainwave.io.atomic_files import read_bytes
from strainwave.io.results import NOT_A_RESULT, read_document
from strainwave.io.study import read_study


@dataclass(frozen=True, slots=True)
class Export:
    """A file's contents, and what its reader must know."""

    data: bytes
    warnings: tuple[Diagnostic, ...] = ()


@dataclass(frozen=True, slots=True)
class IdentifiedArm:
    """What is exported: a study and the parameters found for it."""

    study: Study
    parameters: tuple[Parameter, ...]  # the best of each; None is what was not identified
    source: str  # where they come from, for messages
    warnings: tuple[Diagnostic, ...] = ()  # what the reader of any export must know
    rejected: tuple[str, ...] = ()  # "gear_damping 2": values that the verdict rejects, here null

    @property
    def values(self) -> Values:
        """(name, joint) -> value, with what follows from what was identified.

        Of viscous friction, whose sum is known better than its parts, the motor has all where the
        link's is not known.
        """
        identified = self._identified()
        for number in self._lumped():
            identified.pop(("motor_viscous_friction", number), None)
        return completed(identified, self.study.arm)

    def need(self, name: str, joint: int | None = None) -> float:
        """The value of a parameter that cannot be done without.

        Parameters
        ----------
        name : str
            As in docs/notation.md.
        joint : int, optional
            From 1; None for the arm's own.

        Returns
        -------
        float [SI]

        Raises
        ------
        InvalidInput
            It is null or not there, or has a sign that no arm has.
        """
        value = self.values.get((name, joint))
        if value is None:
            own = [p for p in self.parameters if (p.name, p.joint) == (name, joint)]
            if own and own[0].label in self.rejected:
                raise self._refuse(name, joint, "rejected by the result's verdict")
            raise self._refuse(name, joint, "null" if own else "not there")
        merged = joint is not None and not self.joint(joint).elastic
        if value == 0.0 and merged and name in ("motor_inertia", "link_inertia"):
            return value  # it may be counted with the other side's
        if not is_physical(name, value):
            least = physical_range(name).replace("non-negative", "zero or positive")
            raise self._refuse(name, joint, f"{value:g} and not {least}")
        return value

    def joint(self, number: int) -> Joint:
        """A joint's configuration, by its number from 1.

        Raises
        ------
        InvalidInput
            There is no such joint.
        """
        if not 1 <= number <= self.study.arm.n_joints:
            raise InvalidInput(
                f"there is no joint {number}: the arm has {self.study.arm.n_joints}",
                where=self.source,
                remedy="joints are numbered from 1, from the base",
            )
        return self.study.arm.joints[number - 1]

    def assumed(self) -> tuple[Diagnostic, ...]:
        """Where a known sum stands for its parts, which models with forces of both need."""
        message = (
            "link_viscous_friction is not known: the model has all viscous friction, "
            "total_viscous_friction, at the motor"
        )
        found = [
            Diagnostic("assumed", f"joint {number}", message)
            for number in self._lumped()
            if self.joint(number).elastic  # motor and link of which are one
        ]
        leads = {("alpha", None), ("link_inertia", 1), ("motor_inertia", 1)}
        identified = self._identified()
        if ("rigid_inertia", 1) in identified and not identified.keys() & leads:
            message = (
                "of alpha and motor_inertia only rigid_inertia is known; their split is made up"
            )
            found.append(Diagnostic("assumed", "joint 1", message))
        return tuple(found)

    def _identified(self) -> Values:
        return {(p.name, p.joint): p.value for p in self.parameters if p.value is not None}

    def _lumped(self) -> list[int]:
        """Joints of whose viscous friction only the sum is known, or the sum and the motor's."""
        identified = self._identified()
        return [
            number
            for number in range(1, self.study.arm.n_joints + 1)
            if ("total_viscous_friction", number) in identified
            and ("link_viscous_friction", number) not in identified
        ]

    def _refuse(self, name: str, joint: int | None, problem: str) -> InvalidInput:
        of = f" of joint {joint}" if joint else ""
        return InvalidInput(
            f"{name}{of} is {problem}, and this format needs it",
            where=f"{self.source}: parameters",
            remedy="see the result's warnings for what to record, or export to json or c",
        )


def read_result(path: Path | str, study_path: Path | str | None = None) -> IdentifiedArm:
    """Read a result.json and the study it belongs to.

    Parameters
    ----------
    path : Path
    study_path : Path, optional
        Where the study file is now; None: beside the result or where the result says, relative to
        its folder or one above. Logs need not be there.

    Returns
    -------
    IdentifiedArm

    Raises
    ------
    InvalidInput
        A file is missing, is not what it should be, or the two do not belong together.
    """
    path = Path(path)
    document = _document(path)
    parameters = _parameters(document["parameters"], path)
    named, sha256 = _named_study(document, path)
    study_file = _find_study(path, named, sha256, study_path)
    study = read_study(study_file, logs_exist=False)
    _check_joints(parameters, study, path)
    warnings: tuple[Diagnostic, ...] = ()
    if study.sha256 != sha256:
        message = (
            f"{study_file} is not the study file as it was identified; "
            "its ratios, lengths and torques per volt are taken as they are now"
        )
        warnings = (Diagnostic("study-changed", str(study_file), message),)
    kept, rejected = _without_rejected(parameters, document, path)
    return IdentifiedArm(study, kept, str(path), warnings, rejected)


def _without_rejected(
    parameters: Sequence[Parameter], document: dict[str, Any], path: Path
) -> tuple[tuple[Parameter, ...], tuple[str, ...]]:
    """Null in place of what the verdict rejects, and of what no arm can have."""
    verdict = document.get("verdict", {})
    listed = verdict.get("rejected", []) if isinstance(verdict, dict) else None
    if not isinstance(listed, list) or not all(isinstance(label, str) for label in listed):
        raise InvalidInput(
            "is no list of names", where=f"{path}: verdict.rejected", remedy=NOT_A_RESULT
        )
    impossible = [p.label for p in parameters if p.value and not is_physical(p.name, p.value)]
    rejected = tuple(dict.fromkeys([*listed, *impossible]))
    kept = tuple(
        replace(p, value=None, std=None, ci95=None) if p.label in rejected else p
        for p in parameters
    )
    return kept, rejected


def _document(path: Path) -> dict[str, Any]:
    document = read_document(path)
    if not isinstance(document.get("parameters"), list) or not document["parameters"]:
        raise InvalidInput(
            "holds no parameters",
            where=f"{path}: parameters",
            remedy="identify again; the result's reason says what was missing",
        )
    return document


def _parameters(entries: list[Any], path: Path) -> tuple[Parameter, ...]:
    from pydantic import TypeAdapter, ValidationError

    adapter = TypeAdapter(Parameter)
    found: dict[tuple[str, int | None], Parameter] = {}
    for number, entry in enumerate(entries, start=1):
        place = f"{path}: parameters, entry {number}"
        try:
            parameter = adapter.validate_json(json.dumps(entry), strict=True)
        except ValidationError as error:
            first = error.errors()[0]
            key = ".".join(str(part) for part in first["loc"]) or "the entry"
            said = first["msg"].replace("Input should be ", "it should be ")
            raise InvalidInput(
                f"'{key}' is at fault: {said[0].lower() + said[1:]}",
                where=place,
                remedy=NOT_A_RESULT,
            ) from error
        _check_entry(parameter, place)
        if (parameter.name, parameter.joint) in found:
            raise InvalidInput(f"{parameter.name} is there twice", where=place, remedy=NOT_A_RESULT)
        found[parameter.name, parameter.joint] = parameter
    return tuple(found.values())


def _check_entry(parameter: Parameter, place: str) -> None:
    """Numbers are finite, and a name can be one in other languages."""
    if not re.fullmatch(r"[a-z][a-z0-9_]*", parameter.name):
        raise InvalidInput(
            f"{parameter.name!r} is no parameter's name", where=place, remedy=NOT_A_RESULT
        )
    for number in (parameter.value, parameter.std):
        if number is not None and not math.isfinite(number):
            raise InvalidInput(
                f"{number!r} is no finite number", where=place, remedy="write a number or null"
            )


def _named_study(document: dict[str, Any], path: Path) -> tuple[str, str]:
    entry = document.get("study")
    texts = [entry.get(key) for key in ("path", "sha256")] if isinstance(entry, dict) else []
    if not texts or not all(isinstance(text, str) for text in texts):
        raise InvalidInput(
            "does not name its study file", where=f"{path}: study", remedy=NOT_A_RESULT
        )
    named, sha256 = map(str, texts)
    return named, sha256


def _find_study(path: Path, named: str, sha256: str, given: Path | str | None) -> Path:
    """The study file as it was identified, from the result's folder upwards.

    The path in a result is as it was given to `identify`, relative to the folder in which that ran:
    one above the result, as a rule, whatever the folder in which this runs.
    """
    if given is not None:
        return Path(given)
    folders = [path.resolve().parent, *path.resolve().parent.parents]
    candidates = [
        folders[0] / Path(named).name,
        *(folder / named for folder in folders),
        Path(named),
    ]
    there = [candidate for candidate in candidates if _is_file(candidate)]
    same = [c for c in there if hashlib.sha256(read_bytes(c, "the study")).hexdigest() == sha256]
    if there:
        return (same or there)[0]
    raise InvalidInput(
        f"the study file {named!r} is not there any more",
        where=f"{path}: study",
        remedy="name it with --study STUDY.toml",
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):  # a name no file can have
        return False


def _check_joints(parameters: Sequence[Parameter], study: Study, path: Path) -> None:
    for number, parameter in enumerate(parameters, start=1):
        joint = parameter.joint
        if joint is not None and not 1 <= joint <= study.arm.n_joints:
            raise InvalidInput(
                f"{parameter.name} belongs to joint {joint}, but the arm of {study.path} has "
                f"{study.arm.n_joints}",
                where=f"{path}: parameters, entry {number}",
                remedy="give the study that was identified, with --study",
            )
