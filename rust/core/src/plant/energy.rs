//! Energy of a plant, and the power that it dissipates.

use super::{Modes, Plant, State, angle_in_space};
use crate::arm::Arm;
use crate::joint::effects::JointState;
use crate::joint::gear::{Gears, Spring};
use crate::scalar::Real;

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Plant<A, R, G, N, EFFECTS> {
    /// Kinetic, elastic and gravitational energy [J].
    pub fn energy(&self, x: &State<R, N>) -> R {
        let at = self.arm.posture(&x.link_angle);
        let inertia = self.arm.inertia(&self.base, &at);
        let half = R::splat(0.5);
        let mut energy = self.arm.potential(&self.base, &at);
        for i in 0..self.arm.joints() {
            let joint = &self.joints[i];
            let v = x.motor_velocity[i];
            energy = energy + half * joint.motor_inertia * v * v;
            for j in 0..self.arm.joints() {
                energy = energy + half * inertia[i][j] * x.link_velocity[i] * x.link_velocity[j];
            }
            let at = self.at(x, i);
            energy = energy + joint.effects.energy(&at);
            if !self.is_rigid(i) {
                let strain = joint.effects.strain(at.torsion.angle);
                energy = energy + joint.spring.energy(strain);
            }
        }
        energy
    }

    /// State of the `i`-th joint for its effects.
    fn at(&self, x: &State<R, N>, i: usize) -> JointState<R> {
        JointState {
            motor_angle: x.motor_angle[i],
            motor_velocity: x.motor_velocity[i],
            link_angle: x.link_angle[i],
            angle_in_space: angle_in_space::<A, R, N>(&x.link_angle, i),
            torsion: self.drive_trains(x).torsion[i],
            z: x.hysteresis[i],
            deflection: Self::deflection(x, i),
            part_velocity: x.part_velocity[i],
            base: Self::base_torque(x, i),
        }
    }

    /// Power [W] dissipated by friction and damping in given friction modes.
    pub fn dissipation(&self, x: &State<R, N>, modes: &Modes<R, N>) -> R {
        let (mut power, limits) = (R::splat(0.0), self.friction_limits(x));
        for (i, joint) in self.joints.iter().enumerate() {
            let v = x.motor_velocity[i];
            let w = x.link_velocity[i];
            power = power + joint.motor_viscous * v * v + joint.link_viscous * w * w;
            let dry = limits[i];
            power = power + (dry * modes.direction[i] + joint.offset) * v;
            let at = self.at(x, i);
            power = power + joint.effects.loss(&at);
            if !self.is_rigid(i) {
                power = power + joint.gear_damping * at.torsion.rate * at.torsion.rate;
            }
        }
        power
    }
}
