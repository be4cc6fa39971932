"""The servo as a text for people: equations with numbers, margins, shapers, conditions."""

from __future__ import annotations

from pathlib import Path

from strainwave.export.omissions import sentence_of
from strainwave.export.source import Export
from strainwave.io.templates import fill_text
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.handover.c_header import HOLD, difference_equations
from strainwave.servo_design.handover.json_document import Units
from strainwave.servo_design.handover.shaper_summary import chosen_shaper
from strainwave.servo_design.margins import margin_summaries

_LIMITS = {
    "margins": "the margins with period, delay and resonances limit the bandwidth",
    "encoder": "the resolution of the motor encoder limits the bandwidth",
}


def to_markdown(design: ServoDesign) -> Export:
    """Difference equations, gains with units and margins of each joint; shapers; conditions."""
    joints = []
    for each in design.joints:
        gains, units = each.tuned.gains, Units.of(design.arm.joint(each.joint))
        joints.append(
            (
                each,
                design.arm.study.arm.joint_names[each.joint - 1],
                units,
                difference_equations(gains, design.limits[each.joint - 1], units),
                [
                    (one, design.condition[one.plant] + 1)
                    for one in margin_summaries(each.results.margins, design.options.required)
                ],
            )
        )
    text = fill_text(
        Path(__file__).with_name("servo.md.j2"),
        design=design,
        joints=joints,
        limits=_LIMITS,
        shaper=chosen_shaper(design),
        hold=HOLD,
        sentence_of=sentence_of,
    )
    return Export(text.encode(), design.arm.warnings)
