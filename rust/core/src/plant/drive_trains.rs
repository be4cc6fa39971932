//! Gears between motors and links: torsions and their torques.

use super::{Plant, State};
use crate::arm::Arm;
use crate::arm::transmission::{link_of, share};
use crate::joint::DriveTrains;
use crate::joint::effects::Torsion;
use crate::joint::gear::Gears;
use crate::scalar::Real;

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Plant<A, R, G, N, EFFECTS> {
    /// Output n theta_M + e(theta_M) of a motor's gear, plus a term, and the local ratio.
    #[inline(always)]
    fn output(&self, motor_angle: R, j: usize, plus: R) -> [R; 2] {
        let joint = &self.joints[j];
        let (mut ratio, mut angle) = (joint.ratio, joint.ratio.mul_add(motor_angle, plus));
        if EFFECTS {
            let [error, slope] = joint.effects.error(motor_angle);
            (angle, ratio) = (angle + error, ratio + slope);
        }
        [angle, ratio]
    }

    /// Link angle [rad] of a joint at zero torsion plus a term, and the local ratios
    /// n + e'(theta_M) of the motors that move the joint.
    #[inline(always)]
    pub(crate) fn driven_angle(&self, motor_angle: &[R; N], i: usize, plus: R) -> (R, [R; N]) {
        let (zero, mut angle) = (R::splat(0.0), plus);
        let mut ratios = [zero; N];
        if self.arm.transmission().is_none() {
            [angle, ratios[i]] = self.output(motor_angle[i], i, plus);
            return (angle, ratios);
        }
        for j in 0..self.arm.joints() {
            let [output, ratio] = self.output(motor_angle[j], j, zero);
            angle = R::splat(share(&self.arm, i, j)).mul_add(output, angle);
            ratios[j] = ratio;
        }
        (angle, ratios)
    }

    /// Gears of all joints.
    #[inline(always)]
    pub(crate) fn drive_trains(&self, x: &State<R, N>) -> DriveTrains<R, N> {
        let mut trains = self.outlined_drive_trains(x);
        for i in 0..self.arm.joints() {
            self.add_drive_train(x, i, &mut trains);
        }
        trains
    }

    #[inline(always)]
    pub(super) fn compute_drive_trains(&self, x: &State<R, N>) -> DriveTrains<R, N> {
        let mut trains = DriveTrains::zero();
        for i in 0..self.arm.joints() {
            self.compute_drive_train(x, i, &mut trains);
        }
        trains
    }

    #[inline(always)]
    pub(super) fn compute_drive_train(
        &self,
        x: &State<R, N>,
        i: usize,
        trains: &mut DriveTrains<R, N>,
    ) {
        if self.is_rigid(i) {
            return;
        }
        let (mut angle, mut velocity) = (x.link_angle[i], x.link_velocity[i]);
        if EFFECTS {
            let effects = &self.joints[i].effects;
            angle = angle - effects.base_rotation(x.base_torque[i]);
            velocity = velocity - effects.base_rotation(x.base_torque_rate[i]);
        }
        let torsion = if self.arm.transmission().is_none() {
            let [angle, ratio] = self.output(x.motor_angle[i], i, -angle);
            trains.ratio[i] = ratio;
            let rate = ratio.mul_add(x.motor_velocity[i], -velocity);
            Torsion { angle, rate }
        } else {
            let (angle, ratios) = self.driven_angle(&x.motor_angle, i, -angle);
            trains.ratio[i] = ratios[i];
            let rate = link_of(&self.arm, i, &ratios, &x.motor_velocity, -velocity);
            Torsion { angle, rate }
        };
        trains.torque[i] = self.joints[i].transmitted::<EFFECTS>(&torsion, x.hysteresis[i]);
        trains.torsion[i] = torsion;
    }

    /// Gear ratios n.
    #[inline(always)]
    pub(crate) fn ratios(&self) -> [R; N] {
        let mut all = [R::splat(0.0); N];
        for i in 0..self.arm.joints() {
            all[i] = self.joints[i].ratio;
        }
        all
    }

    /// Torque [N m] of each gear at its link; zero for a rigid gear.
    pub fn gear_torques(&self, x: &State<R, N>) -> [R; N] {
        self.drive_trains(x).torque
    }

    /// Torsion C n theta_M - theta_L [rad] of each gear at its link; zero for a rigid gear.
    pub fn torsions(&self, x: &State<R, N>) -> [R; N] {
        let (ratios, mut all) = (self.ratios(), [R::splat(0.0); N]);
        for i in 0..self.arm.joints() {
            if !self.is_rigid(i) {
                all[i] = link_of(&self.arm, i, &ratios, &x.motor_angle, -x.link_angle[i]);
            }
        }
        all
    }
}
