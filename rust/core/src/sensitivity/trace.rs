//! Stages of a Runge-Kutta step of the simulation.

use crate::arm::Arm;
use crate::arm::transmission::link_of;
use crate::joint::effects::Torsion;
use crate::plant::{Acceleration, State, Watch};
use crate::scalar::Real;

/// A number at each of the four stages.
pub(crate) type Stages = [f64; 4];

/// Trace of a simulation step.
///
/// Stages are stored one by one, not by quantity: a vector loaded from numbers that were just
/// stored one by one would wait until the whole step has retired.
#[derive(Clone, Copy)]
pub(crate) struct Trace<A, const N: usize> {
    arm: A,
    pub(crate) ratio: [f64; N],
    pub(crate) stages: [Stage<N>; 4],
}

/// State and accelerations at one stage of a step.
#[derive(Clone, Copy)]
pub(crate) struct Stage<const N: usize> {
    pub(crate) angle: [f64; N],
    pub(crate) velocity: [f64; N],
    pub(crate) torsion: [f64; N],
    pub(crate) rate: [f64; N],
    pub(crate) motor_velocity: [f64; N],
    pub(crate) motor_acceleration: [f64; N],
    pub(crate) link_acceleration: [f64; N],
}

impl<A: Arm<N>, const N: usize> Trace<A, N> {
    pub(crate) fn new(arm: A, ratio: [f64; N]) -> Self {
        let zero = [0.0; N];
        let stage = Stage {
            angle: zero,
            velocity: zero,
            torsion: zero,
            rate: zero,
            motor_velocity: zero,
            motor_acceleration: zero,
            link_acceleration: zero,
        };
        Self {
            arm,
            ratio,
            stages: [stage; 4],
        }
    }

    /// A number at each stage.
    #[inline(always)]
    pub(crate) fn each(&self, number: impl Fn(&Stage<N>) -> f64) -> Stages {
        [0, 1, 2, 3].map(|k| number(&self.stages[k]))
    }

    /// A number at the stages from the `first`, in lanes.
    #[inline(always)]
    pub(crate) fn across<L: Real>(&self, first: usize, number: impl Fn(&Stage<N>) -> f64) -> L {
        L::load(&self.each(number)[first..])
    }

    /// A number of each joint at the stages from the `first`, in lanes.
    #[inline(always)]
    pub(crate) fn joints<L: Real>(
        &self,
        first: usize,
        numbers: impl Fn(&Stage<N>) -> &[f64; N],
    ) -> [L; N] {
        let mut all = [L::splat(0.0); N];
        for i in 0..self.arm.joints() {
            all[i] = self.across(first, |stage| numbers(stage)[i]);
        }
        all
    }
}

impl<A: Arm<N>, S: Real, const N: usize> Watch<S, N> for Trace<A, N> {
    #[inline(always)]
    fn stage(&mut self, k: usize, x: &State<S, N>, a: &Acceleration<S, N>) {
        let mut ratios = x.motor_angle;
        for i in 0..N {
            ratios[i] = S::splat(self.ratio[i]);
        }
        let (arm, stage) = (&self.arm, &mut self.stages[k]);
        for i in 0..arm.joints() {
            let torsion = link_of(arm, i, &ratios, &x.motor_angle, -x.link_angle[i]);
            let rate = link_of(arm, i, &ratios, &x.motor_velocity, -x.link_velocity[i]);
            stage.angle[i] = x.link_angle[i].lane(0);
            stage.velocity[i] = x.link_velocity[i].lane(0);
            stage.torsion[i] = torsion.lane(0);
            stage.rate[i] = rate.lane(0);
            stage.motor_velocity[i] = x.motor_velocity[i].lane(0);
            stage.motor_acceleration[i] = a.motor[i].lane(0);
            stage.link_acceleration[i] = a.link[i].lane(0);
        }
    }
}

impl<A: Arm<N>, const N: usize> Trace<A, N> {
    /// Torsion of gear `i` at stage `k`.
    #[inline(always)]
    pub(crate) fn torsion_at(&self, i: usize, k: usize) -> Torsion<f64> {
        let stage = &self.stages[k];
        Torsion {
            angle: stage.torsion[i],
            rate: stage.rate[i],
        }
    }

    /// Torsion of gear `i` in a state.
    #[inline(always)]
    pub(crate) fn torsion_of<S: Real>(&self, i: usize, x: &State<S, N>) -> Torsion<f64> {
        let ratios = self.ratio.map(S::splat);
        let of = |motors, link: S| link_of(&self.arm, i, &ratios, motors, -link).lane(0);
        Torsion {
            angle: of(&x.motor_angle, x.link_angle[i]),
            rate: of(&x.motor_velocity, x.link_velocity[i]),
        }
    }
}
