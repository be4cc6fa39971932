"""Effects of the gear: hysteresis, kinematic error, backlash, stiffness curve."""

from __future__ import annotations

from collections.abc import Mapping

from strainwave.domain.effects.interface import Effect, KnownJoint, Values

_TWIST_SHARE = 0.1  # of the largest torsion; gears of the catalogue have 0.05 to 0.15


class Hysteresis(Effect):
    """The gear's torque depends on the direction of its torsion.

    Hysteresis, (S11): Dahl torque T_h z added to the spring, dz = (ddelta - |ddelta| z)/delta_h.
    """

    name = "hysteresis"
    sizes = ("hysteresis_torque",)
    typical_size = 0.02
    relative_to = "largest_torque"
    shapes: Mapping[str, float] = {"hysteresis_twist": 1.5e-4}
    needs_elastic_gear = True
    description = "hysteresis of the gear torque over the torsion"
    consequence = "damping and the lowest slope of the stiffness are biased"
    experiment = "hold the link and turn the motor slowly back and forth up to several torques"
    record = "a record of slow reversals"

    def tested_shapes(self, joint: KnownJoint) -> tuple[Values, ...]:
        """The usual twist, or that of a soft gear: a tenth of its largest torsion."""
        (usual,) = super().tested_shapes(joint)
        twist = max(*usual.values(), _TWIST_SHARE * joint.largest_torsion)
        return ({"hysteresis_twist": twist},)


class KinematicError(Effect):
    """The gear's ratio varies with the motor angle.

    Kinematic error, (S12): a cos(k q_M) + b sin(k q_M) added to the gear's torsion.
    """

    name = "kinematic-error"
    sizes = ("kinematic_error_cos", "kinematic_error_sin")
    typical_size = 1e-4  # [rad] link side, about 1/3 arc minute
    # periods per motor turn: the lobes of a wave generator; eccentricity, second harmonic
    shapes: Mapping[str, float] = {"kinematic_error_order": 2.0}
    tested: Mapping[str, tuple[float, ...]] = {"kinematic_error_order": (1.0, 4.0)}
    defaults = shapes
    needs_elastic_gear = moves_output = True
    description = "a periodic error of the gear over the motor angle, usually twice per turn"
    consequence = "its excitation of a resonance biases the gear's damping and stiffness"
    experiment = (
        "turn the motor at constant speed for many turns and look for spectral lines per turn"
        " in the accelerometers, most often at order two"
    )
    record = "a record of slow rotation at constant speed"


class Backlash(Effect):
    """Dead band of the gear.

    Backlash, (S18): the spring acts only on the torsion beyond +-b_G.
    """

    name = "backlash"
    sizes = ("backlash",)
    typical_size = 0.1
    relative_to = "largest_torsion"
    needs_elastic_gear = True
    description = "a dead band of the gear"
    consequence = "the estimated stiffness at small torques is too low"
    experiment = "hold the link and turn the motor back and forth through zero torque"
    record = "a record of small motion through zero torque"


class StiffnessCurve(Effect):
    """Stiffness that changes with the torsion, where the model has one stiffness.

    It is a gear law: `spring` states it, and `effects` cannot. The score test is that of the cubic
    term. The fit has three slopes, which follow any curve.
    """

    name = "stiffness-curve"
    sizes = ("gear_stiffness_cubic",)
    tested_law = "cubic"
    fitted_law = "three-slope"
    needs_elastic_gear = True
    description = "a stiffness that changes with the torque, as that of strain-wave gears"
    consequence = "the stiffness is an equivalent one at the amplitude of the records"
    experiment = "compare the anti-resonances of one excitation at three or more amplitudes"
    record = "a sweep of amplitudes"
    setting = 'spring = "auto" or "three-slope"'
