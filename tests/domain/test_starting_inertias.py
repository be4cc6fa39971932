"""Starting inertias of serial chains: they agree with the base parameters of the rigid step."""

import pytest
from benchmarks.studies.drawn_chains import draw_chain

from strainwave.domain.arm.combinations import value_of
from strainwave.domain.arm.kinds import kind_of
from strainwave.domain.arm.kinds.base import StageInertias
from strainwave.dynamics.arm import Arm


@pytest.mark.parametrize("seed", range(4))
def test_light_wrists_start_with_the_base_parameters_of_the_rigid_step(seed: int) -> None:
    chain = draw_chain(seed, (6,))  # the wrist is a thousandth of the base
    arm = Arm.of(chain.study.arm)
    combinations = {column.key: column.parts for column in arm.base.columns}
    rigid = {key: value_of(row, chain.values) for key, row in combinations.items()}
    motors = {i: chain.values["motor_inertia", i] for i in range(1, 7)}
    estimates = StageInertias(motors, {}, rigid, dict.fromkeys(rigid, 0.0), combinations)

    start, rejected = kind_of(arm).starting_inertias(arm, estimates)

    assert not rejected
    for key, row in combinations.items():
        if key[0].endswith("_zz"):
            assert value_of(row, start) == pytest.approx(rigid[key], rel=0.01), key
