"""Text of warnings and places: a template for each code, or for each variant of a code.

A template is a format string. Conversions: `!p` per cent, `!m` thousandths, `!u` millionths, `!a`
a list with commas and "and", `!o` with ", or ", `!e` with ", and ", `!s` with semicolons. `|` ends
the observation of a warning and is not part of the text. `domain.fault_messages` has the templates
of suspected faults.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import PurePath
from string import Formatter

from strainwave.domain.clauses import Clause, Place, Span, Value
from strainwave.domain.fault_messages import FAULTS

_RECORD_ALL_JOINTS = (
    "record all joints moving together, in both directions, at varied speeds and postures"
)
_CLOCK = "time stamps are not uniform (steps of {shortest:.2f} to {longest:.2f} periods): "
_SLOW_CLOCK = "|; motion faster than the widest step is lost. Log with a fixed clock if possible"
_STOPPED = (
    "the search stopped {decrease:.2g} of log-likelihood short of an optimum, mostly because that"
    " lies where the predictor is unstable|. Take off means and drifts, lower the order, or "
)
_PREDICTED = (
    "{channel} is predicted with a fit of {fit:.3g} %, an error of {ratio:.2g} times what noise,"
    " friction, the intervals and the residuals of the fit explain"
)
_RATIO = "n tau is {ratio:.3g} times u"
_INERTIA = "the link's own inertia changes by {change!p:.2g} %"
_SPECTRUM = "tau is above its noise in {share!p:.0f} % of the band"
_SLIDING = "the motor slides in {share!p:.0f} % of the record"

TEMPLATES: Mapping[str, str] = {
    # logs
    "resampled/grid": _CLOCK
    + "resampled to {n_samples} samples every {period:.6g} s"
    + _SLOW_CLOCK,
    "resampled/ticks": _CLOCK
    + "up to {offset!p:.2g} % of a period from a clock of {period:.6g} s: resampled to its"
    " {n_samples} ticks" + _SLOW_CLOCK,
    "resampled/topics": "{topics}: resampled to the time stamps of {clock}, measured values by"
    " monotone cubics, commands held|; motion faster than the rate of a topic is lost. Publish all"
    " topics from one clock if possible",
    "split": "the time stamps have {n_gaps} pause(s) of up to {longest:.3g} s and step back"
    " {n_back} time(s): the record is split into {n_segments} segment(s), each used as a record of"
    " its own, and {n_rows} row(s) are left out|. Check the logger if the pauses are not intended",
    "repeated-stamps": "{count} row(s) repeat the time stamp of the row before|: they are not used."
    " Check the clock of the logger",
    "held-samples": "{columns} update only every {rows:.3g} rows of the log ({rate_hz:.4g} Hz), and"
    " the values are held in between|: the record is reduced to the updates. Motion faster than"
    " their rate is lost. Log the rate of the bus",
    "held-samples/some": "{columns} update only every {rows:.3g} rows of the log ({rate_hz:.4g}"
    " Hz), slower than other columns|: only the updates are used, interpolated; they may be late by"
    " up to one row. Read all signals at one rate",
    "missing-values": "{columns} have {count} missing value(s)|: short gaps are interpolated, and"
    " stretches without values are left out. Check the logger",
    "integrated-velocity": "theta_m{joint} is not logged|: it is the integral of omega_m{joint}"
    " from zero. Log the angle if possible",
    "reordered": "{n_late} message(s) of {topic} are out of order, and {n_equal} repeat a time"
    " stamp: the messages were sorted, and only the last message of each time stamp is used",
    "recorder-stamps": "the messages of {topics} have no header stamp: the time stamps of the"
    " recorder are used, which lag by {delay!m:.3g} ms in the other topics|. Publish {topics} with"
    " a header if possible",
    "silent-command": "{topic} sends nothing from {start:.6g} to {stop:.6g} s: the last value is"
    " held|. Check that the drive held this value",
    "torque-sensor": "the torque of a sensor behind the gear is read as '{channel}'|. If the motor"
    ' measures it, set meaning = "motor" in [channels]',
    "constant-channel": "the channel '{channel}' never changes|. Check the sensor and the map",
    "saturated": "{channel} is at its limit for {share!p:.1f} % of the record|; these samples are"
    " not used. Record a slower motion",
    "spikes": "{channel} has {count} of up to {size:.3g} {times}|; {consequence}. Check the cable,"
    " its shield and the connector",
    "frozen": "{channel} repeats one value while the arm moves {times}|; {consequence}. Check for"
    " lost packets, a loose connector, or a sensor that stopped updating",
    "encoder-steps": "{channel}: a step that is inconsistent with the motion, by {size:.4g} rad,"
    " {times}|; {consequence}. Check the index pulse and supply of the encoder, and the bits of the"
    " counter",
    "encoder-steps/overflow": "{channel}: the counter wraps, by {size:.4g} rad, {times}|;"
    " {consequence}. Check the index pulse and supply of the encoder, and the bits of the counter",
    "flat-tops": "{channel} is at the end of its range, {level:.4g}, {times}|; {consequence}. Use a"
    " sensor with a larger range, or a smaller amplitude",
    "mains-hum": "{channel} has hum at {frequency_hz:.0f} Hz with an amplitude of up to"
    " {amplitude:.2g}|; the hum is not removed. Shield and ground the sensor cable, and route it"
    " away from motor cables",
    # rigid step
    "standing": "motor {joint} may stick in {share!p:.0f} % of the record|; these samples contain"
    " no information on its friction; move faster and reverse less often",
    "standing/planned": "the motor of joint {joint} sticks for {share!p:.0f} % of the record, which"
    " then gives no information|; allow more voltage or velocity",
    "poor-excitation": "condition number {condition:.0f}: the records poorly separate {names}|; "
    + _RECORD_ALL_JOINTS,
    "poor-excitation/planned": "condition number {condition:.0f}: the motion separates the rigid"
    " parameters poorly|; allow more voltage, velocity or angle",
    "not-identifiable/reason": "{reason}",
    "not-identifiable/joint-at-rest": "joint {joint} does not move|; record a motion in which it"
    " does",
    "not-identifiable/one-way": "joint {joint} moves in one direction only, so that Coulomb"
    " friction and offset are not separately identifiable|; record motion in both directions",
    "not-identifiable/joints-at-rest": "joint {joints} does not move|; " + _RECORD_ALL_JOINTS,
    "not-identifiable/not-separable": "these records cannot separate it from {others}|; "
    + _RECORD_ALL_JOINTS,
    "not-identifiable/no-information": "these records contain too little information on it|; "
    + _RECORD_ALL_JOINTS,
    "not-identifiable/wide": "{records} determine the value only to {estimate}|{split}",
    "not-identifiable/whole-arm": "the data give only {estimate}|{split}",
    "not-identifiable/no-bend": "the records do not show whether the gear bends there|; record more"
    " motion at small torques",
    "implausible/rigid": "{value:.3g} {unit} is negative beyond its uncertainty: the data"
    " contradict a rigid arm with Coulomb and viscous friction",
    "implausible": "{estimate} is physically impossible: the model of the joint does not describe"
    " {records}",
    "not-settled": "after {iterations} iterations a parameter still changes by {change:.1f}"
    " standard deviations|; record a longer or more varied motion",
    "estimated-drive": "the torque per volt is estimated as {value:.4g} +- {share!p:.2g} %|; all"
    " inertias, friction and stiffness scale with it, and the intervals of the decoupled and the"
    " tuned stage do not contain its error. Record a heavier payload if it limits the accuracy",
    "friction-term": "{description}: {label} is {value:.3g} +- {std:.2g} {unit}|. Predictions of"
    " the rigid model include this; simulations and exports do not",
    "torque-at-link": "the logs have the torque of joint {joints} behind the gear only|. The"
    " results are those of the links, without the rotors' inertias and the motors' friction,"
    " and friction values are those between sensor and link",
    "friction-term/zero": "the joint angle exceeds the encoder reading by {value:.4g} +- {std:.2g}"
    " {unit}|, if gravity acts as the study states and the link's centre of mass is where the kind"
    " of arm places it. All values belong to the corrected angle",
    "friction-term/delay": "the torque is logged {value!m:.3g} +- {std!m:.2g} ms behind the"
    " motion|. The fit corrects the delay, which otherwise turns inertia into viscous friction",
    "load-friction": "friction increases by {share:.3f} +- {std:.3f} of the load|. Predictions of"
    " the rigid model include this; simulations and exports do not",
    "not-rigid": "the anti-resonance at {anti_resonance_hz:.1f} Hz is too close to the motion band"
    " of {bandwidth_hz:.1f} Hz for a rigid model|; move more slowly",
    "no-rigid-model": "{reason}",
    "nothing-to-predict/rest": "no fit is reported for {channel}: its motor rests, or the signal"
    " does not exceed its noise",
    "nothing-to-predict/reason": "{record} {reason}",
    # links and decoupling
    "no-link-sensor": "link {joint} has no sensor: only the response of motor {joint} determines"
    " its gear|. Add an accelerometer, a link encoder or the deflection for narrower intervals",
    "sub-sampled": "the voltage changes every {clock:g} s but is logged every {sample_time:g} s:"
    " the log misses changes|. Log at the PRBS clock or faster",
    "misaligned": "{channel} is {delay!m:.3g} +- {std!m:.2g} ms {side} the motor encoder|; the"
    " channel was not shifted. Check the time stamps of the logger, and the bandwidths in the study"
    " (accelerometer_hz, gyro_hz, current_loop_hz)",
    "sensor-delay": "the link sensor is {delay!m:.3g} ± {half!m:.2g} ms {side} the motor encoder|;"
    " its channel was shifted by this delay. Likely causes: a missing sensor bandwidth in the"
    " study, latency of its converter or bus, wrong time stamps",
    "sensor-delay/fitted": "the {sensor} is {delay!m:.3g} ± {half!m:.2g} ms {side} the motor"
    " encoder|. The fit corrects the delay. Likely causes are a bandwidth that is missing from the"
    " study, latency of the converter or bus, and time stamps",
    "sensor-delay/torque": "the motor encoder is {delay!m:.3g} ± {half!m:.2g} ms {side} the logged"
    " torque|. The fit corrects the delay. Drives filter and sample their torque at times of their"
    " own: log the voltage to avoid the unknown",
    "sliding/passed": _SLIDING,
    "sliding": _SLIDING + "|; stiction biases the inertia of a linear model: raise the amplitude",
    "constant-inertia/passed": _INERTIA,
    "constant-inertia": _INERTIA + ", all of it in tau|; keep the swing of joint {joint} small",
    "interaction-amplitude/passed": _RATIO,
    "interaction-amplitude": _RATIO + "|; too small to estimate its effect",
    "interaction-spectrum/passed": _SPECTRUM,
    "interaction-spectrum": _SPECTRUM + "|; raise the amplitude",
    "input-richness/passed": "u and tau differ: eigenvalue ratio {ratio:.3g}, median of"
    " {low_hz:.1f} to {high_hz:.1f} Hz",
    "input-richness": "tau is nearly a linear function of u (eigenvalue ratio {ratio:.1g})|; excite"
    " all joints at once with independent sequences",
    "no-frequency-record": 'the study has no record with use = "frequency" or "sweep": without one'
    " the gears start from typical values in the whole-arm fit, if there are step records, and only"
    " link encoders show their stiffness in slow motion|; record a PRBS on each joint",
    "rigid-joints": "joint {joints!a} is rigid|: the whole-arm fit, which models elastic gears, is"
    " not made",
    "rigid-joints/unused": "joint {joints!a} is rigid: {records} are not used|, and the whole-arm"
    " fit, which models elastic gears, is not made",
    "no-torsion": "the torsion of gear {joint} does not follow the torque of its link|; record"
    " motion in which gravity or acceleration loads the gear more",
    "subspace-not-determined": "the predictor diverges on its own data|. Take off means and drifts,"
    " or change the order",
    "pem-iteration-limit": "not converged after {iterations} steps|; {decrease:.2g} of"
    " log-likelihood seems left. Raise max_iterations, or lower the order",
    "pem-stalled": _STOPPED + "fit an output-error model",
    "pem-stalled/output-error": _STOPPED + "estimate K",
    "pem-not-determined": "the data leave a direction of the model open, so no covariance is"
    " given|. Lower the order, or excite every input",
    "order-reduced": "the data ask for {order} states, but no such model converges with a"
    " resonance: this has {reduced}",
    "negative-fit": "simulated from the inputs alone it is worse than a constant ({fits}), though"
    " it predicts one step ahead: its response to the inputs is not to be trusted|. Take off"
    " drifts, change the order, or estimate an output-error model",
    "unstable-model": "the slowest pole grows by {rate:.2g} 1/s, as friction that is not quite"
    " taken off makes it seem|; the simulated fit means nothing, resonances are not touched",
    "stability-enforced": "without the constraint to stable models, a pole has the modulus"
    " {modulus:.4g}|; the resonances are hardly affected, the response below them is doubtful",
    "pole-near-nyquist": "a pole at {frequency_hz:.3g} Hz, with samples at {rate_hz:.3g} Hz, may be"
    " the alias of a faster one|. Lower the order, or sample faster",
    # parameters of a joint
    "equivalent-stiffness": "equivalent stiffness at the torsion in {records}: {note}",
    "equivalent-stiffness/undecided": "the records load the gear up to {torque:.3g} {unit}, and its"
    " stiffness may change by {change!p:.2g} % over this load|; the value is the equivalent"
    " stiffness at this load. Record a larger amplitude, and a link sensor if there is none",
    "not-reciprocal": "G12 and G21 agree only to {agreement:.0f} %, but a joint is reciprocal:"
    " check gear_ratio, torque_per_volt and the link sensor",
    "lag-not-slow": "the slow lag of the joint is close to its anti-resonance, so (18) is"
    " inaccurate",
    "inertia-mismatch": "the inertia at the resonance is {ratio:.2f} times that of the rigid model:"
    " check friction and torque_per_volt",
    "response-apart": "the physical model and the measured response differ by more than both 95 %"
    " bands on {share!p:.0f} % of the lines, by {difference_db:.0f} dB near {frequency_hz:.3g} Hz",
    "grey-box-failed": "{reason}",
    "state-space-failed": "{reason}",
    "modes-failed": "{reason}",
    "not-judged": "{reason}",
    "transfer-function-failed": "{reason}",
    # final table
    "rejected": "{reason}|; rejected values: {values}",
    "elastic-not-validated/no-fit": "the run has no whole-arm fit, which predicts the motion",
    "elastic-not-validated/no-check": "the study has no check record|; record steps under the"
    ' servo, or a PRBS, as use = "check", with angle and voltage of every motor and the references',
    "elastic-not-validated/defect": "{defects!s}",
    "elastic-not-validated/no-effect": "{unused!s}|; supply what is missing, or record larger or"
    ' faster steps of the joint, or a PRBS, with use = "check"',
    "not-predicted/rigid": _PREDICTED
    + ", so check the payload, the voltage and the friction of that record",
    "not-predicted/servo": _PREDICTED + ", but the recorded voltages explain the motion, so correct"
    " kp, ki, period and limit of [servo], or the references of that record",
    "not-predicted/elastic": _PREDICTED
    + ", so check [servo], the references and the payload of that record",
    "not-described": "the residuals of {channel} are {noise_ratio:.2g} times the sensor's noise and"
    " {share!p:.2g} % of the signal, so the model does not describe the record{advice}",
    "implausible-size": "{values}: these sizes are outside the range of robot joints, so {remedy}",
    "urdf-mass": "link {link} weighs {mass:.3g} kg in the URDF; the torques need {low:.3g} to"
    " {high:.3g} kg|. The base parameters do not depend on the URDF; use the exported parameters"
    " instead of its inertial values, and compare the payload and the torque constants",
    "urdf-inertia": "the inertial values of link {link} in the URDF, with those of all links fixed"
    " to it, belong to no body: {mass:.3g} kg, and principal moments of {moments:.3g} kg m^2, of"
    " which each must be less than the sum of the others|. A typical body replaces them as the"
    " prior of the exported parameters; correct the file, or export it again from the drawing",
    # whole-arm fit
    "not-tuned": "{reason}",
    "not-tuned/computation": "{reason}|; the values of the earlier stages are the result. Check"
    " signs, units and assignment of the channels, gear_ratio and torque_per_volt",
    "start-rejected": "the estimate of the earlier stages, {value:.3g} {unit}, is physically"
    " impossible|; the whole-arm fit starts from the typical value {typical:.3g}",
    "sensor-scale": "the {sensor} reads {scale:.4g} ± {half:.2g} times the motion|. The fit"
    " corrects the scale. Likely causes are the calibration, the distance from the axis in the"
    " study and the direction of the sensor",
    "sensor-drift": "in {record} the {sensor} drifts by {rate:.3g} ± {half:.2g} {unit}|. The fit"
    " corrects the drift. Likely causes are warm-up, the supply, and the recovery of an amplifier",
    "sensor-mount": "the mount of the {sensor} of link {joint} resonates at {frequency_hz:.3g} ±"
    " {half:.2g} Hz|. The fit corrects it. Glue or screw the sensor to the link",
    "iteration-limit": "the fit did not converge within {iterations} iterations|; raise"
    " tuning.max_iterations or use longer records",
    "no-descent": "the fit ended where a large decrease of the cost is predicted but no step"
    " achieves it|; hold a parameter that the records hardly determine (tuning.hold), or use longer"
    " records",
    "causes-not-fitted": "{effects} might explain the residuals and were only linearised: the"
    " budget of {evaluations} evaluations for fits with one more effect was exhausted|; raise"
    " tuning.rival_effort to fit them",
    "at-bounds": "the estimate is at the limit of its range, {value:.3g} {unit}: the data"
    " contradict the model or do not determine the value",
    "not-reached": "no record loads the gear so far that it shows|; use a larger amplitude, or hold"
    " the link",
    "not-reached/simpler-law": "the gear is {law} within its errors|; use a larger amplitude or set"
    ' spring = "{law}"',
    "stages-disagree": "taken together, {subject} differ by {deviations:.1f} standard deviations"
    " (chi-square {chi_square:.4g} of {degrees} degrees), most in {largest}|; likely causes in this"
    " order: a motor constant that falls with current (record with less voltage), a clock that is"
    " fast or slow, a dead zone of the drive, another law of friction, a payload or a temperature"
    " that differs between slow and fast records",
    "torques-contradict": "{contradiction}|; the effect named in the warnings explains all records"
    " better",
    "friction-settles": "Coulomb friction reverses over {time!u:.3g} us instead of instantly|; the"
    " model includes this settling time",
    "only-together": "only a combination of these parameters is identified: they can change"
    " together by {spread!p:.2g} %|; use the combination, not the single values",
    "residual-not-noise": "the residuals of {channel} are {ratio:.2g} times its sensor's noise,"
    " most near {worst_hz:.3g} Hz{dependence}|{unexplained}; intervals were widened for it",
    "effect-taken-up": "{effect}, {description}, was added to the model ({sizes}){changes}: without"
    " it {consequence}|; to confirm it, {experiment}",
    "effect-left-out": "{effect} was fitted and removed: its size does not differ significantly"
    " from zero in the records, and the other parameters are estimated without it|; remove it from"
    " the joint's effects, or add {needed}",
    # design of experiments
    "limit-broken": "not planned: {reason}|{remedy}",
    "no-torque-limit": "the gear torque of joint {joint} reaches {torque:.3g} N m in {experiment},"
    " and no limit is set: compare it with the peak torque in the data sheet, or set"
    " --limit-torque",
    "no-servo": "the study describes no servo, so the design contains only open-loop voltages|; it"
    " lacks the motion that the rigid step needs and the steps that validate the elastic model:"
    " {remedy}; or record a slow motion of all joints by other means and add it with"
    ' use = "motion"',
    "no-servo/motions": "the study describes no servo, so the design contains only motions,"
    " which the arm's own controller follows|; it lacks the excitation of the gears and the steps"
    " that validate the elastic model: {remedy}",
    "knee-not-reached": "the gear torque of joint {joint} reaches {torque:.3g} N m, and the knees"
    " are at {knees:.3g} N m: the stiffness above is not identifiable|; allow more voltage,"
    " velocity or angle",
    "slow-clock": "the servo's clock limits the excitation to {limit_hz:.3g} Hz, but the joint"
    " needs {needed_hz:.3g} Hz|; output the voltages with a faster clock",
    # export
    "assumed/friction": "link_viscous_friction is not identified|; the model has"
    " total_viscous_friction at the motor",
    "assumed/inertia": "only the sum of {parts!a}, {sum}, is identified|; the split is arbitrary",
    "assumed/bodies": "these base parameters are not identified: {names}|; the bodies have values"
    " near those of the URDF, or near a guess by the distances of the joints",
    "study-changed": "{file} has changed since it was identified|; gear ratios, lengths and torques"
    " per volt are the present ones",
    "no-urdf": "the URDF {file} of the study does not exist, or has other joints|; the exported"
    " URDF has no meshes and no further links",
    "gravity-torque": "gravity is {law}, which differs by {error!p:+.1f} % from that of the study|;"
    " check {keys} and torque_per_volt",
    "left-out": "the lag of the current loop ({bandwidth_hz:g} Hz) is shorter than the time step of"
    " {step:g} s|; the model has none",
    "linearised": "{note}",
    # likely effects, whatever their code
    "effect-likely": "{effect} would explain {share!p:.2g} % of the residuals"
    " ({sizes}){changes}{rivals}|; the intervals contain this change; to fit it, give the joint"
    " {setting}; to confirm it, {experiment}",
}
"""Messages of warnings, by code or "code/variant"."""

CLAUSES: Mapping[str, str] = {
    "text": "{text}",
    "topic": "{name} ({rate_hz:.4g} Hz)",
    "topic/once": "{name} (once)",
    "spikes-count/one": "a spike",
    "spikes-count": "{count} spikes",
    "instant": "at {time:.6g} s",
    "interval": "from {start:.6g} to {stop:.6g} s",
    "more": "and {count} more",
    "record-not-used": "the record is not used",
    "record-not-used/other-defect": "the record is not used because of another defect",
    "channel-not-used": "the channel is not used in this record",
    "step-subtracted": "the step was subtracted from all later samples",
    "samples-not-used": "these samples are not used in the fits",
    "estimate": "{value:.3g} +- {std:.2g} {unit}",
    "estimate/no-std": "{value:.3g} {unit}",
    "viscous-split": "; only the total viscous friction is well determined",
    "fit": "{channel} {fit:.0f} %",
    "fit/below": "{channel} below {fit:.0f} %",
    "of-joint": "{name} of joint {joint}",
    "stage-difference": "{parameter} {rigid:.4g} by the rigid and {whole_arm:.4g} {unit} by the"
    " whole-arm fit",
    "subject/all": "the values",
    "subject/inertias": "inertias and gravity torques",
    "subject/friction": "joint {joint}'s friction",
    "suspect": "{subject}, which would explain {share!p:.3g} %: {experiment}",
    "suspects": ", likely causes in this order: {causes!o}",
    "suspects/none": ", so check the constants in the study",
    "follows-input": ", and follow joint {joint}'s input by {delay!m:.3g} ms: the model lacks"
    " something of the motion, or the study has a wrong constant",
    "follows-no-input": ", without linear dependence on an input: friction or a gear that the model"
    " does not describe, a wrong constant in the study and an outside disturbance look so",
    "no-effect-explains": "; none of the effects that the program knows explains them",
    "effect-size": "{name} {value:.2g} +- {std:.1g} {unit}",
    "effect-size/no-unit": "{name} {value:.2g} +- {std:.1g}",
    "changes": " and change {shifts}",
    "shift": "{parameter} by {change!p:+.2g} %",
    "rivals": "; less likely causes are {effects!a}",
    "and-remedy": "; {remedy}",
    "rejected-value": "{label} = {value:.4g}",
    "reason/calculated-effort": "the effort is calculated by a model and has no friction",
    "reason/fault": "it depends on channels that contradict each other or the study",
    "reason/contradiction": "the rigid and the whole-arm fit contradict each other",
    "reason/at-bound": "the estimate is at the limit of its range, {value:.3g} {unit}",
    "reason/gamma": "gamma^2 = {square:.3g} is not below alpha beta = {product:.3g}",
    "reason/impossible": "{value:.3g} {unit} is physically impossible",
    "check/not-simulated": "no simulation of {records!a}: {reason}",
    "check/insensitive": "20 % more gear stiffness of joint {joint} changes no channel of a check"
    " record by {limit!p:.2g} % of its standard deviation: most {channel} of {record}, by"
    " {effect!p:.2g} %",
    "check/rest": "no channel moves in the check records, so none depends on the gear of joint"
    " {joint}",
    "too-precise": "the fit fails: {label} has the value {value:.3g} with a standard deviation of"
    " {std:.2g}, which no record determines",
    "numerical-failure": "the computation fails with these data: {reason}",
    "no-rigid-stage": "the rigid stage was not reached",
    "no-decoupled-model": "the decoupled stage gave no model of joint {joints}",
    "no-whole-arm-fit": "the whole-arm fit was not reached",
    "not-converged": "the whole-arm fit did not converge",
    "defect": "{places}: {defect}",
    "primary/rejected": "rejected: {parameters}",
    "primary/not-identified": "not identified: {parameters}",
    "disagreement": "the stages disagree by {deviations:.2g} standard deviations on"
    " {subject}{causes}",
    "sized-value": "{label} = {value:.4g} {unit} (robot joints: {minimum:.2g} to {maximum:.2g})",
    "unit/unknown": "check the units of joint {joint}'s torque_per_volt, gear_ratio and columns",
    "unit/angle": "theta_m{joint} is likely in {unit}, and its column needs a scale",
    "unit/torque": "torque{joint} is likely in {unit}, and its column needs a scale",
    "unit/constant": "torque_per_volt is likely in {unit}/V and must be written as torque_per_volt"
    " = {torque_per_volt:.4g}",
}
"""Parts of messages."""

_ALL_TEMPLATES = {**TEMPLATES, **CLAUSES, **FAULTS}
_LINKS = {"a": (", ", " and "), "o": (", or ",) * 2, "e": (", and ",) * 2, "s": ("; ",) * 2}
_SCALES = {"p": 100.0, "m": 1e3, "u": 1e6}


def text_of(clause: Clause, **more: Value) -> str:
    """Text of a clause or a message; `more` has values that it may lack."""
    return _render(_ALL_TEMPLATES[clause.template], more | dict(clause.values))


def observation_of(clause: Clause, **more: Value) -> str:
    """The part of a warning's message that says what was observed."""
    observation = _ALL_TEMPLATES[clause.template].partition("|")[0]
    return _render(observation, more | dict(clause.values))


