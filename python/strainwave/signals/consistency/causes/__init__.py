"""Candidate causes: single faults of the input that can explain contradictions.

Structured causes come first: exchanged joints, gravity, a unit, a sign, a delay. Causes with an
estimated factor come last. Their values stay within the ranges that a study file accepts.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from strainwave.signals.consistency.causes import channels, commands, constants, geometry
from strainwave.signals.consistency.causes.case import Case, Cause
from strainwave.signals.consistency.evidence import Evidence
from strainwave.signals.consistency.observations import Observation

__all__ = ["Cause", "propose_causes"]

_OF_ARM = (
    commands.propose_exchanged_files,
    channels.propose_effort_scales,
    channels.propose_record_signs,
    channels.propose_dead_channels,
    commands.propose_time_bases,
    commands.propose_record_clocks,
    commands.propose_input_delays,
    commands.propose_excited_joints,
    commands.propose_voltage_scales,
    constants.propose_gravity,
    channels.propose_exchanges,
    channels.propose_angle_units,
    channels.propose_ac_coupling,
    channels.propose_sensor_delays,
)
_OF_JOINT = (
    channels.propose_channel_scales,
    channels.propose_motor_angle_scales,
    constants.propose_encoder_counts,
    constants.propose_gear_ratios,
    constants.propose_geometry,
    channels.propose_reversed_gear,
)


def propose_causes(evidence: Evidence, contradictions: Sequence[Observation]) -> Iterator[Cause]:
    """Yield all candidate causes, structured causes first."""
    case = Case(evidence, tuple(contradictions))
    if {each.kind for each in contradictions} == {"torque-fit"}:
        yield from geometry.propose_explanations(case)  # they competed on held-out stretches
        return
    # the factors of link sensors are more accurate than those of torques, but those of chains take
    # time
    is_plane = evidence.arm.has_planar_program
    if not is_plane:
        yield from geometry.propose_explanations(case)
    for propose in _OF_ARM:
        yield from propose(case)
    estimated_causes: list[Cause] = []
    last_joint = max(case.joints, default=0)  # Readings depend on the joints before a link.
    if case.contradicts("torque-ratio"):
        last_joint = evidence.arm.n_joints
    for joint in range(1, last_joint + 1):
        for propose_of_joint in _OF_JOINT:
            for cause in propose_of_joint(case, joint):
                if cause.has_estimated_factor:
                    estimated_causes.append(cause)
                else:
                    yield cause
    if is_plane:
        yield from geometry.propose_explanations(case)
    yield from estimated_causes
