"""Hand-over of a servo design: JSON, C, MATLAB, text, ros2_control, python-control."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

from strainwave.errors import InvalidInput, suggest_name
from strainwave.export.source import Export
from strainwave.io.atomic_files import write_whole
from strainwave.servo_design.design import ServoDesign
from strainwave.servo_design.handover.c_header import to_c_header
from strainwave.servo_design.handover.json_document import to_json
from strainwave.servo_design.handover.markdown import to_markdown
from strainwave.servo_design.handover.matlab import to_script
from strainwave.servo_design.handover.python_control import controllers, observers
from strainwave.servo_design.handover.ros2_control import to_ros2_control

__all__ = ["FORMATS", "Format", "controllers", "hand_over", "observers", "render_forms"]


class Format(NamedTuple):
    """A file and the function that renders it."""

    file: str
    render: Callable[[ServoDesign], Export]


FORMATS = {
    "json": Format("servo.json", to_json),
    "c": Format("servo.h", to_c_header),
    "matlab": Format("servo.m", to_script),
    "markdown": Format("servo.md", to_markdown),
    "ros2_control": Format("ros2_control.yaml", to_ros2_control),
}


def render_forms(design: ServoDesign, forms: Sequence[str] = tuple(FORMATS)) -> dict[str, Export]:
    """A design in some formats, by file name. Raises `InvalidInput` if there is no such format."""
    for form in forms:
        if form not in FORMATS:
            raise InvalidInput(
                f"there is no format {form!r}",
                where="forms",
                remedy=f"use one of {', '.join(FORMATS)}{suggest_name(form, FORMATS)}",
            )
    return {FORMATS[form].file: FORMATS[form].render(design) for form in forms}


def hand_over(
    design: ServoDesign, folder: Path, forms: Sequence[str] = tuple(FORMATS)
) -> dict[str, Export]:
    """Write a design into a folder, one file per format; return the exports by file name.

    Raises `InvalidInput` if there is no such format, or if the folder cannot be written to.
    """
    exports = render_forms(design, forms)
    write_whole(folder, {name: export.data for name, export in exports.items()})
    return exports