def place_text(place: Place) -> str:
    """Text of a place: "prbs-j1, joint 1", "beta", "gear_stiffness of joint 1"."""
    name = place.parameter or place.part
    if name is not None:
        return name if place.joint is None else f"{name} of joint {place.joint}"
    records = () if place.channel and len(place.experiments) > 1 else place.experiments
    parts = [place.file, *records, place.channel, place.joint and f"joint {place.joint}"]
    text = ", ".join(str(part) for part in parts if part)
    return f"{text} {place.key or ''}".strip()


def places_text(places: Sequence[Place]) -> str:
    """Text of one or several places."""
    if len(places) > 1 and all(place.parameter for place in places):
        return " and ".join(map(place_text, places))
    if len(places) > 1 and all(place == Place(joint=place.joint) for place in places):
        return f"joint {', '.join(str(place.joint) for place in places)}"
    if len(places) > 1 and all(place.is_one_record for place in places):
        joints = ["" if p.joint is None else f" (joint {p.joint})" for p in places]
        return ", ".join(p.experiments[0] + j for p, j in zip(places, joints, strict=True))
    return ", ".join(map(place_text, places))


def short_place(places: Sequence[Place]) -> str:
    """Text of the places, a file by its name."""
    files = [PurePath(place.file).name for place in places if place.file]
    return ", ".join(files) or places_text(places)


def _render(template: str, values: Mapping[str, Value]) -> str:
    return _Rendering().vformat(template.replace("|", ""), (), values)


class _Rendering(Formatter):
    """Format strings whose values are clauses, places and lists of these."""

    def convert_field(self, value: Value, conversion: str | None) -> Value | _List:
        if conversion in _LINKS:
            items = value if isinstance(value, tuple) else (value,)
            return _List(items, *_LINKS[conversion])
        scale = _SCALES.get(conversion or "", 1.0)
        if isinstance(value, Span):
            return Span(scale * value.low, scale * value.high)
        return scale * value if conversion and isinstance(value, float | int) else value

    def format_field(self, value: Value | _List, format_spec: str) -> str:
        if isinstance(value, tuple):
            value = _List(value)
        if isinstance(value, _List):
            texts = [self.format_field(item, format_spec) for item in value.items]
            return value.last_link.join(filter(None, [value.link.join(texts[:-1]), *texts[-1:]]))
        if isinstance(value, Clause):
            return text_of(value)
        if isinstance(value, Place):
            return place_text(value)
        return "" if value is None else format(value, format_spec)


@dataclass(frozen=True, slots=True)
class _List:
    items: tuple[Value, ...]
    link: str = ", "
    last_link: str = ", "
