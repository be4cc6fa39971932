"""The units that forms offer: one table for columns of logs and fields of forms."""

from __future__ import annotations

import pytest

from strainwave.domain.study import study_keys
from strainwave.init.names import UNITS
from strainwave.init.units import form_units, in_si

SI = ("rad", "rad/s", "m", "m/s^2", "kg m^2", "N m", "N m/V", "V", "A", "s", "Hz", "V s/rad")


@pytest.mark.parametrize("unit", SI)
def test_the_first_unit_of_a_menu_is_the_si_unit(unit: str) -> None:
    first, *others = form_units(unit)
    assert (first.name, first.factor, first.power) == (unit, 1.0, 1)
    assert others
    for each in others:  # typed as it is printed
        assert float(in_si(f"2 {each.name}", unit)) == pytest.approx(2.0 * each.factor)


def test_units_of_columns_and_of_fields_agree() -> None:
    factors = {each.name: each.factor for each in form_units("rad/s")}
    assert factors["rpm"] == UNITS["velocity"]["rpm"]
    assert factors["deg/s"] == UNITS["gyro"]["deg/s"]
    assert {each.name: each.factor for each in form_units("m/s²")}["g"] == UNITS["acceleration"][
        "g"
    ]


def test_the_other_unit_of_a_key_is_offered_with_its_scale() -> None:
    """The range of a key names a unit that values are mistaken in."""
    for table in study_keys().values():
        for key in table:
            names = [each.name for each in form_units(key.unit.partition(",")[0])]
            if names and key.other_scale is not None:
                scale = float(in_si(f"1 {key.other_unit}", key.unit.partition(",")[0]))
                assert scale == pytest.approx(key.other_scale), key.key
