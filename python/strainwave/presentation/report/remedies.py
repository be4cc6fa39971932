"""What to do about each warning, and which of them weigh most."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import PurePath

from strainwave.domain import Diagnostic
from strainwave.domain.effects import all_effects
from strainwave.presentation.report.blocks import Block, Cell, Span, paragraph, prose, table

PAGE = "docs/troubleshooting.md"
"""Has a section of every code, under the code's name."""

_IN_DOUBT = {
    "implausible": (
        "Do not use the value. Check gear_ratio, torque_per_volt, the signs of the channels, "
        "and what else acts on the joint."
    ),
    "stages-disagree": (
        "Look for the causes in the order given: drive the motor with less voltage, check the "
        "clock of the fast records, the drive's dead zone, then friction."
    ),
    "torques-contradict": (
        "Fit the effect that is named, and check the torque constants all the same."
    ),
    "rejected": (
        "Do not use the value, which no longer is in the table. The stage's own warnings say what "
        "made it impossible."
    ),
    "elastic-not-validated": (
        'Record steps under the servo, or a PRBS, with use = "check": motor angles, voltages and '
        "the servo's references, and a [servo] table in the study."
    ),
    "not-tuned": (
        "Use the values of single joints meanwhile; log the angle and the voltage of every motor."
    ),
    "no-frequency-record": (
        'Add a record with use = "frequency": pseudo-random voltage on one joint.'
    ),
    "iteration-limit": "Record longer, or give better starts; do not trust the intervals.",
    "at-bounds": (
        "Look at what the records disagree on: friction that warms up, another payload, a "
        "wrong gear_ratio."
    ),
    "response-apart": (
        "Look at the Bode plot: at small amplitudes friction bends the measured points; else "
        "take the joint's values from the whole-arm fit, and check torque_per_volt."
    ),
    "grey-box-failed": "Look at the record: saturation, a link that strikes, a wrong channel.",
    "not-identifiable": (
        "Excite it more: a larger amplitude, other postures, faster reversals; or take it "
        "from the data sheet."
    ),
    "only-together": (
        "Add an experiment that moves one without the other, or hold one at its data-sheet value."
    ),
    "motor-side-limit": (
        "Add an accelerometer or an encoder to that link; more such records hardly help."
    ),
    "residual-not-noise": (
        "Read the tests of what the fit leaves: they name the frequency and what might explain it."
    ),
    "no-rigid-model": 'Add a record with use = "motion": slow, smooth, over the whole workspace.',
}
"""Where the answer itself is in doubt, the most serious first."""
_OF_DATA = {
    "saturated": "Lower the amplitude, or raise the drive's limit; those stretches were left out.",
    "spikes": "Check the sensor's cable, its shield and the plug.",
    "frozen": "Look for lost packets, a loose plug, or a sensor that hangs.",
    "encoder-steps": "Check the encoder's index and supply, and the counter's number of bits.",
    "flat-tops": "Use a sensor of larger range, or a smaller amplitude.",
    "mains-hum": "Shield and ground the sensor's cable, away from those of motors.",
    "misaligned": (
        "Check the logger's time stamps and the bandwidths of sensor and drive in the study."
    ),
    "sensor-delay": "Give the sensor's bandwidth in the study, or mend the latency of its bus.",
    "sensor-scale": "Check the sensor's calibration, its direction and its distance in the study.",
    "sensor-drift": "Let the sensor warm up before recording, and check its supply.",
    "sensor-mount": "Glue or screw the sensor down, close to the link's structure.",
    "start-rejected": "Check the signs, units and assignment of the channels.",
    "no-link-sensor": "None is needed; with a sensor on that link intervals would be narrower.",
    "silent-command": "Check that the drive held its last command, and that its node lived.",
    "recorder-stamps": "Publish those messages with a header stamp of their own.",
    "sub-sampled": "Log at least at the clock of the excitation.",
    "constant-channel": "Check the sensor's cable and the channel map.",
    "poor-excitation": (
        "Move the joints through other postures, at other accelerations, each on its own."
    ),
    "not-rigid": "Move more slowly, or trust the whole-arm fit instead.",
    "standing": "Move faster, and reverse less often.",
    "load-friction": "None is needed; simulated and exported arms leave it out.",
    "not-settled": "Record a longer or livelier motion.",
    "sliding": "Raise the amplitude, so that the motor does not stick.",
    "constant-inertia": "Excite around one posture, with less swing.",
    "interaction-amplitude": (
        "Leave the other joint free, so that it answers; or treat the joint as alone."
    ),
    "interaction-spectrum": "Excite both joints, or leave the other one free.",
    "input-richness": "Excite both joints with different sequences.",
    "inertia-mismatch": "See what friction and torque_per_volt do to either value.",
    "not-reciprocal": "Check the gear ratio, torque_per_volt and the link sensor.",
    "lag-not-slow": "Check the rigid model's friction; prefer the equations of motion's values.",
    "unstable-model": "Lower the order, or take off drifts.",
    "state-space-failed": "The physical model does without; record longer for a state-space model.",
    "transfer-function-failed": (
        "The equations of motion give the values; this second way gave none."
    ),
    "modes-failed": "The state-space model has no clear resonance: raise the amplitude.",
    "not-judged": "Record longer, so that a part can be kept for judging.",
    "pem-iteration-limit": "Lower the order, or record longer.",
    "pem-stalled": "Take off means and drifts, or lower the order.",
    "order-reduced": "Nothing for the resonances; record longer for a model of more states.",
    "negative-fit": "Do not simulate with that model: take off drifts, or change the order.",
    "pem-not-determined": "Lower the order, or excite every input.",
    "subspace-not-determined": "Take off means and drifts, or change the order.",
    "pole-near-nyquist": "Lower the order, or sample faster.",
}
"""Where the data are."""
_OF_COVERAGE = {
    "not-reached": "Use a larger amplitude, or hold the link, if the arm will be loaded that far.",
    "equivalent-stiffness": "Use the curve of the whole-arm fit; this one is an average.",
    "effect-taken-up": "Confirm it by the experiment, then name it in the joint's effects.",
    "effect-left-out": "Take it out of the joint's effects, or record slow motions and reversals.",
    "friction-settles": "Nothing: the fit allows for it, and a simulation may leave it out.",
    "nothing-to-predict": (
        "Nothing, if the channel is meant to rest; else move that joint in a check record."
    ),
    "reordered": "Nothing: the messages were put in the order of their stamps.",
    "resampled": "Nothing, if the motion is slow; else log at even steps.",
}
"""Of what the answer covers."""
MILD = frozenset(
    {
        "equivalent-stiffness",
        "effect-left-out",
        "effect-taken-up",
        "friction-settles",
        "elastic-not-validated",
        "nothing-to-predict",
        "reordered",
        "resampled",
    }
)
"""Of the codes those that take nothing from the answer."""
_UNHEARD = "See the message."


