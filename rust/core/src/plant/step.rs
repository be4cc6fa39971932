//! The Runge-Kutta step.

use super::outlined::HysteresisWork;
use super::{Acceleration, Instant, Modes, Plant, State};
use crate::actuation::current_loop::StepTorque;
use crate::arm::Arm;
use crate::joint::gear::Gears;
use crate::scalar::{Real, run_out_of_line};

/// Observer of the stages of a step.
pub trait Watch<R, const N: usize> {
    /// The `k`-th stage, from 0. Implementations are `#[inline(always)]`.
    fn stage(&mut self, k: usize, x: &State<R, N>, a: &Acceleration<R, N>);
}

/// No observer.
impl<R, const N: usize> Watch<R, N> for () {
    #[inline(always)]
    fn stage(&mut self, _: usize, _: &State<R, N>, _: &Acceleration<R, N>) {}
}

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Plant<A, R, G, N, EFFECTS> {
    /// One classical Runge-Kutta step with fixed friction modes.
    ///
    /// For q'' = a(q, q', t) the four stages need the positions only through velocities of earlier
    /// stages, so that
    /// q+ = q + h q' + h^2/6 (a1 + a2 + a3), q'+ = q' + h/6 (a1 + 2 a2 + 2 a3 + a4).
    /// `watch` observes each stage.
    #[inline(always)]
    pub fn runge_kutta(
        &self,
        x: &State<R, N>,
        now: &Instant<A, R, N>,
        torque: &StepTorque<R, N>,
        modes: &Modes<R, N>,
        h: R,
        watch: &mut impl Watch<R, N>,
    ) -> State<R, N> {
        let a1 = &now.acceleration;
        watch.stage(0, x, a1);
        let half = h * 0.5;
        // one state for all stages, because copies of it take as long as the arithmetic
        let mut stage = *x;
        let rotation = stage.set_second::<EFFECTS>(x, half, a1);
        self.complete_stage(x, &mut stage, modes, half);
        let a2 = self.accelerations_near(now, (&stage, &rotation), &torque.middle, modes);
        watch.stage(1, &stage, &a2);
        let rotation = stage.set_later::<EFFECTS>(x, half, half * half, a1, half, &a2);
        self.complete_stage(x, &mut stage, modes, half);
        let a3 = self.accelerations_near(now, (&stage, &rotation), &torque.middle, modes);
        watch.stage(2, &stage, &a3);
        let rotation = stage.set_later::<EFFECTS>(x, h, h * half, &a2, h, &a3);
        self.complete_stage(x, &mut stage, modes, h);
        let a4 = self.accelerations_near(now, (&stage, &rotation), &torque.end, modes);
        watch.stage(3, &stage, &a4);
        let sixth = h * (1.0 / 6.0);
        let inner = a2.plus::<EFFECTS>(&a3);
        let for_angle = a1.plus::<EFFECTS>(&inner);
        let for_velocity = for_angle.plus::<EFFECTS>(&inner).plus::<EFFECTS>(&a4);
        stage.set_later::<EFFECTS>(x, h, h * sixth, &for_angle, sixth, &for_velocity);
        self.complete_stage(x, &mut stage, modes, h);
        stage
    }

    /// Sets the held motors and the states of hysteresis at a stage `t` after the beginning.
    #[inline(always)]
    fn complete_stage(
        &self,
        begin: &State<R, N>,
        stage: &mut State<R, N>,
        modes: &Modes<R, N>,
        t: R,
    ) {
        self.settle_held_motors(begin, stage, modes, t);
        if EFFECTS {
            stage.hysteresis = begin.hysteresis;
            stage.hysteresis = run_out_of_line::<R, _>(HysteresisWork(self, begin, stage, t));
        }
    }

    /// Sets the held motors at a stage `t` after the beginning to dtheta_M(t) = dtheta_M(0)
    /// exp(-t/tau).
    ///
    /// The equation is solved exactly instead of integrated, so tau may be any part of the step.
    #[inline(always)]
    fn settle_held_motors(
        &self,
        begin: &State<R, N>,
        stage: &mut State<R, N>,
        modes: &Modes<R, N>,
        t: R,
    ) {
        if !self.settles {
            return;
        }
        for i in 0..self.arm.joints() {
            if modes.all_free(i) {
                continue;
            }
            let joint = &self.joints[i];
            let (free, one) = (modes.free[i], R::splat(1.0));
            let decay = (-joint.settling_rate * t).exp();
            let velocity = begin.motor_velocity[i] * decay;
            let displacement = joint.settling_time * begin.motor_velocity[i] * (one - decay);
            let angle = begin.motor_angle[i] + displacement;
            stage.motor_velocity[i] = free.mul_add(stage.motor_velocity[i] - velocity, velocity);
            stage.motor_angle[i] = free.mul_add(stage.motor_angle[i] - angle, angle);
        }
    }

    /// Accelerations at a later stage, whose link angles differ little from those of `now`.
    #[inline(always)]
    fn accelerations_near(
        &self,
        now: &Instant<A, R, N>,
        (x, rotation): (&State<R, N>, &[R; N]),
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> Acceleration<R, N> {
        self.accelerations_at(x, &self.arm.near(&now.posture, rotation), torque, modes)
    }
}
