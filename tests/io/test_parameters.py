"""Parameter files: both layouts, and what is refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from strainwave.domain import Joint
from strainwave.domain.arm.description import unit_of
from strainwave.domain.arm.parameters import complete_values
from strainwave.errors import InvalidInput
from strainwave.io.parameters import read_assumptions, read_parameters, read_torque_errors
from strainwave.virtual import experiments as virtual
from strainwave.virtual import scara


def _write(tmp_path: Path, document: Any) -> Path:
    path = tmp_path / "p.json"
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def test_reads_the_list_of_a_result_without_nulls(tmp_path: Path) -> None:
    path = _write(
        tmp_path,
        {
            "parameters": [
                {"name": "beta", "joint": None, "value": 0.5, "std": None},
                {"name": "gear_damping", "joint": 2, "value": 4},
                {"name": "gamma", "joint": None, "value": None},
            ]
        },
    )
    assert read_parameters(path) == {("beta", None): 0.5, ("gear_damping", 2): 4.0}


def test_reads_the_standard_parameters_of_a_serial_arm(tmp_path: Path) -> None:
    """They replace the combinations of the list, which have the names of their first parameters."""
    entries = [{"name": "link_first_moment_x", "joint": 2, "value": 0.7}]
    standard = {"m1": 3.0, "mx2": 0.5, "Iyz12": 0.1, "motor_inertia3": 1e-4}
    path = _write(tmp_path, {"parameters": entries, "standard_parameters": standard})
    assert read_parameters(path) == {
        ("link_mass", 1): 3.0,
        ("link_first_moment_x", 2): 0.5,
        ("link_inertia_yz", 12): 0.1,
        ("motor_inertia", 3): 1e-4,
    }


def test_reads_the_torque_errors_of_a_result(tmp_path: Path) -> None:
    rigid = {"torque_errors": [{"joint": 2, "value": 0.03}]}
    path = _write(tmp_path, {"parameters": [], "stages": {"rigid": rigid}})
    assert read_torque_errors(path) == {2: 0.03}
    assert read_torque_errors(_write(tmp_path, {"parameters": [], "stages": None})) == {}
    rigid["torque_errors"] = [{"value": 0.03}]
    with pytest.raises(
        InvalidInput, match=r"p\.json: stages\.rigid\.torque_errors, entry 1: 'joint'"
    ):
        read_torque_errors(_write(tmp_path, {"parameters": [], "stages": {"rigid": rigid}}))


def test_reads_what_the_rigid_model_has_for_parameters_without_value(tmp_path: Path) -> None:
    """A joint that moves in one direction has the sum of Coulomb friction and offset."""

    def entry(name: str, value: float | None) -> dict[str, Any]:
        std = None if value is None else 0.1
        bounds = None if value is None else [value - 0.2, value + 0.2]
        units = {"std": std, "ci95": bounds, "unit": "N m", "stage": "rigid"}
        return {"name": name, "joint": 5, "value": value, **units}

    entries = [entry("motor_coulomb_friction", None), entry("total_viscous_friction", 2.0)]
    rigid = {
        "parameters": entries,
        "bandwidth_hz": 5.0,
        "decimation": 4,
        "n_rows": 100,
        "status": "partly-determined",
        "prediction": {"solution": [1.5, 2.0], "friction_terms": [], "motion": [[], [], []]},
    }
    path = _write(tmp_path, {"parameters": entries, "stages": {"rigid": rigid}})
    with pytest.raises(InvalidInput, match="motion"):
        read_assumptions(path)
    rigid["prediction"]["motion"] = [[[0.0]]] * 3  # type: ignore[index]
    path = _write(tmp_path, {"parameters": entries, "stages": {"rigid": rigid}})
    assert read_assumptions(path) == {("motor_coulomb_friction", 5): 1.5}
    assert read_assumptions(_write(tmp_path, {"parameters": entries, "stages": None})) == {}


def test_reads_a_table_of_known_values(tmp_path: Path) -> None:
    path = _write(
        tmp_path,
        {
            "alpha": 1.0,
            "joints": [
                {"gear_stiffness": [25000.0], "gear_knee_torque": []},
                {"gear_stiffness": [1.0, 2.0, 3.0], "gear_knee_torque": [4.0, 5.0]},
            ],
        },
    )
    assert read_parameters(path) == {
        ("alpha", None): 1.0,
        ("gear_stiffness", 1): 25000.0,
        ("gear_stiffness_k1", 2): 1.0,
        ("gear_stiffness_k2", 2): 2.0,
        ("gear_stiffness_k3", 2): 3.0,
        ("gear_knee_t1", 2): 4.0,
        ("gear_knee_t2", 2): 5.0,
    }


@pytest.mark.parametrize(
    ("document", "message"),
    [
        ([], "contains neither"),
        ({"joints": 3}, "contains neither"),
        ({"joints": [3]}, "entry 1: is not a table"),
        ({"joints": [{"gear_stiffness": [1, 2]}]}, "gear_stiffness has 2 values"),
        ({"joints": [{"motor_inertia": "1e-4"}]}, "motor_inertia: '1e-4' is not a finite number"),
        ({"joints": [], "alpha": True}, "True is not a finite number"),
        ({"parameters": [{"value": 1}]}, "entry 1: has no name"),
        ({"parameters": [], "standard_parameters": [1]}, "standard_parameters: is not a table"),
        ({"parameters": [], "standard_parameters": {"m": 1}}, "'m' is not a standard parameter"),
        ({"parameters": [{"name": "a", "joint": "one", "value": 1}]}, "is 'one', not a number"),
    ],
)
def test_refuses_other_documents(tmp_path: Path, document: Any, message: str) -> None:
    with pytest.raises(InvalidInput, match=message):
        read_parameters(_write(tmp_path, document))


def test_refuses_a_missing_file_and_invalid_json(tmp_path: Path) -> None:
    with pytest.raises(InvalidInput, match="does not exist"):
        read_parameters(tmp_path / "none.json")
    (tmp_path / "p.json").write_bytes(b"{")
    with pytest.raises(InvalidInput, match="is not JSON"):
        read_parameters(tmp_path / "p.json")


_json = st.recursive(
    st.none() | st.booleans() | st.floats(allow_nan=True) | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=4)
        | st.dictionaries(
            st.sampled_from(["parameters", "joints", "name", "value", "joint", "gear_stiffness"]),
            inner,
            max_size=4,
        )
    ),
    max_leaves=12,
)


@given(document=_json)
def test_any_json_document_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, document: Any
) -> None:
    path = _write(tmp_path_factory.mktemp("p"), document)
    try:
        values = read_parameters(path)
    except InvalidInput:
        return
    assert all(isinstance(value, float) for value in values.values())


def test_an_identification_of_an_elastic_arm_can_be_simulated() -> None:
    study = scara.STIFF.study(Path("x"), "linear")
    whole = scara.STIFF.parameters(5, "linear")
    derived = virtual.derived(whole, study.arm)
    reported = {
        key: value
        for key, value in derived.items()
        if key[0] not in ("alpha", "rigid_inertia")
        and key not in {("motor_viscous_friction", 1), ("link_viscous_friction", 2)}
    }
    made = complete_values(reported, study.arm)
    assert made["alpha", None] == pytest.approx(whole["alpha", None])
    d_motor = whole["motor_viscous_friction", 1]
    assert made["motor_viscous_friction", 1] == pytest.approx(d_motor)
    assert made["motor_viscous_friction", 2] == whole["motor_viscous_friction", 2]
    assert made["link_viscous_friction", 2] == 0.0
    without_link = {k: v for k, v in derived.items() if k[0] not in ("alpha", "link_inertia")}
    assert complete_values(without_link, study.arm)["alpha", None] == pytest.approx(
        whole["alpha", None]
    )


def test_one_stiffness_replaces_three_slopes() -> None:
    study = scara.STIFF.study(Path("x"), "three-slope")
    made = complete_values(scara.STIFF.parameters(5, "linear"), study.arm)
    slopes = {made[f"gear_stiffness_{k}", 1] for k in ("k1", "k2", "k3")}
    assert slopes == {scara.STIFF.parameters(5, "linear")["gear_stiffness", 1]}
    assert made["gear_knee_t1", 1] < made["gear_knee_t2", 1]


@pytest.mark.parametrize(
    ("name", "revolute", "prismatic"),
    [
        ("stribeck_friction", "N m", "N"),
        ("stribeck_velocity", "rad/s", "m/s"),
        ("hysteresis_torque", "N m", "N"),
        ("hysteresis_twist", "rad", "m"),
        ("kinematic_error_cos", "rad", "m"),
        ("kinematic_error_sin", "rad", "m"),
        ("friction_settling_time", "s", "s"),
        ("gear_damping", "N m s/rad", "N s/m"),
    ],
)
def test_every_parameter_has_its_unit(name: str, revolute: str, prismatic: str) -> None:
    assert unit_of(name, Joint("linear", 0.01)) == revolute
    assert unit_of(name, Joint("linear", 0.01, motion="prismatic")) == prismatic
