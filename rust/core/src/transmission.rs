//! What each joint's motor, friction and gear do at one instant, with the joint's effects.

use crate::arm::Arm;
use crate::effects::Twist;
use crate::plant::{Plant, State};
use crate::real::{Real, Work};

/// One gear at one instant.
pub(crate) struct Gear<R> {
    /// How far it is twisted.
    pub(crate) twist: Twist<R>,
    /// Link turns per motor turn just there: torque at the motor per torque at the link.
    pub(crate) lever: R,
}

impl<A: Arm<N>, R: Real, const N: usize, const ELASTIC: bool, const EFFECTS: bool>
    Plant<A, R, N, ELASTIC, EFFECTS>
{
    /// What dry friction can take up at most [N m] at a velocity of the motor [rad/s], and does
    /// take up while the motor slides: f_M + f_S exp(-(dtheta_M/w_s)^2).
    #[inline(always)]
    pub fn dry_friction(&self, velocity: R, joint: usize) -> R {
        let coulomb = self.joints[joint].coulomb;
        match &self.joints[joint].effects.stribeck {
            Some(stribeck) if EFFECTS => coulomb + stribeck.at(velocity),
            _ => coulomb,
        }
    }

    /// Link angle [rad] at which an elastic gear is not twisted: n theta_M + e(theta_M).
    pub fn untwisted(&self, motor_angle: R, joint: usize) -> R {
        let angle = self.joints[joint].ratio * motor_angle;
        match &self.joints[joint].effects.kinematic_error {
            Some(error) if EFFECTS => angle + error.at(motor_angle)[0],
            _ => angle,
        }
    }

    /// delta = n theta_M + e(theta_M) - theta_L, its rate, and n + e'(theta_M).
    #[inline(always)]
    pub(crate) fn gear(&self, x: &State<R, N>, i: usize) -> Gear<R> {
        let mut lever = self.joints[i].ratio;
        let mut angle = lever.mul_add(x.motor_angle[i], -x.link_angle[i]);
        if EFFECTS && let Some(error) = &self.joints[i].effects.kinematic_error {
            let [off, slope] = error.at(x.motor_angle[i]);
            (angle, lever) = (angle + off, lever + slope);
        }
        let rate = lever.mul_add(x.motor_velocity[i], -x.link_velocity[i]);
        Gear {
            twist: Twist { angle, rate },
            lever,
        }
    }

    /// T(delta) + d_G ddelta + T_h z of the `i`-th joint.
    #[inline(always)]
    pub(crate) fn transmitted(&self, x: &State<R, N>, i: usize, twist: &Twist<R>) -> R {
        let joint = &self.joints[i];
        let torque = joint
            .gear_damping
            .mul_add(twist.rate, joint.spring.torque(twist.angle));
        match &joint.effects.hysteresis {
            Some(hysteresis) if EFFECTS => hysteresis.torque.mul_add(x.hysteresis[i], torque),
            _ => torque,
        }
    }

    /// z of each gear at a stage `t` after the beginning.
    #[inline(always)]
    fn twisted(&self, begin: &State<R, N>, stage: &State<R, N>, t: R) -> [R; N] {
        let mut z = begin.hysteresis;
        for i in 0..N {
            if let Some(hysteresis) = &self.joints[i].effects.hysteresis {
                let (from, to) = (self.gear(begin, i).twist, self.gear(stage, i).twist);
                z[i] = hysteresis.after(z[i], &from, &to, t);
            }
        }
        z
    }
}

/// Work in a function of its own: the exponentials and sines of effects in every stage of every step
/// would be half of the program.
#[inline(never)]
pub(crate) fn apart<R: Real, W: Work>(work: W) -> W::Output {
    R::scope(work)
}

/// [`Plant::twisted`].
pub(crate) struct Twisting<
    'p,
    A: Arm<N>,
    R: Real,
    const N: usize,
    const ELASTIC: bool,
    const EFFECTS: bool,
>(
    pub(crate) &'p Plant<A, R, N, ELASTIC, EFFECTS>,
    pub(crate) &'p State<R, N>,
    pub(crate) &'p State<R, N>,
    pub(crate) R,
);

impl<A: Arm<N>, R: Real, const N: usize, const ELASTIC: bool, const EFFECTS: bool> Work
    for Twisting<'_, A, R, N, ELASTIC, EFFECTS>
{
    type Output = [R; N];
    #[inline(always)]
    fn run(self) -> Self::Output {
        self.0.twisted(self.1, self.2, self.3)
    }
}