def remedies() -> Mapping[str, str]:
    """By code, the most serious first."""
    likely = {effect.warning_code: effect.remedy for effect in all_effects()}
    return _IN_DOUBT | likely | _OF_DATA | _OF_COVERAGE


def most_serious(warnings: Iterable[Diagnostic]) -> Diagnostic:
    """The warning that takes most from the answer; of equals the first.

    Parameters
    ----------
    warnings : iterable of Diagnostic
        At least one.

    Returns
    -------
    Diagnostic
    """
    return min(warnings, key=_weight)


def by_weight(warnings: Iterable[Diagnostic]) -> list[Diagnostic]:
    """The most serious first; of equals in their order.

    Parameters
    ----------
    warnings : iterable of Diagnostic

    Returns
    -------
    list of Diagnostic
    """
    return sorted(warnings, key=_weight)


def warnings_table(warnings: Iterable[Diagnostic]) -> Iterator[Block]:
    """Every warning with its remedy, the most serious first, and where more is said of each.

    Parameters
    ----------
    warnings : iterable of Diagnostic

    Yields
    ------
    Block
    """
    known = remedies()
    rows = [
        (
            prose(place_of(w)),
            prose(w.message),
            prose(known.get(w.code, _UNHEARD)),
            Cell(w.code, "code"),
        )
        for w in by_weight(warnings)
    ]
    yield from table("Warnings", ("where", "what", "what to do", "code"), rows, heading=False)
    if rows:
        anchors = dict.fromkeys(f"{PAGE}#{w.code}" for w in by_weight(warnings))
        lead = "Cause and consequence of each code are in the documentation: "
        yield paragraph(lead, *_listed(Span(anchor, kind="code") for anchor in anchors), ".")


def _listed(spans: Iterable[Span]) -> Iterator[Span]:
    for k, span in enumerate(spans):
        if k:
            yield Span(", ")
        yield span


def place_of(warning: Diagnostic) -> str:
    """Where it is; of a file its name alone, the folders stand at the end of the page."""
    return PurePath(warning.where).name


def _weight(warning: Diagnostic) -> int:
    order = list(remedies())
    return order.index(warning.code) if warning.code in order else -1
