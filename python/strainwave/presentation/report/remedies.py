"""Meaning and remedy of each warning code, and the order of their severity."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from strainwave.domain import Diagnostic
from strainwave.domain.effects import possible_causes
from strainwave.domain.messages import short_place
from strainwave.presentation.report.blocks import Block, Cell, Span, paragraph, prose, table

TROUBLESHOOTING_PAGE = "docs/troubleshooting.md"
"""The page with a section for each code."""


class Advice(NamedTuple):
    """Meaning of a warning for the result, and remedy."""

    meaning: str
    remedy: str


_RESULT = {
    "implausible": Advice(
        "The model does not describe the records. Do not use any value of this stage.",
        "Check gear_ratio, torque_per_volt, and the sign and scale of each channel.",
    ),
    "stages-disagree": Advice(
        "One of the two values is biased. The intervals contain the difference.",
        "Check in this order: motor constant at high current, clock of the logger, dead zone of the"
        " drive, friction law.",
    ),
    "implausible-size": Advice(
        "A unit in the study is wrong; its torques or angles are wrong by one factor.",
        "Give torque_per_volt in N m/V, angles in rad and gear_ratio as link turns per motor turn.",
    ),
    "not-predicted": Advice(
        "The model does not hold for that record and is not validated.",
        "Check [servo], the references, the payload and the drive of that record.",
    ),
    "not-described": Advice(
        "The model does not describe the records it was fitted to.",
        "Set what the warnings of likely causes state, such as spring or effects.",
    ),
    "urdf-mass": Advice(
        "The inertial values of the URDF are a guess. The base parameters do not depend on them.",
        "Use the exported parameters; compare the payload of the records and the torque constants.",
    ),
    "urdf-inertia": Advice(
        "A typical body is the prior of that link. The base parameters do not depend on it.",
        "Correct mass and inertia in the URDF, or export it again from the drawing.",
    ),
    "torques-contradict": Advice(
        "The named effect biases the rigid model. The intervals are widened.",
        "Add the effect to the joint's effects, and check torque_per_volt of all joints.",
    ),
    "rejected": Advice(
        "The value is null in the table of parameters and is not exported.",
        "Read the other warnings of that stage: sensor and drive bandwidths, signs, scales.",
    ),
    "elastic-not-validated": Advice(
        "No check record tests stiffness and damping.",
        "Supply what is missing of a check record. Otherwise record larger or faster steps of the"
        ' joint under the servo, or a PRBS, with use = "check".',
    ),
    "not-tuned": Advice(
        "The result comes from the earlier stages only; its intervals are wider.",
        "Log the angle and the voltage of every motor; check signs, units and channel assignment.",
    ),
    "no-frequency-record": Advice(
        "The gears are identified from steps or torsion alone, or not at all.",
        'Record a PRBS on each joint with use = "frequency".',
    ),
    "rigid-joints": Advice(
        "The rigid step and the models of the elastic joints are the result; no whole-arm fit is"
        " needed for the verdict.",
        'Set spring = "auto" for the joint if its gear is elastic.',
    ),
    "no-torsion": Advice(
        "The encoders of the joint do not determine the stiffness of its gear.",
        "Record motion in which gravity or acceleration loads the gear more, or a PRBS.",
    ),
    "iteration-limit": Advice(
        "The values are provisional; do not trust the intervals.",
        "Record longer, or raise tuning.max_iterations.",
    ),
    "no-descent": Advice(
        "The values are provisional; do not trust the intervals.",
        "Look at the residual tests, hold a hardly determined parameter (tuning.hold), or record"
        " longer.",
    ),
    "at-bounds": Advice(
        "The parameter compensates for an effect that the model lacks, and biases others.",
        "Check gear_ratio, payload and scales in the study, then the residual tests.",
    ),
    "response-apart": Advice(
        "The measured response or the joint model is wrong in that band.",
        "Look at the Bode plot. Below the anti-resonance, raise the amplitude; at the resonances,"
        " use the whole-arm fit; at all frequencies, check torque_per_volt.",
    ),
    "grey-box-failed": Advice(
        "This record gives no joint model; the others do.",
        "Check the record for saturation, impacts and wrong channels.",
    ),
    "not-identifiable": Advice(
        "The value is null unless another stage identifies it.",
        "Record a larger amplitude, other postures or faster reversals, or use the data sheet.",
    ),
    "only-together": Advice(
        "Only the combination of the two parameters is well determined.",
        "Record at another amplitude or posture, or hold one parameter at its data-sheet value.",
    ),
    "causes-not-fitted": Advice(
        "These effects were linearised; their weight enters the intervals.",
        "Raise tuning.rival_effort, or name the effect in the joint's effects.",
    ),
    "residual-not-noise": Advice(
        "The model lacks an effect, the study has a wrong constant, or a disturbance acted. The"
        " intervals are widened.",
        "Read the table of effects, then check torque_per_volt, distances and bandwidths.",
    ),
    "no-rigid-model": Advice(
        "Friction and inertia are estimated from the PRBS records only.",
        'Record a slow, smooth motion over the whole workspace with use = "motion".',
    ),
}
"""Warnings about the result, the most serious first."""
_DATA = {
    "saturated": Advice(
        "Intervals at the limit of the drive are excluded.",
        "Lower the amplitude, or correct limit in [servo].",
    ),
    "spikes": Advice(
        "The samples are interpolated and excluded.", "Check the sensor's cable, shield and plug."
    ),
    "frozen": Advice(
        "The interval is excluded.", "Check for lost packets, a loose plug or a stalled sensor."
    ),
    "encoder-steps": Advice(
        "The steps are subtracted from the later samples.",
        "Check the encoder's index and supply, and the number of bits of the counter.",
    ),
    "flat-tops": Advice(
        "Samples at the end of the sensor's range are excluded.",
        "Use a sensor with a larger range, or a smaller amplitude.",
    ),
    "mains-hum": Advice(
        "The damping of a resonance within a few Hz of the line is less certain.",
        "Shield and ground the sensor's cable.",
    ),
    "misaligned": Advice(
        "The delay is not corrected. It acts like damping and shifts the resonances.",
        "Check the logger's time stamps; give accelerometer_hz and current_loop_hz.",
    ),
    "sensor-delay": Advice(
        "The delay is estimated and corrected.",
        "Give the sensor's bandwidth in the study, or correct the latency of its bus.",
    ),
    "sensor-scale": Advice(
        "The scale is estimated and corrected.",
        "Check the sensor's calibration, direction and accelerometer_distance.",
    ),
    "sensor-drift": Advice(
        "The drift is estimated and corrected.", "Let the sensor warm up, and check its supply."
    ),
    "sensor-mount": Advice(
        "The resonance of the mount is estimated and corrected.",
        "Glue or screw the sensor down close to the link's structure.",
    ),
    "start-rejected": Advice(
        "The fit starts from a typical value instead.",
        "Check signs, units and assignment of the channels.",
    ),
    "no-link-sensor": Advice(
        "The gear is identified from the motor; intervals are 1.5 to 5 times wider.",
        "No action is required. For narrower intervals, add a sensor to the link.",
    ),
    "silent-command": Advice(
        "The last command is held; the torque is wrong if the drive did otherwise.",
        "Check the drive, or exclude the interval by start and stop.",
    ),
    "recorder-stamps": Advice(
        "The topics are delayed relative to the others, which acts like damping.",
        "Publish the messages with a header stamp.",
    ),
    "sub-sampled": Advice(
        "The response is biased at high frequencies.",
        "Log at least at the clock of the excitation.",
    ),
    "torque-sensor": Advice(
        "The torque includes no motor inertia and no friction of the motor.",
        'Set meaning = "motor" in [channels] if the motor measures it.',
    ),
    "constant-channel": Advice(
        "The channel is not used.", "Check the sensor's cable, its scale and [channels]."
    ),
    "poor-excitation": Advice(
        "The named parameters are correlated; each one is uncertain.",
        "Move all joints at once at varied speeds and postures; `strainwave excite` designs this.",
    ),
    "not-rigid": Advice(
        "The inertias of the rigid step are biased.",
        "Move more slowly, or use the whole-arm fit.",
    ),
    "standing": Advice(
        "Friction is unknown at standstill, so intervals are wide.",
        "Move faster and reverse less often.",
    ),
    "estimated-drive": Advice(
        "Inertias, friction and stiffness of all stages scale with the estimated torque per volt.",
        "Record a heavier payload if the intervals of torque_per_volt are too wide.",
    ),
    "torque-at-link": Advice(
        "Rotor inertia and motor friction are not identified, and are not asked for.",
        "Log the motors' torques or currents as well if a servo model needs them.",
    ),
    "friction-term": Advice(
        "The rigid model includes this effect; exported arms have the nearest torque.",
        "Correct a zero or a delay in the study or the logger; otherwise no action is required.",
    ),
    "load-friction": Advice(
        "The rigid model includes this friction; exported arms have the nearest torque.",
        "No action is required.",
    ),
    "not-settled": Advice(
        "A parameter may be wrong by the given fraction of its standard deviation.",
        "Record a longer or faster motion.",
    ),
    "sliding": Advice("A linear model mistakes stiction for inertia.", "Use a larger amplitude."),
    "constant-inertia": Advice(
        "The error of the joint model grows with the error of the rigid model.",
        "Keep the motion of the outer joints small.",
    ),
    "interaction-amplitude": Advice(
        "The response to the interaction torque is not identifiable.",
        "Leave the other joints free, or excite them as well.",
    ),
    "interaction-spectrum": Advice(
        "The response to the interaction torque is not identifiable in that band.",
        "Raise the amplitude, and leave the other joints free.",
    ),
    "input-richness": Advice(
        "The two columns of the frequency response are correlated.",
        "Excite all joints at once with different sequences.",
    ),
    "inertia-mismatch": Advice(
        "Rigid model or joint model is biased.",
        "Check torque_per_volt and friction; if only the link inertia differs,"
        " accelerometer_distance.",
    ),
    "not-reciprocal": Advice(
        "A scale is wrong, and all parameters with it.",
        "Check gear_ratio, torque_per_volt and accelerometer_distance.",
    ),
    "lag-not-slow": Advice(
        "The parameters by (17) and (18) are approximate.",
        "Use the parameters of the equations of motion.",
    ),
    "unstable-model": Advice(
        "The simulated fit is meaningless; the resonances are not affected.",
        "Raise the amplitude, lower the order, or remove drifts.",
    ),
    "stability-enforced": Advice(
        "The model is the best stable one; its response below the resonances is doubtful.",
        "Raise the amplitude, record longer, lower the order, or remove drifts.",
    ),
    "state-space-failed": Advice(
        "The record has no state-space model; the joint model does not need one.",
        "Record a longer interval without saturation.",
    ),
    "transfer-function-failed": Advice(
        "Only the equations of motion give parameters.", "No action is required."
    ),
    "modes-failed": Advice(
        "The state-space model gives no resonance.", "Raise the amplitude, or change the order."
    ),
    "not-judged": Advice("The state-space model has no residual tests.", "Record more periods."),
    "pem-iteration-limit": Advice(
        "Matrices and standard deviations are provisional.", "Lower the order, or record longer."
    ),
    "pem-stalled": Advice(
        "Matrices and standard deviations are provisional.",
        "Remove means and drifts, or lower the order.",
    ),
    "order-reduced": Advice(
        "The model has the three states of a joint; the resonances are valid.",
        "No action is required. For a model with more states, record longer.",
    ),
    "negative-fit": Advice(
        "Do not simulate with this state-space model.", "Remove drifts, or change the order."
    ),
    "pem-not-determined": Advice(
        "The state-space model has no covariance.", "Lower the order, or excite every input."
    ),
    "subspace-not-determined": Advice(
        "The subspace method gives no starting values.",
        "Remove means and drifts, or change the order.",
    ),
    "pole-near-nyquist": Advice(
        "The frequency of that mode is doubtful.", "Lower the order, or sample faster."
    ),
}
"""Warnings about the data and about single models."""
_SCOPE = {
    "not-reached": Advice(
        "The stiffness above the largest gear torque is null; the values below are valid.",
        "Use a larger amplitude, or hold the link and load it.",
    ),
    "equivalent-stiffness": Advice(
        "The value depends on the amplitude.",
        "Use the curve of the whole-arm fit; record a larger amplitude if it has none.",
    ),
    "effect-taken-up": Advice(
        "The values belong to the model with this effect.",
        "Record the experiment in the message, then name the effect in the study.",
    ),
    "effect-left-out": Advice(
        "The model does not include the effect.",
        "Remove it from the joint's effects, or record slow motions and reversals.",
    ),
    "friction-settles": Advice("The time constant is estimated.", "No action is required."),
    "nothing-to-predict": Advice(
        "The channel has no fit.", "To validate this channel, move the joint in a check record."
    ),
    "split": Advice(
        "Each segment is used as a record of its own; no value is interpolated across a pause.",
        "Check the logger if the pauses are not intended.",
    ),
    "repeated-stamps": Advice("These rows are not used.", "Check the clock of the logger."),
    "held-samples": Advice(
        "Only the updates are used. Motion faster than their rate is lost.",
        "Log at the rate of the bus, and read all signals at one rate.",
    ),
    "missing-values": Advice(
        "Short gaps are interpolated and not weighted; longer ones are left out.",
        "Check the logger.",
    ),
    "integrated-velocity": Advice(
        "The angle is the integral of the velocity, and drifts with its offset.",
        "Log the angle if possible.",
    ),
    "reordered": Advice("The messages are sorted by stamp.", "No action is required."),
    "resampled": Advice(
        "The log is interpolated to a uniform clock, which smooths fast content.",
        "If the motion is not slow, log at a uniform rate.",
    ),
}
"""Warnings about the scope of the result."""

NOTES = frozenset({*_SCOPE, "torque-sensor", "urdf-mass", "urdf-inertia"})
"""Codes that require no action."""


def advice() -> Mapping[str, Advice]:
    """Meaning and remedy by code, the most serious first."""
    effects = {
        effect.warning_code: Advice(
            f"Without this effect, {effect.consequence}.",
            effect.remedy,
        )
        for effect in possible_causes()
    }
    return _RESULT | effects | _DATA | _SCOPE


def most_serious(warnings: Iterable[Diagnostic]) -> Diagnostic:
    """The first of the most serious warnings; there must be at least one."""
    return min(warnings, key=_severity_rank)


def by_severity(warnings: Iterable[Diagnostic]) -> list[Diagnostic]:
    """The most serious first; of equal severity in their order."""
    return sorted(warnings, key=_severity_rank)


def warnings_table(warnings: Iterable[Diagnostic]) -> Iterator[Block]:
    """Observation, meaning and remedy of every warning, the most serious first."""
    codes = advice()
    ordered = by_severity(warnings)
    rows = [
        (
            prose(place_of(w)),
            prose(sentence(w.message)),
            prose(codes[w.code].meaning),
            prose(codes[w.code].remedy),
            Cell(w.code, "code"),
        )
        for w in ordered
    ]
    heads = ("where", "observed", "meaning", "what to do", "code")
    yield from table("Warnings", heads, rows, heading=False)
    if rows:
        yield paragraph("Each code has a section in ", Span(TROUBLESHOOTING_PAGE, kind="code"), ".")


def sentence(text: str) -> str:
    """Text with a capital letter and a full stop; a name at the beginning stays as it is."""
    first = text.split(" ", 1)[0]
    is_word = first.isalpha() and first.islower()
    text = text[:1].upper() + text[1:] if is_word else text
    return text if text.endswith((".", "?", "!")) else f"{text}."


def place_of(warning: Diagnostic) -> str:
    """The place of a warning; a file by its name, since its folder is at the end of the page."""
    return short_place(warning.places)


def _severity_rank(warning: Diagnostic) -> int:
    return list(advice()).index(warning.code)
