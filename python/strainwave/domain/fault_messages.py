"""Templates of suspected faults of the input and of their remedies; see `domain.messages`."""

from __future__ import annotations

from collections.abc import Mapping

FAULT_CODES = (
    "wrong-unit",
    "wrong-sign",
    "swapped-channels",
    "wrong-gear-ratio",
    "wrong-geometry",
    "misaligned",
    "clock-drift",
    "clipped",
    "wrong-torque-constant",
    "wrong-zero",
    "dead-channel",
    "wrong-prbs-clock",
    "unstated-payload",
    "effort-without-gravity",
    "effort-without-friction",
    "desired-effort",
    "ac-coupled",
)
"""Codes of suspected faults of the input."""

_SCALE = "{channel} is {ratio:.4g} times the value that {basis} implies: "
_BETTER = "the torques of all joints agree with one arm {ratio:.3g} times better"

FAULTS: Mapping[str, str] = {
    # observations, by code or "code/variant"
    "wrong-unit": _SCALE + "logged in {unit}?",
    "wrong-unit/reversed": _SCALE + "logged in {unit}, with the wrong sign?",
    "wrong-unit/efforts": "{channels!a} belong to a much heavier arm than one of this size:"
    " logged in {unit}?",
    "wrong-sign/efforts": "all joints accelerate against their efforts: {channels!a} have the wrong"
    " sign",
    "wrong-sign/some": "the joints accelerate against {channels!a}: wrong sign",
    "dead-channel": "{channel} shows noise alone: its range is {share!p:.2g} % of that which the"
    " motor angles imply; the sensor or its cable is faulty",
    "effort-without-friction": "the efforts of all joints show no friction ({share!p:.2g} % of the"
    " torque): {channels!a} are calculated by a model, as desired torques or by an observer, and"
    " not measured at the motors",
    "wrong-unit/unknown": _SCALE + "its scale is wrong",
    "wrong-unit/time": "the time base is {ratio:.4g} times the value that the other signals and the"
    " clocks of the study imply: t is logged in {unit}, not in seconds",
    "wrong-unit/angles": "{channels!a} are logged in {unit}, not in radians",
    "wrong-unit/amplitude": "{records!a}: the PRBS in {channel} has an amplitude of {measured:.4g}"
    " V, but the study states {stated:.4g} V, a factor of {ratio:.4g}: either the scale of"
    " {channel} or the stated amplitude is wrong",
    "wrong-unit/counts": "the steps of {channel} are {ratio:.4g} times the size that encoder_counts"
    " = {counts:.7g} implies, but the motion of {channel} agrees with the other signals",
    "wrong-sign": _SCALE + "its sign is wrong",
    "wrong-sign/gear": "link {joint} turns opposite to its motor: every link sensor of joint"
    " {joint} has the opposite sign of the motor signals",
    "wrong-gear-ratio": "the link sensors of joint {joint} measure {factor:.4g} times the motion"
    " that gear_ratio = {stated:.4g} implies: the link turns {ratio:.4g} times per motor turn",
    "wrong-geometry/vertical": "the link sensors measure gravity, but the study states none: the"
    " arm is vertical",
    "wrong-geometry/horizontal": "the link sensors and the torques show no gravity, but the study"
    " states gravity = {gravity:.4g}: the arm is horizontal",
    "wrong-geometry/distance": "{channel} reads {ratio:.4g} times the acceleration that the motion"
    " of joint {joint} implies at {stated:.4g} m from its axis: the accelerometer is mounted at"
    " {corrected:.4g} m{hint}",
    "wrong-geometry/length": "{channel} reads {ratio:.4g} times the motion of axis {joint} that"
    " link_length = {stated:.4g} m implies",
    "wrong-geometry/axis": _BETTER + " if the axis of joint {joint} is {corrected} in the joint's"
    " frame; the study states {stated}",
    "wrong-sign/axis": _BETTER
    + " if joint {joint} turns in the opposite direction: its axis or its"
    " gear_ratio has the wrong sign",
    "wrong-sign/torques": _BETTER + " if {channel} of joint {joint} has the opposite sign",
    "wrong-geometry/gravity": _BETTER + " if gravity is {corrected} m/s^2 in the frame of the base;"
    " the study states {stated}",
    "wrong-geometry/zero": _BETTER + " if the zero of joint {joint} is moved by {angle:.3g} rad:"
    " the encoder's zero is not that of the arm's description",
    "wrong-geometry/frame": _BETTER + " if the frame of joint {joint} is moved by {length:.3g} m"
    " and turned by {angle:.3g} rad: its origin is wrong",
    "wrong-geometry/robot": _BETTER + " if the frames of the joints are moved by up to"
    " {length:.3g} m and turned by up to {angle:.3g} rad: the origins describe another arm",
    "wrong-geometry/coupling": _BETTER + " if the coupling of the motors is {corrected}",
    "wrong-unit/torques": _BETTER + " if the torque of joint {joint} is multiplied by {factor:.4g}:"
    " is it in another unit?",
    "wrong-torque-constant/torques": _BETTER + " if the torque of joint {joint} is multiplied by"
    " {factor:.4g}",
    "wrong-gear-ratio/torques": _BETTER + " if the link of joint {joint} turns {corrected:.4g}"
    " times per motor turn; the study states gear_ratio = {stated:.4g}",
    "swapped-channels": "{pairs!a}: the channels of joints {joints!a} are exchanged",
    "swapped-channels/one-kind": "{first} follows joint {other}, and {second} follows joint"
    " {joint}: the two channels are exchanged",
    "swapped-channels/excited-joint": "{experiment}: the study states joint = {stated} as the"
    " excited joint, but the test signal is in the command of joint {excited}",
    "record": "{record} alone: {fault}",
    "unstated-payload": "the torques of {record} agree with those of the other records {ratio:.3g}"
    " times better with a load on the last link: {record} and the other records were made with"
    " different payloads",
    "effort-without-gravity": "the torques of all joints agree with one arm {ratio:.3g} times"
    " better without gravity: the driver of the robot subtracts gravity from the logged efforts",
    "misaligned/motors": _BETTER + " if {channels!a} are {delay!m:.3g} ms {side} than the other"
    " signals of the motors",
    "rival": "or, as likely: {fault}",
    "misaligned/command": "{channels!a}: the command in the log is {delay!m:.3g} ms {side} than the"
    " torque that moves {angles!a}, according to the phase of the motor's response to the test"
    " signals; the delay would bias damping, stiffness and inertias",
    "misaligned/angle": "{channels!a}: the angle in the log is {delay!m:.3g} ms {side} than the"
    " response to the command {commands!a} and than the link sensors; the delay would bias damping,"
    " stiffness and inertias",
    "misaligned/sensor": "{channels}: {delay!m:.3g} ms {side} relative to the motor angle, more"
    " than the whole-arm fit corrects",
    "clock-drift": "the voltages change with a period of {ratio:.6g} times the PRBS or servo period"
    " of the study: the clock of the logger is wrong by that factor",
    "clock-drift/records": "the voltages of {records!a} change with a period of {ratio:.6g} times"
    " that of the study, in contrast to the other records: their time is wrong by that factor",
    "wrong-prbs-clock": "the test signals of {records!a} change with a period of {ratio:.6g} times"
    " the clock of their prbs",
    "clock-drift/sensor": "{channels}: the delay relative to the motor angle changes by"
    " {drift!m:.3g} ms per second: the clock of these channels is {error!p:.3g} % {side}",
    "ac-coupled": "{channels!a}: the readings agree with the motion only after a high-pass of"
    " {cutoffs}: the sensor or its amplifier is AC-coupled, for example a piezoelectric"
    " accelerometer. It does not measure gravity or slow motion, and the model of a DC-coupled"
    " accelerometer would bias the damping",
    "clipped": "{channel} stays at {low:.4g} or {high:.4g} for {share!p:.2g} % of"
    " {experiment}{others}: the sensor is saturated",
    "wrong-torque-constant": "the torques of joint 1 are {factor} (standard deviation {std:.2g})"
    " times the value that the torques of joint {joint} and the symmetry of the inertia matrix"
    " imply: one of the two torque constants is wrong; the signals do not determine which",
    # contradictions without a cause, by kind
    "contradiction/count": "the step of {place} is {value:.4g} times the count that encoder_counts"
    " implies",
    "contradiction/prbs-clock": "the voltages of {place} change with a period of {value:.4g} times"
    " the clock of its prbs",
    "contradiction/servo-clock": "the voltages of {place} change with a period of {value:.4g} times"
    " the servo period",
    "contradiction/level": "the PRBS in {place} has {value:.4g} times the amplitude that the study"
    " states",
    "contradiction/limit": "{place} reaches {value:.4g} times the limit of the servo",
    "contradiction/reference": "the velocity of {place} is {value:.4g} times its servo reference",
    "contradiction/servo": "{place} is {value:.4g} times the output of the servo that the study"
    " states",
    "contradiction/velocity": "{place} is {value:.4g} times the derivative of the motor angle",
    "contradiction/scale": "{place} is {value:.4g} times the value that the motor angles and the"
    " geometry imply",
    "contradiction/explained-share": "the other signals explain only {value!p:.2g} % of {place}",
    "contradiction/own-joint": "{place} shows {value:.4g} times the motion of its own joint",
    "contradiction/origin-motion": "{place} shows {value:.4g} times the motion of its joint's axis",
    "contradiction/gravity": "{place} shows {value:.4g} times the gravity of the study",
    "contradiction/tilt": "{place} shows a gravity of {value:.4g} g, but the study states none",
    "contradiction/rotation-ratio": "{place} shows {value:.4g} times the rotation relative to joint"
    " 1 that the gear ratios imply",
    "contradiction/delay": "{place} has a delay of {value:.4g} s relative to the motor angle",
    "contradiction/input-delay": "{place} is {value:.4g} s later than the torque that moves the"
    " motor",
    "contradiction/drift": "the delay of {place} grows by {value:.4g} s per second",
    "contradiction/torque-fit": "{place}: the unexplained variance of the torques is {value:.3g}"
    " times that with another geometry",
    "contradiction/torque-prediction": "{place}: the model predicts only {value!p:.2g} % of the"
    " torques",
    "contradiction/torque-sensor": "{place} is {value:.4g} times the torque of its motor",
    "contradiction/presence": "the range of {place} is {value!p:.2g} % of that of its prediction",
    "contradiction/friction": "friction is {value!p:.2g} % of the torques",
    "contradiction/mass": "the torques imply a mass of {value:.3g} times the heaviest plausible arm"
    " of this size",
    "contradiction/speed": "the joints are {value:.3g} times faster than the fastest plausible arm",
    "contradiction/inertia": "joint {joint} accelerates against its torque: {place} or"
    " theta_m{joint} has the wrong sign",
    "contradiction/excited-joint": "the test signal of {place} is not in the command of joint"
    " {joint}",
    # parts of observations
    "basis/motor-angle": "theta_m{joint}",
    "basis/servo": "the servo or the motion",
    "basis/motion": "the motion",
    "basis/signals": "the motion of the other signals",
    "basis/resolution": "its encoder resolution, together with the other signals,",
    "counts/power": "counts of 2 pi / {counts}",
    "counts/scaled": "counts of {factor:g} times the scale (lines and quadrature)",
    "frequency": "{value:.2g} Hz",
    "hint/axis": "; was the stated distance measured from axis {axis}?",
    "hint/end": "; was the stated distance measured from the end of the link?",
    "also-in": " (also in {records})",
    "factor": "{value:.4g}",
    "factor/about": "about {value:.2g}",
    # remedies
    "remedy": "{steps!s}",
    "remedy/record": "correct these channels in the log of {record}, or remove its [[experiment]]",
    "remedy/payload": "weigh the load and state its mass and xyz as payload in [[experiment]]"
    " {record}, or remove that record",
    "remedy/log-clock": "{steps!s}, or correct prbs.clock and the period of the servo",
    "remedy/record-clock": "multiply the time of {records!a} by {ratio:.6g} in their logs",
    "remedy/command": "{steps!s}, or record commands and encoders with one clock",
    "remedy/amplitude": "{steps!s}; or, if that value is correct, {other!s}",
    "remedy/sensor-delay": "{steps!s}; or state the sensor's bandwidth (accelerometer_hz, gyro_hz)"
    " if it has a filter",
    "remedy/sensor-clock": "{steps!s}, or record all channels with one clock",
    "remedy/distance": "{steps!s} (from the axis of joint {joint}), or, if the scale of the sensor"
    " is wrong, {other!s}",
    "remedy/axis": "{steps!s}, or change the sign of gear_ratio of [[joint]] {joint}",
    "remedy/frame": "compare the origins in the description of the arm with drawings of the robot; "
    "{steps!s}",
    "remedy/robot": "use the description of this robot: compare the lengths between its axes with"
    " drawings, and its zero posture with that of the encoders",
    "remedy/gear": "{steps!s}; motor and link then turn in the same direction",
    "remedy/clipped": "reduce the amplitude, or use a sensor with a larger range; until then,"
    " remove the channel from the study",
    "remedy/logged-torques": "divide the scale of channels.torque1 by {factor}, or multiply the"
    " scale of channels.torque{joint} by {factor}; change the less certain of the two",
    "remedy/torque-constants": "divide torque_per_volt of [[joint]] 1 by {factor}, or multiply"
    " torque_per_volt of [[joint]] {joint} by {factor}; change the less certain of the two",
    "remedy/experiments": "no single cause explains all contradictions. Do these experiments, most"
    " likely cause first, to isolate the cause: {experiments!s}",
    # corrections
    "step/channel": "set {line}",
    "step/set": "set {key} = {value:.7g} in {table}",
    "step/set-count": "set {key} = {value} in {table}",
    "step/set-list": "set {key} = {value} in {table}",
    "step/remove": "remove {key} from {table}",
    "step/delay_s": "shift {channel} by {delay!m:.3g} ms to {side} times in every log",
    "step/clock": "resample {channel} at {spacing:.7g} times its spacing in every log",
    "step/high_pass_hz": "couple the amplifier of {channel} to DC, or remove its column from the"
    " logs",
    "step/unusable": "remove or rename the column of {channel} in the logs to exclude it",
    "table/arm": "[arm]",
    "table/joint": "[[joint]] {entry}",
    "table/transmission": "[transmission]",
    "table/urdf": "joint {entry} of {file}",
    "table/experiment": "[[experiment]] {entry}",
    # experiments that separate the causes, by code
    "isolate/swapped-channels": "({number}) swapped channels: move one joint at a time, and note"
    " which columns change",
    "isolate/wrong-sign": "({number}) wrong sign: turn the link by hand in its positive direction:"
    " theta_m and its rate must be positive, and so must the voltage that turns the link in this"
    " direction",
    "isolate/wrong-unit": "({number}) wrong unit: turn the link by 90 degrees: theta_m must change"
    " by 1.5708 / gear_ratio",
    "isolate/wrong-gear-ratio": "({number}) wrong gear ratio: turn the motor by ten whole turns and"
    " measure the angle of the link",
    "isolate/wrong-geometry": "({number}) wrong geometry: measure link_length and"
    " accelerometer_distance from axis to axis, and read the accelerometer at standstill in two"
    " postures: a difference is due to gravity",
    "isolate/clock-drift": "({number}) clock drift: tap the link twice, one minute apart, and"
    " compare the time stamps of the taps in all channels",
    "isolate/misaligned": "({number}) misaligned: command a step of voltage and compare its time"
    " stamp with the first change of theta_m",
    "isolate/ac-coupled": "({number}) ac coupled: turn the sensor upside down at standstill: the"
    " reading of a DC-coupled accelerometer changes by 2 g permanently",
}
"""Observations, their parts, and remedies."""
