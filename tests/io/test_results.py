"""result.json: keys of the contract, finite numbers, and records read back."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from elastic_results import elastic_identification, joint_model
from results import arm_model, identification
from strainwave import pipeline
from strainwave.domain import (
    Clause,
    Correction,
    Parameter,
    Place,
    RigidModel,
    SearchEnd,
    Suspicion,
)
from strainwave.errors import InvalidInput
from strainwave.io import results as result
from strainwave.report import document


def rigid(model: RigidModel | None) -> RigidModel:
    assert model is not None
    return model


def test_keys_of_the_contract() -> None:
    document = json.loads(result.to_json(result.to_document(identification())))
    assert document["schema"] == "strainwave/result/1"
    assert {"version", "study", "created", "parameters", "stages", "checks", "warnings"} <= set(
        document
    )
    assert {"path", "sha256", "arm", "joint"} <= set(document["study"])
    assert set(document["parameters"][0]) == {
        "name",
        "joint",
        "value",
        "std",
        "ci95",
        "unit",
        "stage",
    }
    assert set(document["stages"]) == {"rigid"}
    stage = document["stages"]["rigid"]
    assert stage["parameters"] == document["parameters"]
    assert stage["fit_percent"] == {"motion": {"torque1": 97.5}}
    assert stage["condition_number"] == 12.5
    assert stage["torque_ratio"] is None
    assert document["checks"] == [
        {"experiment": "check", "fit_percent": {"torque1": 91.25, "torque2": None}}
    ]
    assert document["status"] == "not-determined"  # an inertia, but of two links
    assert document["verdict"]["identified"] == ["inertia 1"]
    assert document["verdict"]["not_identified"][:2] == ["friction_offset 1", "rigid_inertia 1"]
    assert document["verdict"]["validated"] == {"rigid": True, "elastic": False}
    assert document["verdict"]["rejected"] == document["verdict"]["suspected"] == []


def test_a_verdict_is_read_back_with_its_texts() -> None:
    fault = Suspicion(
        code="wrong-gear-ratio",
        places=(Place(joint=2, key="gear_ratio"),),
        clause=Clause("wrong-gear-ratio", joint=2, factor=0.5, stated=0.01, ratio=0.005),
        remedy_clause=Clause("remedy", steps=(Clause("step/remove", key="k", table="[arm]"),)),
        factor=2.0,
        corrections=(Correction("joint", "2", "gear_ratio", 0.005),),
    )
    verdict = replace(identification(), suspected=(fault,)).verdict
    document = result.to_document(replace(identification(), suspected=(fault,)))
    (entry,) = document["verdict"]["suspected"]
    assert list(entry) == ["code", "where", "message", "remedy", "factor", "corrections"]
    assert (entry["where"], entry["remedy"]) == ("joint 2 gear_ratio", "Remove k from [arm]")
    again = result.verdict_of(json.loads(result.to_json(document)))
    assert (again.identified, again.not_identified) == (verdict.identified, verdict.not_identified)
    assert again.reasons == verdict.reasons
    (read,) = again.suspected
    texts = (read.where, read.message, read.remedy)
    assert texts == (fault.where, fault.message, fault.remedy)
    assert (read.factor, read.delay_s, read.corrections) == (2.0, None, fault.corrections)


def test_the_rig_is_read_back() -> None:
    one = identification()
    study = result.study_of(json.loads(result.to_json(result.to_document(one))), Path("r.json"))
    assert study is not None
    assert study.arm == one.study.arm
    assert study.sha256 == one.study.sha256
    assert result.study_of({"study": {"path": "study.toml", "sha256": ""}}, Path("r.json")) is None


def test_a_torque_behind_the_gear_is_read_back() -> None:
    one = identification()
    arm = one.study.arm.with_joint(1, torque_at_link=True)
    document = result.to_document(replace(one, study=replace(one.study, arm=arm)))
    study = result.study_of(json.loads(result.to_json(document)), Path("r.json"))
    assert study is not None
    assert study.arm == arm


def test_reasons_are_read_back_one_by_one() -> None:
    """A reason may contain the separator of the key `reason`."""
    document = result.to_document(identification())
    reasons = ["one; two", "three"]
    document["verdict"]["reasons"], document["reason"] = reasons, "; ".join(reasons)
    assert result.verdict_of(document).reasons == tuple(reasons)
    del document["verdict"]["reasons"]  # as in results of earlier versions
    assert result.verdict_of(document).reasons == ("one; two; three",)


def test_motor_response_models_have_one_entry_per_record() -> None:
    joint = replace(joint_model(), method="motor-response", experiments=("a", "b"))
    found = replace(elastic_identification(), records=(), sweeps=(), joints=(joint,))
    document = result.to_document(found)
    entries = document["stages"]["decoupled"]
    assert [entry["experiment"] for entry in entries] == ["a", "b"]
    assert all(entry["state_space"] is None for entry in entries)
    assert joint.anti_resonance is not None
    assert entries[0]["anti_resonance_hz"] == joint.anti_resonance.frequency_hz
    assert entries[0]["fit_percent"] == list(joint.fit_percent.values())


def test_numbers_that_are_not_finite_are_null() -> None:
    one = identification()
    model = replace(rigid(one.rigid), condition_number=np.inf)
    unknown = Parameter("gamma", None, None, None, "kg m^2", "rigid")
    text = result.to_json(
        result.to_document(replace(one, rigid=replace(model, parameters=(unknown,))))
    ).decode()
    assert "Infinity" not in text
    assert "NaN" not in text
    document = json.loads(text)
    assert document["stages"]["rigid"]["condition_number"] is None
    assert document["parameters"][0]["value"] is None
    assert document["parameters"][0]["ci95"] is None


def test_torque_ratios_are_published_by_joint() -> None:
    one, ratios = identification(), {2: (0.98, 0.004), 3: (1.1, 0.2)}
    ratio = replace(one, rigid=replace(rigid(one.rigid), torque_ratios=ratios))
    stage = json.loads(result.to_json(result.to_document(ratio)))["stages"]["rigid"]
    second, third = stage["torque_ratios"]
    assert stage["torque_ratio"] == second == {"joint": 2, "value": 0.98, "std": 0.004}
    assert third == {"joint": 3, "value": 1.1, "std": 0.2}
    text = "0.9800 ± 0.004; 1 if both torque constants are correct"
    assert text in document.render(ratio)
    assert text not in document.render(one)


def test_the_end_of_the_search_is_published() -> None:
    stalled = replace(arm_model((), np.zeros((0, 0))), end=SearchEnd.STALLED)
    document = result.to_document(replace(identification(), whole_arm=stalled))
    stage = json.loads(result.to_json(document))["stages"]["tuned"]
    assert (stage["status"], stage["end"]) == ("converged", "stalled")


def test_numpy_numbers_become_json_numbers() -> None:
    one = identification()
    model = replace(rigid(one.rigid), condition_number=float(np.float64(3.5)))
    document = json.loads(result.to_json(result.to_document(replace(one, rigid=model))))
    assert document["stages"]["rigid"]["condition_number"] == 3.5


def test_both_files_are_written_or_none(tmp_path: Path) -> None:
    pipeline.write(identification(), tmp_path / "out")
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == ["report.html", "result.json"]
    document = json.loads((tmp_path / "out" / "result.json").read_text())
    assert document["timing_s"]["report"] > 0.0
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInput, match="cannot write"):
        pipeline.write(identification(), tmp_path / "file")
    assert (tmp_path / "file").read_text() == ""


def test_stages_are_a_prefix_of_all_stages() -> None:
    assert pipeline.check_stages(["rigid"]) == ("rigid",)
    for wrong in ([], ["tuned"], ["rigid", "rigid"]):
        with pytest.raises(InvalidInput, match="--stages"):
            pipeline.check_stages(wrong)


def reported(name: str, value: float | None, std: float | None, joint: int = 1) -> Parameter:
    return Parameter(name, joint, value, std, "-", "tuned")


def test_the_whole_arm_fit_takes_precedence() -> None:
    """Its value replaces one with a smaller standard deviation; so does its null."""
    one = identification()
    whole_arm = arm_model(
        (reported("inertia", 0.03, 0.01), reported("gear_damping", None, None)),
        np.diag([1e-4, np.inf]),
    )
    found = {p.name: p for p in replace(one, whole_arm=whole_arm).parameters}
    assert (found["inertia"].value, found["inertia"].stage) == (0.03, "tuned")
    assert found["gear_damping"].value is None
    silent = arm_model((reported("inertia", None, None),), np.eye(1))
    found = {p.name: p for p in replace(one, whole_arm=silent).parameters}
    assert (found["inertia"].value, found["inertia"].stage) == (None, "tuned")


def test_one_stiffness_is_not_listed_with_three_slopes() -> None:
    one = identification(name="gear_stiffness")
    arm = one.study.arm
    bent = arm.with_joints(replace(joint, spring="three-slope") for joint in arm.joints)
    one = replace(one, study=replace(one.study, arm=bent))
    slopes = tuple(reported(f"gear_stiffness_k{k}", 1e4 * k, 10.0) for k in (1, 2, 3))
    names = [p.name for p in replace(one, whole_arm=arm_model(slopes, np.eye(3))).parameters]
    assert "gear_stiffness" not in names
    assert [name for name in names if "stiffness" in name] == [p.name for p in slopes]
    # the curve of joint 2 leaves the stiffness of joint 1
    other = tuple(replace(p, joint=2) for p in slopes)
    names = [p.name for p in replace(one, whole_arm=arm_model(other, np.eye(3))).parameters]
    assert "gear_stiffness" in names


def test_correlations_of_the_whole_arm_fit() -> None:
    parameters = (reported("a", 1.0, 2.0), reported("b", 1.0, 3.0), reported("c", 0.0, 0.0))
    covariance = np.array([[4.0, -3.0, 0.0], [-3.0, 9.0, 0.0], [0.0, 0.0, 0.0]])
    one = replace(identification(), whole_arm=arm_model(parameters, covariance))
    whole_arm = json.loads(result.to_json(result.to_document(one)))["stages"]["tuned"]
    assert whole_arm["correlations"] == [[1.0, -0.5, 0.0], [-0.5, 1.0, 0.0], [0.0, 0.0, 0.0]]
    assert [p["name"] for p in whole_arm["parameters"]] == ["a", "b", "c"]
    assert (whole_arm["status"], whole_arm["iterations"]) == ("converged", 7)
    assert whole_arm["fit_percent"]["prbs-j1"]["omega_m1"] == 99.0


def test_a_parameter_without_variance_has_no_correlation() -> None:
    parameters = (reported("a", 1.0, 2.0), reported("b", None, None))
    vague = arm_model(parameters, np.array([[4.0, 0.0], [0.0, np.inf]]))
    document = json.loads(
        result.to_json(result.to_document(replace(identification(), whole_arm=vague)))
    )
    assert document["stages"]["tuned"]["correlations"][0][0] == 1.0


def test_residual_analysis_is_reported_without_spectra() -> None:
    whole_arm = arm_model((reported("a", 1.0, 2.0),), np.array([[4.0]]))
    document = json.loads(
        result.to_json(result.to_document(replace(identification(), whole_arm=whole_arm)))
    )
    criticism = document["stages"]["tuned"]["criticism"]
    (residual,) = criticism["residuals"]
    assert (residual["channel"], residual["noise"], residual["input_delay"]) == ("a1", 0.1, 0.006)
    assert "density" not in residual
