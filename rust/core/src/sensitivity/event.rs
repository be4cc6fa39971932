//! Derivatives of the margin of a friction event with respect to the motion and to parameters.

use std::ops::Range;

use crate::arm::Arm;
use crate::arm::transmission::{coupled, share};
use crate::joint::effects::EFFECT_PARAMETER_COUNT;
use crate::joint::gear::{Gears, MAX_LAW_PARAMETERS, Spring};
use crate::joint::transmission::DRIVE;
use crate::plant::Plant;
use crate::plant::config::JointConfig;
use crate::plant::friction::Motion;
use crate::scalar::Real;
use crate::sensitivity::effect::EffectSensitivity;
use crate::sensitivity::forcing::moves_coupled;
use crate::sensitivity::holding::Holding;
use crate::sensitivity::tangent::Tangent;

/// Largest number of parameters of a joint: drive, gear law, damping, settling time and effects.
const MAX_JOINT_PARAMETERS: usize = DRIVE.len() + MAX_LAW_PARAMETERS + 2 + EFFECT_PARAMETER_COUNT;

/// Linear form of the derivatives of [`Plant::margins`] at the event at the end of a span.
pub(crate) struct EventSensitivity<const N: usize> {
    pub(crate) joint: usize,
    /// Joints on which the margin depends.
    coupled: Range<usize>,
    /// Derivatives with respect to torsions, and to n dtheta_M and dtheta_L times half a step.
    torsion: [f64; N],
    motor: [f64; N],
    link: [f64; N],
    /// Derivative with respect to the joint's motor torque.
    torque: f64,
    /// Derivatives with respect to each parameter of the joints, in the order of their names.
    by_parameter: ByParameter<N>,
    /// The same with the effects of further variants.
    of_variants: Vec<ByParameter<N>>,
}

type ByParameter<const N: usize> = [[f64; MAX_JOINT_PARAMETERS]; N];

