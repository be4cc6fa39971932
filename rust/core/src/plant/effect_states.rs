//! Effects with states of their own: flexible parts of links, springs under bases, hysteresis.

use super::{Plant, State, angle_in_space, first_bearing};
use crate::arm::Arm;
use crate::joint::effects::{BaseTorque, PartDeflection};
use crate::joint::gear::{Gears, Spring};
use crate::scalar::Real;

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Plant<A, R, G, N, EFFECTS> {
    /// State of the spring under the `i`-th joint's base.
    #[inline(always)]
    pub(super) fn base_torque(x: &State<R, N>, i: usize) -> BaseTorque<R> {
        BaseTorque {
            torque: x.base_torque[i],
            rate: x.base_torque_rate[i],
        }
    }

    /// Sets the torques of the springs under the bases to their equilibrium with the gears: s =
    /// -tau.
    ///
    /// Newton's method with an upper bound of the stiffness of the gear, which makes it slower but
    /// prevents overshoot. After convergence the number of iterations is doubled, for the
    /// derivatives.
    pub(crate) fn load_bases(&self, x: &mut State<R, N>) {
        for i in (0..self.arm.joints()).filter(|&i| !self.is_rigid(i)) {
            let joint = &self.joints[i];
            let compliance = joint.effects.base_rotation(R::splat(1.0));
            let mut converged_at = None;
            for round in 0..400 {
                let trains = self.drive_trains(x);
                let torque = trains.torque[i];
                let strain = joint.effects.strain(trains.torsion[i].angle);
                let slope = compliance * joint.spring.stiffness(strain) + 1.0;
                let change = (torque + x.base_torque[i]) / slope;
                x.base_torque[i] = x.base_torque[i] - change;
                let size = 1e-14 * (1.0 + torque.lane(0).abs());
                if change.lane(0).abs() < size && converged_at.is_none() {
                    converged_at = Some(round);
                }
                if converged_at.is_some_and(|at| round > 2 * at) {
                    break;
                }
            }
        }
    }

    /// Deflection of the flexible part of the `i`-th link.
    #[inline(always)]
    pub(super) fn deflection(x: &State<R, N>, i: usize) -> PartDeflection<R> {
        PartDeflection {
            angle: x.part_angle[i] - angle_in_space::<A, R, N>(&x.link_angle, i),
            rate: x.part_velocity[i] - angle_in_space::<A, R, N>(&x.link_velocity, i),
        }
    }

    /// Sets the flexible parts to the motion of their links.
    pub(crate) fn carry_parts(&self, x: &mut State<R, N>) {
        for i in 0..self.arm.joints() {
            x.part_angle[i] = angle_in_space::<A, R, N>(&x.link_angle, i);
            x.part_velocity[i] = angle_in_space::<A, R, N>(&x.link_velocity, i);
        }
    }

    /// Accelerations of the flexible parts, and load torques of effects on each joint [N m].
    #[inline(always)]
    pub(super) fn part_accelerations_and_loads(&self, x: &State<R, N>) -> [[R; N]; 2] {
        let mut loads = self.static_loads(&x.link_angle);
        let mut part = [R::splat(0.0); N];
        for i in 0..self.arm.joints() {
            let effects = &self.joints[i].effects;
            if effects.flexible_link.is_some() {
                part[i] = effects.part_acceleration(&Self::deflection(x, i));
                let load = effects.part_load(part[i]);
                for sum in &mut loads[first_bearing::<A, N>(i)..=i] {
                    *sum = *sum + load;
                }
            }
        }
        [part, loads]
    }

    /// Load torques of effects on each joint at rest [N m].
    #[inline(always)]
    pub(crate) fn static_loads(&self, link_angle: &[R; N]) -> [R; N] {
        let mut loads = [R::splat(0.0); N];
        for i in 0..self.arm.joints() {
            let effects = &self.joints[i].effects;
            loads[i] = loads[i] + effects.load(link_angle[i]);
            let weight = effects.weight(angle_in_space::<A, R, N>(link_angle, i));
            for sum in &mut loads[first_bearing::<A, N>(i)..=i] {
                *sum = *sum + weight;
            }
        }
        loads
    }

    /// Hysteresis states at a stage `t` after the beginning.
    #[inline(always)]
    pub(super) fn hysteresis_states(
        &self,
        begin: &State<R, N>,
        stage: &State<R, N>,
        t: R,
    ) -> [R; N] {
        let mut z = begin.hysteresis;
        let mut any = false;
        for i in 0..self.arm.joints() {
            any = any || self.joints[i].effects.hysteresis.is_some();
        }
        if !any {
            return z;
        }
        let [from, to] = [self.drive_trains(begin), self.drive_trains(stage)];
        for i in 0..self.arm.joints() {
            let effects = &self.joints[i].effects;
            if effects.hysteresis.is_some() {
                z[i] = effects.hysteresis_after(z[i], &from.torsion[i], &to.torsion[i], t);
            }
        }
        z
    }
}
