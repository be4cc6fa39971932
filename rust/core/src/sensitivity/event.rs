//! Derivatives of the margin of a friction event with respect to the motion and to parameters.

use crate::arm::Arm;
use crate::joint::effects::MOST_OF_EFFECTS;
use crate::joint::gear::{Gears, MOST_OF_A_LAW, Spring};
use crate::joint::transmission::DRIVE;
use crate::plant::Plant;
use crate::plant::config::JointConfig;
use crate::plant::friction::Motion;
use crate::scalar::Real;
use crate::sensitivity::effect::EffectSensitivity;
use crate::sensitivity::holding::Holding;
use crate::sensitivity::tangent::Tangent;

/// Largest number of parameters of a joint: drive, gear law, damping, settling time and effects.
const MOST_OF_A_JOINT: usize = DRIVE.len() + MOST_OF_A_LAW + 2 + MOST_OF_EFFECTS;

/// Linear form of the derivatives of [`Plant::margins`] at the event at the end of a span.
pub(crate) struct EventSensitivity {
    pub(crate) joint: usize,
    /// Derivatives with respect to the joint's torsion, and to n dtheta_M and dtheta_L times half a
    /// step.
    twist: f64,
    motor: f64,
    link: f64,
    /// Derivative with respect to the joint's motor torque.
    torque: f64,
    /// Derivatives with respect to each of the joint's parameters, in the order of their names.
    by_parameter: [f64; MOST_OF_A_JOINT],
}

impl EventSensitivity {
    /// At the event of a joint at the end of a span. `half` [s] is half a step; `asked` is the
    /// joint with the effects of size zero.
    ///
    /// The margin of a motor that stops instantly is its speed. Otherwise it is the friction limit
    /// minus the holding torque; for a sliding motor that will settle, times -tau/m_M.
    #[inline(always)]
    pub(crate) fn new<A: Arm<N>, S: Real, G: Gears, L: Real, const N: usize>(
        plant: &Plant<A, S, G, N>,
        asked: &JointConfig,
        effects: Option<&EffectSensitivity<L, N>>,
        end: &Motion<S, N>,
        (joint, half): (usize, f64),
    ) -> Self {
        let mut slopes = Self {
            joint,
            twist: 0.0,
            motor: 0.0,
            link: 0.0,
            torque: 0.0,
            by_parameter: [0.0; MOST_OF_A_JOINT],
        };
        let drive = &plant.joints[joint];
        let plain = |number: S| number.lane(0);
        let slides = plain(end.modes.free[joint]) != 0.0;
        let time = plain(drive.settling_time);
        if slides && time == 0.0 {
            slopes.motor = plain(end.modes.direction[joint]) / plain(drive.ratio) / half;
            return slopes;
        }
        let held = Holding::new(plant, end, joint);
        let (side, scale) = if slides {
            let mobility = plain(drive.motor_mobility);
            (plain(end.modes.direction[joint]), time * mobility)
        } else {
            (held.torque.signum(), -1.0)
        };
        let by_torque = side * scale;
        slopes.torque = by_torque;
        slopes.twist = by_torque * held.by_twist;
        slopes.motor = by_torque * held.by_motor / half;
        slopes.link = by_torque * held.by_link / half;
        slopes.by_parameter =
            by_parameters(&drive.spring, asked, effects, &held, [by_torque, scale]);
        slopes
    }

    /// Derivative along given derivatives of the motion and the torques.
    #[inline(always)]
    pub(crate) fn along<V: Real, const N: usize>(&self, x: &Tangent<V, N>, torque: &[V; N]) -> V {
        let (c, i) = (V::splat, self.joint);
        let moved = c(self.motor).mul_add(x.motor[i], c(self.link) * x.link[i]);
        let moved = c(self.twist).mul_add(x.twist[i], moved);
        c(self.torque).mul_add(torque[i], moved)
    }

    /// Derivatives with respect to the parameters of directions, each a joint and an index among
    /// its parameters.
    #[inline(always)]
    pub(crate) fn by_parameters<V: Real>(&self, own: &[Option<(usize, usize)>]) -> V {
        let mut all = V::splat(0.0);
        for (lane, own) in own.iter().enumerate() {
            if let &Some((joint, place)) = own
                && joint == self.joint
            {
                all.set_lane(lane, self.by_parameter[place]);
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
    asked: &JointConfig,
    effects: Option<&EffectSensitivity<L, N>>,
    held: &Holding<S>,
    [by_torque, scale]: [f64; 2],
) -> [f64; MOST_OF_A_JOINT] {
    let mut by = [0.0; MOST_OF_A_JOINT];
    let (speed, by_gear) = (by_torque * held.speed, -by_torque * held.ratio);
    by[..4].copy_from_slice(&[speed * held.settling, -speed, -scale, -by_torque]);
    // the link's friction does not hold the motor
    let mut next = DRIVE.len();
    let of_law = spring.by_parameters(held.twist, &spring.shared());
    for slope in &of_law[..asked.gear.parameters.len()] {
        by[next] = by_gear * slope.lane(0);
        next += 1;
    }
    by[next] = by_gear * held.rate;
    by[next + 1] = -speed * held.settling * held.settling * held.inertia;
    if let Some(effects) = effects {
        for own in effects.of(held.joint) {
            let adds = own.at_an_event(held, effects.z[held.joint], effects.base(held.joint));
            let gear = by_gear * adds.gear - by_torque * adds.lever * held.transmitted;
            by[next + 2 + own.place] = gear + by_torque * adds.motor - scale * adds.friction;
        }
    }
    by
}