impl<const N: usize> EventSensitivity<N> {
    /// At the event of a joint at the end of a span. `half` [s] is half a step; `requested` are the
    /// joints with the effects of size zero.
    ///
    /// The margin of a motor that stops instantly is its speed. Otherwise it is the friction limit
    /// minus the holding torque; for a sliding motor that will settle, times -tau/m_M.
    #[inline(always)]
    pub(crate) fn new<A: Arm<N>, S: Real, G: Gears, L: Real>(
        plant: &Plant<A, S, G, N>,
        requested: &[JointConfig; N],
        effects: &[EffectSensitivity<L, N>],
        end: &Motion<S, N>,
        (joint, half): (usize, f64),
    ) -> Self {
        let mut slopes = Self {
            joint,
            coupled: coupled(&plant.arm, joint),
            torsion: [0.0; N],
            motor: [0.0; N],
            link: [0.0; N],
            torque: 0.0,
            by_parameter: [[0.0; MAX_JOINT_PARAMETERS]; N],
            of_variants: Vec::new(),
        };
        let drive = &plant.joints[joint];
        let plain = |number: S| number.lane(0);
        let slides = plain(end.modes.free[joint]) != 0.0;
        let time = plain(drive.settling_time);
        if slides && time == 0.0 {
            slopes.motor[joint] = plain(end.modes.direction[joint]) / plain(drive.ratio) / half;
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
        for i in slopes.coupled.clone() {
            slopes.torsion[i] = by_torque * holding.by_torsion[i];
            slopes.motor[i] = by_torque * holding.by_motor[i] / half;
            slopes.link[i] = by_torque * holding.by_link[i] / half;
        }
        let by = [by_torque, scale];
        let of = |effects| by_parameters(plant, requested, effects, (&holding, end), by);
        slopes.by_parameter = of(effects.first());
        slopes.of_variants = effects.iter().skip(1).map(|one| of(Some(one))).collect();
        slopes
    }

    /// Derivative along given derivatives of the motion and the torques.
    #[inline(always)]
    pub(crate) fn directional_derivative<V: Real>(&self, x: &Tangent<V, N>, torque: &[V; N]) -> V {
        let (c, mut sum) = (V::splat, V::splat(0.0));
        for i in self.coupled.clone() {
            sum = c(self.link[i]).mul_add(x.link[i], sum);
            sum = c(self.motor[i]).mul_add(x.motor[i], sum);
            sum = c(self.torsion[i]).mul_add(x.torsion[i], sum);
        }
        c(self.torque).mul_add(torque[self.joint], sum)
    }

    /// Derivatives with respect to the parameters of directions, each a joint and an index among
    /// its parameters.
    #[inline(always)]
    pub(crate) fn by_parameters<V: Real>(
        &self,
        variant: usize,
        parameters: &[Option<(usize, usize)>],
    ) -> V {
        let by_parameter = match variant {
            0 => &self.by_parameter,
            _ => self
                .of_variants
                .get(variant - 1)
                .unwrap_or(&self.by_parameter),
        };
        let mut all = V::splat(0.0);
        for (lane, parameter) in parameters.iter().enumerate() {
            if let &Some((joint, position)) = parameter {
                all.set_lane(lane, by_parameter[joint][position]);
            }
        }
        all
    }
}

/// Derivatives of a margin with respect to the parameters of all joints. `by_torque` is the
/// derivative with respect to the holding torque, `-scale` that with respect to the friction limit.
#[inline(always)]
fn by_parameters<A: Arm<N>, S: Real, G: Gears, L: Real, const N: usize>(
    plant: &Plant<A, S, G, N>,
    requested: &[JointConfig; N],
    effects: Option<&EffectSensitivity<L, N>>,
    (holding, end): (&Holding<S, N>, &Motion<S, N>),
    [by_torque, scale]: [f64; 2],
) -> ByParameter<N> {
    let mut all = [[0.0; MAX_JOINT_PARAMETERS]; N];
    // behind the drive's parameters those of the law, damping and settling time
    let of_law = |i: usize| DRIVE.len()..DRIVE.len() + requested[i].gear.parameters.len();
    for i in holding.coupled.clone() {
        let (spring, torsion) = (&plant.joints[i].spring, &holding.torsion[i]);
        let by_gear = by_torque * holding.by_gear[i];
        let slopes = spring.by_parameters(torsion.angle, &spring.shared());
        for (position, slope) in of_law(i).zip(slopes) {
            all[i][position] = by_gear * slope.lane(0);
        }
        all[i][of_law(i).end] = by_gear * torsion.rate.lane(0);
    }
    let (own, next) = (&mut all[holding.joint], of_law(holding.joint).end);
    let speed = by_torque * holding.speed;
    // the link's friction does not hold the motor
    own[..4].copy_from_slice(&[speed * holding.settling, -speed, -scale, -by_torque]);
    own[next + 1] = -speed * holding.settling * holding.settling * holding.inertia;
    let Some(effects) = effects else {
        return all;
    };
    for i in holding.coupled.clone() {
        let by_gear = by_torque * holding.by_gear[i];
        for size in effects.of(i) {
            let state = (effects.z[i], effects.base(i));
            let of_motor = [end.state.motor_angle[i], end.state.motor_velocity[i]];
            let of_motor = of_motor.map(|one| one.lane(0));
            let derivatives = size.at_event(holding, i, state, of_motor);
            let mut slope = by_gear * derivatives.gear;
            if moves_coupled(&plant.arm, i, size.size) {
                let rate = derivatives.local_ratio * of_motor[1];
                let by_moved = |k: usize| {
                    let torque =
                        holding.stiffness[k] * derivatives.error + holding.damping[k] * rate;
                    by_torque * holding.by_gear[k] * share(&plant.arm, k, i) * torque
                };
                slope = holding.coupled.clone().map(by_moved).sum();
            }
            if i == holding.joint {
                slope = slope - by_torque * derivatives.local_ratio * holding.transmitted
                    + by_torque * derivatives.motor
                    - scale * derivatives.friction;
            }
            all[i][of_law(i).end + 2 + size.position] = slope;
        }
    }
    all
}
