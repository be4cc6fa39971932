"""Tables of parameters: base parameters of serial arms."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import exports
from results import identification
from strainwave.domain import Identification, Parameter
from strainwave.domain.arm.base_parameters import base_parameters
from strainwave.report.document import render
from strainwave.report.document.parameters import combination_text


@pytest.mark.parametrize(
    ("combination", "text"),
    [
        ({"my2": 1.0}, "my2"),
        ({"Izz2": 1.0, "m3": 0.16, "mz3": -0.4}, "Izz2 + 0.16 m3 - 0.4 mz3"),
        ({"Ixx3": -1.0, "Iyy3": 1.0}, "-Ixx3 + Iyy3"),
    ],
)
def test_a_combination_is_a_sum(combination: dict[str, float], text: str) -> None:
    assert combination_text(combination) == text


@pytest.fixture(scope="module")
def serial() -> Identification:
    """The rigid step of a chain; one base parameter is not identified."""
    study = exports.chain(Path("nowhere"), ("rigid",) * 3)[0]
    columns = base_parameters(study.arm).columns
    parameters = [
        Parameter(c.name, c.joint, 2.5, 0.01, c.unit, "rigid", (2.48, 2.52)) for c in columns
    ]
    parameters[3] = replace(parameters[3], value=None, std=None, ci95=None)
    one = identification()
    assert one.rigid is not None
    covariance = 1e-4 * np.eye(len(parameters))
    model = replace(one.rigid, parameters=tuple(parameters), covariance=covariance)
    return replace(one, study=study, rigid=model, fitted=(), checks=(), stage_warnings=())


def test_the_report_lists_base_parameters_and_draws_the_arm(serial: Identification) -> None:
    page = render(serial)
    section = re.search(r'<section id="base-parameters".*?</section>', page, re.DOTALL)
    assert section is not None
    rows = re.findall(r'<tr><th scope="row">(\w+)</th>', section[0])
    assert len(rows) == len(base_parameters(serial.study.arm).columns)
    assert rows[0] == "Izz1R"
    assert "10000 motor_inertia1" in section[0]
    assert "2.480 … 2.520" in section[0]
    assert section[0].count("not identified") == 1
    assert 'id="figure-arm"' in page
    assert "gravity in the plane of motion" not in page


def test_planar_arms_have_no_base_parameters() -> None:
    page = render(identification())
    assert 'id="base-parameters"' not in page
    assert 'id="figure-arm"' not in page
