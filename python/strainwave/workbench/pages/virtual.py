"""Page "Virtual arm": record and identify a simulated arm whose parameters are known."""

from __future__ import annotations

import json
import shutil
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any, Literal

from starlette.requests import Request
from starlette.responses import Response

from strainwave.api import read_result
from strainwave.domain import Study
from strainwave.domain.arm.gear_laws import is_slope
from strainwave.domain.keys import Values, label_of
from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_parameters
from strainwave.io.study import read_study, write_study
from strainwave.virtual.experiments import derived
from strainwave.virtual.scara import MAX_DISKS, SOFT
from strainwave.workbench.pages.by_hand import parameter_document
from strainwave.workbench.pages.runs import describe, file_of_run
from strainwave.workbench.runs import Runs
from strainwave.workbench.web import Body, Routes, page, study_of, workspace_of

Spring = Literal["linear", "three-slope"]
KNEES = ("gear_knee_t1", "gear_knee_t2")
FRICTION = ("motor_coulomb_friction", "motor_viscous_friction", "link_viscous_friction")


@dataclass(frozen=True, slots=True)
class Setting:
    """One slider of the virtual arm."""

    key: str
    title: str
    unit: str
    value: float
    low: float
    high: float
    step: float


SETTINGS = (
    Setting("disks", "Payload", "disks of 1 kg", 5, 0, MAX_DISKS, 1),
    Setting("stiffness", "Gear stiffness", "times the usual", 1.0, 0.5, 2.0, 0.05),
    Setting("knees", "Knee torques of the gears", "times the usual", 1.0, 0.5, 2.0, 0.05),
    Setting("friction", "Friction", "times the usual", 1.0, 0.0, 3.0, 0.05),
    Setting("amplitude", "Amplitude of the PRBS", "V", 10.0, 1.0, 10.0, 0.5),
    Setting("encoder_bits", "Resolution of the motor encoders", "bits per turn", 13, 10, 20, 1),
)
SENSORS = (
    ("accelerometers", "Accelerometers on the links", True),
    ("gyros", "Gyros on the links", True),
    ("link_encoders", "Encoders of the link angles (20 bits per turn)", False),
    ("noise", "Noise of the sensors", True),
)
_LINK_COUNTS = 2**20


@dataclass(frozen=True, slots=True)
class VirtualRig:
    """A study of the virtual arm, and its true parameters."""

    study: Study
    values: Values
    has_noise: bool


def virtual_rig(body: Any, folder: Path) -> VirtualRig:
    """The virtual arm with the settings of a request.

    Raises InvalidInput if a setting is missing or out of its range.
    """
    sizes = {setting.key: _size(body, setting) for setting in SETTINGS}
    sensors = {key: body.get(key) is True for key, _, _ in SENSORS}
    spring: Spring = "linear" if body.get("spring") == "linear" else "three-slope"
    values = SOFT.parameters(int(sizes["disks"]), spring)
    for name, joint in values:
        if is_slope(name):
            values[name, joint] *= sizes["stiffness"]
        elif name in KNEES:
            values[name, joint] *= sizes["knees"]
        elif name in FRICTION:
            values[name, joint] *= sizes["friction"]
    study = SOFT.study(folder, spring)
    absent: dict[str, Any] = {} if sensors["gyros"] else {"gyro_hz": None}
    if not sensors["accelerometers"]:
        absent |= {"accelerometer_distance": None, "accelerometer_hz": None}
    joints = tuple(
        replace(
            joint,
            encoder_counts=2 ** int(sizes["encoder_bits"]),
            link_encoder_counts=_LINK_COUNTS if sensors["link_encoders"] else None,
            **absent,
        )
        for joint in study.arm.joints
    )
    experiments = tuple(
        replace(one, prbs=replace(one.prbs, amplitude=sizes["amplitude"])) if one.prbs else one
        for one in study.experiments
    )
    arm = replace(study.arm, joints=joints)
    return VirtualRig(replace(study, arm=arm, experiments=experiments), values, sensors["noise"])


def _size(body: Any, setting: Setting) -> float:
    value = body.get(setting.key, setting.value)
    if not isinstance(value, int | float) or not setting.low <= value <= setting.high:
        raise InvalidInput(
            f"{setting.title} is {value!r}",
            remedy=f"set {setting.low:g} to {setting.high:g} {setting.unit}",
        )
    return float(value)


def estimates_against_truth(study_path: Path, result: Path, truth: Path) -> list[dict[str, Any]]:
    """Each parameter of a result with its true value and its error."""
    values = derived(read_parameters(truth), read_study(study_path).arm)
    rows = []
    for each in read_result(result):
        if each.key not in values:
            continue
        true, value, std = values[each.key], each.value, each.std
        error = None if value is None else value - true
        rows.append(
            {
                "label": label_of(*each.key),
                "unit": each.unit,
                "true": true,
                "value": value,
                "ci95": each.ci95,
                "percent": 100.0 * error / abs(true) if error is not None and true else None,
                "stds": error / std if error is not None and std else None,
            }
        )
    return rows


routes = Routes()

_RUN, _RIG, _TRUTH = "record-and-identify", "rig.toml", "truth.json"


@routes.page("/virtual")
def _show_virtual(request: Request) -> Response:
    return page(request, "virtual", "Virtual arm", settings=SETTINGS, sensors=SENSORS)


@routes.post("/api/virtual")
def record_and_identify(request: Request, body: Body) -> object:
    """Simulate the records of a virtual arm in a new folder, and identify it from them."""
    workspace = workspace_of(request)
    for number in count(1):
        folder = workspace.folder / f"virtual-{number}"
        with suppress(FileExistsError):
            folder.mkdir()
            break
    try:
        rig = virtual_rig(body, folder)
        runs = Runs(folder / "study.toml")
        run_folder = runs.prepare(_RUN)
        write_study(rig.study, folder / "study.toml")
        write_study(rig.study, run_folder / _RIG)
        truth = json.dumps(parameter_document(rig.values), indent=1)
        simulate = ["simulate", _RIG, "--parameters", _TRUTH, "--out", "../.."]
        commands = [
            simulate if rig.has_noise else [*simulate, "--ideal"],
            ["identify", "../../study.toml", "--out", "."],
        ]
        run = runs.start(_RUN, "virtual", commands, files={_TRUTH: truth.encode()})
    except (InvalidInput, OSError):
        shutil.rmtree(folder, ignore_errors=True)
        raise
    return describe(run) | {"study": workspace.relative(folder / "study.toml")}


@routes.get("/api/virtual/{study:path}")
def show_result(request: Request) -> object:
    """Estimates, true values and verdict of a finished run."""
    path = study_of(request)
    result, truth = (file_of_run(request, _RUN, name) for name in ("result.json", _TRUTH))
    rows = estimates_against_truth(path, result, truth)
    return {"rows": rows, "status": read_result(result).status, "run": _RUN}
