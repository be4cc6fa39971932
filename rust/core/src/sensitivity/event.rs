//! Derivatives of the margin of a friction event with respect to the motion and to parameters.

use crate::arm::Arm;
use crate::joint::effects::EFFECT_PARAMETER_COUNT;
use crate::joint::gear::{Gears, MAX_LAW_PARAMETERS, Spring};
use crate::joint::transmission::DRIVE;
use crate::plant::Plant;
use crate::plant::config::JointConfig;
use crate::plant::friction::Motion;
use crate::scalar::Real;
use crate::sensitivity::effect::EffectSensitivity;
use crate::sensitivity::holding::Holding;
use crate::sensitivity::tangent::Tangent;

/// Largest number of parameters of a joint: drive, gear law, damping, settling time and effects.
const MAX_JOINT_PARAMETERS: usize = DRIVE.len() + MAX_LAW_PARAMETERS + 2 + EFFECT_PARAMETER_COUNT;

/// Linear form of the derivatives of [`Plant::margins`] at the event at the end of a span.
pub(crate) struct EventSensitivity {
    pub(crate) joint: usize,
    /// Derivatives with respect to the joint's torsion, and to n dtheta_M and dtheta_L times half a
    /// step.
    torsion: f64,
    motor: f64,
    link: f64,
    /// Derivative with respect to the joint's motor torque.
    torque: f64,
    /// Derivatives with respect to each of the joint's parameters, in the order of their names.
    by_parameter: [f64; MAX_JOINT_PARAMETERS],
}

impl EventSensitivity {
    /// At the event of a joint at the end of a span. `half` [s] is half a step; `requested` is the
    /// joint with the effects of size zero.
    ///
    /// The margin of a motor that stops instantly is its speed. Otherwise it is the friction limit
    /// minus the holding torque; for a sliding motor that will settle, times -tau/m_M.
    #[inline(always)]
    pub(crate) fn new<A: Arm<N>, S: Real, G: Gears, L: Real, const N: usize>(
        plant: &Plant<A, S, G, N>,
        requested: &JointConfig,
        effects: Option<&EffectSensitivity<L, N>>,
        end: &Motion<S, N>,
        (joint, half): (usize, f64),
    ) -> Self {
        let mut slopes = Self {
            joint,
            torsion: 0.0,
            motor: 0.0,
            link: 0.0,
            torque: 0.0,
            by_parameter: [0.0; MAX_JOINT_PARAMETERS],
        };
        let drive = &plant.joints[joint];
        let plain = |number: S| number.lane(0);
        let slides = plain(end.modes.free[joint]) != 0.0;
        let time = plain(drive.settling_time);
        if slides && time == 0.0 {
            slopes.motor = plain(end.modes.direction[joint]) / plain(drive.ratio) / half;
            return slopes;
        }
        let holding = Holding::new(plant, end, joint);
        let (side, scale) = if slides {
            let mobility = plain(drive.motor_mobility);
            (plain(end.modes.direction[joint]), time * mobility)
        } else {
            (holding.torque.signum(), -1.0)
        };
        let by_torque = side * scale;
        slopes.torque = by_torque;
        slopes.torsion = by_torque * holding.by_torsion;
        slopes.motor = by_torque * holding.by_motor / half;
        slopes.link = by_torque * holding.by_link / half;
        slopes.by_parameter = by_parameters(
            &drive.spring,
            requested,
            effects,
            &holding,
            [by_torque, scale],
        );
        slopes
    }

    /// Derivative along given derivatives of the motion and the torques.
    #[inline(always)]
    pub(crate) fn directional_derivative<V: Real, const N: usize>(
        &self,
        x: &Tangent<V, N>,
        torque: &[V; N],
    ) -> V {
        let (c, i) = (V::splat, self.joint);
        let sum = c(self.motor).mul_add(x.motor[i], c(self.link) * x.link[i]);
        let sum = c(self.torsion).mul_add(x.torsion[i], sum);
        c(self.torque).mul_add(torque[i], sum)
    }

    /// Derivatives with respect to the parameters of directions, each a joint and an index among
    /// its parameters.
    #[inline(always)]
    pub(crate) fn by_parameters<V: Real>(&self, parameters: &[Option<(usize, usize)>]) -> V {
        let mut all = V::splat(0.0);
        for (lane, parameter) in parameters.iter().enumerate() {
            if let &Some((joint, position)) = parameter
                && joint == self.joint
            {
                all.set_lane(lane, self.by_parameter[position]);
            }
        }
        all
    }
}

/// Derivatives of a margin with respect to the parameters of its joint. `by_torque` is the
/// derivative with respect to the holding torque, `-scale` that with respect to the friction limit.
#[inline(always)]
fn by_parameters<S: Real, L: Real, const N: usize>(
    spring: &impl Spring<S>,
    requested: &JointConfig,
    effects: Option<&EffectSensitivity<L, N>>,
    holding: &Holding<S>,
    [by_torque, scale]: [f64; 2],
) -> [f64; MAX_JOINT_PARAMETERS] {
    let mut by = [0.0; MAX_JOINT_PARAMETERS];
    let (speed, by_gear) = (by_torque * holding.speed, -by_torque * holding.ratio);
    by[..4].copy_from_slice(&[speed * holding.settling, -speed, -scale, -by_torque]);
    // the link's friction does not hold the motor
    let mut next = DRIVE.len();
    let of_law = spring.by_parameters(holding.torsion, &spring.shared());
    for slope in &of_law[..requested.gear.parameters.len()] {
        by[next] = by_gear * slope.lane(0);
        next += 1;
    }
    by[next] = by_gear * holding.rate;
    by[next + 1] = -speed * holding.settling * holding.settling * holding.inertia;
    if let Some(effects) = effects {
        for size in effects.of(holding.joint) {
            let derivatives = size.at_event(
                holding,
                effects.z[holding.joint],
                effects.base(holding.joint),
            );
            let gear = by_gear * derivatives.gear
                - by_torque * derivatives.local_ratio * holding.transmitted;
            by[next + 2 + size.position] =
                gear + by_torque * derivatives.motor - scale * derivatives.friction;
        }
    }
    by
}
