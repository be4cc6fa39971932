"""Hand-over of a servo design: JSON, C, MATLAB, text, ros2_control, python-control."""

from strainwave.tune.handover.json_document import to_json
from strainwave.tune.handover.texts import (
    controllers,
    observers,
    to_c_header,
    to_markdown,
    to_ros2_control,
    to_script,
)

__all__ = ["FILES", "controllers", "observers"]

FILES = {
    "servo.json": to_json,
    "servo.h": to_c_header,
    "servo.m": to_script,
    "servo.md": to_markdown,
    "ros2_control.yaml": to_ros2_control,
}
"""Functions that render a design, by file name."""
