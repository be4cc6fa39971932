"""Explanations of the options of each stage, and of their defaults."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

STAGE_TITLES: Mapping[str, str] = {
    "rigid": "Rigid model",
    "links": "Link motion",
    "responses": "Frequency responses",
    "statespace": "State-space models",
    "physical": "Physical parameters of a joint",
    "tuning": "Whole-arm fit",
}


@dataclass(frozen=True, slots=True)
class OptionText:
    """What an option does, and why its default is what it is."""

    meaning: str
    default: str  # in words
    reason: str


OPTION_TEXTS: Mapping[str, OptionText] = {
    "rigid.bandwidth_hz": OptionText(
        "Low-pass of the rigid model's equations [Hz].",
        "from the data",
        "The search takes the widest band in which the estimates do not change with the band.",
    ),
    "links.time_constant": OptionText(
        "Time constant T_V [s] of the fusion of link velocities, equation (10).",
        "0.2 s",
        "The acceleration gives the velocity above 0.8 Hz, the motor encoder below.",
    ),
    "links.order": OptionText(
        "Order of the fusion's low-pass.",
        "2",
        "Second order suppresses the bias of an accelerometer.",
    ),
    "links.bandwidth_hz": OptionText(
        "Zero-phase low-pass of all signals of the step [Hz].",
        "none",
        "A filter is needed only where angles are differentiated twice; then it is automatic.",
    ),
    "responses.inputs": OptionText(
        "Number of inputs of the nonparametric responses; 1 leaves out the interaction torque.",
        "all",
        "Without the interaction torque, the response of a moving arm is biased.",
    ),
    "responses.segment": OptionText(
        "Segment of Welch's method [s].",
        "a period, or a quarter of the record",
        "One PRBS period has no leakage.",
    ),
    "responses.transient_periods": OptionText(
        "PRBS periods that are left out at the start.",
        "1",
        "The first period contains the transient.",
    ),
    "statespace.order": OptionText(
        "Order of the state-space models, 2 to 10.",
        "selected by held-out data",
        "A two-inertia joint has three states; further ones describe what the model lacks.",
    ),
    "statespace.outputs": OptionText(
        "Outputs: motor and link velocity, or the motor velocity alone.",
        "both",
        "The link velocity separates zeros from poles.",
    ),
    "statespace.inputs": OptionText(
        "Inputs: motor torque and interaction torque, or the motor torque alone.",
        "both",
        "The interaction torque as second input decouples the joints.",
    ),
    "statespace.method": OptionText(
        "Prediction-error method (pem), or a subspace method without standard deviations.",
        "pem",
        "It is efficient, holds under feedback and gives intervals.",
    ),
    "statespace.focus": OptionText(
        "The best predicting model, or the best stable one.",
        "prediction",
        "An unstable slow pole shows residual friction; the resonances are not affected.",
    ),
    "statespace.horizon": OptionText(
        "Past samples of the subspace step.",
        "Akaike's criterion",
        "The order of an autoregression that predicts the data well.",
    ),
    "statespace.decimation": OptionText(
        "Only every k-th sample is used.",
        "from the band",
        "The sample rate follows the band of the resonances.",
    ),
    "statespace.sample_time": OptionText(
        "Sampling period [s] after downsampling, in place of the factor.",
        "from the band",
        "The sample rate follows the band of the resonances.",
    ),
    "statespace.filter": OptionText(
        "Filter of the records: band-pass, or the decimation of the paper.",
        "band",
        "A band around the resonances removes drift and friction at standstill.",
    ),
    "statespace.band_hz": OptionText(
        "Lowest and highest frequency [Hz] of the filter.",
        "from the resonances",
        "The band contains the anti-resonance and the resonance.",
    ),
    "physical.route": OptionText(
        "Physical parameters from the equations of motion, or from the transfer function.",
        "equations",
        "The equations use both velocities and the rigid model; equations (15) to (18) do not.",
    ),
    "physical.band_hz": OptionText(
        "Lowest and highest frequency [Hz] of the equations' filter.",
        "from the data",
        "The band with the smallest estimated error.",
    ),
    "physical.use_rigid": OptionText(
        "Whether values of the rigid model are used.",
        "true",
        "Slow motion determines total inertia and friction better than fast records do.",
    ),
    "tuning.as_published": OptionText(
        "The fine tuning of the paper: step records in closed loop only.",
        "false",
        "All elastic records together give smaller errors.",
    ),
    "tuning.ranges": OptionText(
        "Ranges of parameters over their starting values: { gear_damping = [0.5, 2.0] }.",
        "wide",
        "The data limit the parameters.",
    ),
    "tuning.hold": OptionText(
        'Parameters that stay at their starting values: ["gear_damping 2"].',
        "none",
        "Every parameter is estimated.",
    ),
    "tuning.cutoff_hz": OptionText(
        "Low-pass of the compared signals [Hz].",
        "5 times the highest resonance",
        "Above it the records contain noise only.",
    ),
    "tuning.settling": OptionText(
        "Whether Coulomb friction has a settling time.",
        "if the data show it",
        "Most drives need none.",
    ),
    "tuning.closed_loop": OptionText(
        "Simulate the servo from references instead of recorded voltages.",
        "false",
        "Recorded voltages need no exact model of the servo.",
    ),
    "tuning.least_deviation": OptionText(
        "Smallest relative standard deviation of the rigid step's values in the fit.",
        "0.002",
        "Errors of the model are about this large even where the noise is smaller.",
    ),
    "tuning.max_iterations": OptionText(
        "Evaluations of the fit, and of each further model.",
        "100",
        "Most fits converge within 15.",
    ),
    "tuning.rival_effort": OptionText(
        "Work on fits that tell likely causes of unexplained residuals apart; 0 skips them.",
        "1",
        "The usual budget finds the cause in most cases.",
    ),
}
