//! Motors, gears and links in one right-hand side, for given friction modes:
//!
//! ```text
//! (1)  M_M ddtheta_M + D_M dtheta_M + f_M sgn(dtheta_M) = E u - N [T(delta) + D_G ddelta]
//! (2)  M_L ddtheta_L + c_L + g_L + D_L dtheta_L = T(delta) + D_G ddelta
//! ```
//!
//! `Plant::accelerations` solves both; the modules beside it add the terms of the gears
//! (`drive_trains`) and of effects (`effect_states`), friction events, and the Runge-Kutta step.

pub mod config;
mod drive_trains;
mod effect_states;
mod energy;
mod event_time;
pub mod friction;
mod outlined;
pub mod rigid;
mod state;
mod step;

pub use state::{Acceleration, Modes, State};
pub use step::Watch;

use crate::arm::transmission::{motor_of, product, reflect, share};
use crate::arm::{Arm, Outlined};
use crate::joint::gear::Gears;
use crate::joint::{DriveTrains, Joint};
use crate::scalar::{Real, run_out_of_line, solve, symmetrise};
use outlined::RigidLoadWork;

/// The first joint that carries the load of the `i`-th link: the first joint if axes are parallel,
/// else the link's.
pub(crate) const fn first_bearing<A: Arm<N>, const N: usize>(i: usize) -> usize {
    if A::PLANAR { 0 } else { i }
}

/// Angle of the `i`-th link in space [rad], or its joint angle if axes are not parallel. The same
/// function applies to velocities.
#[inline(always)]
pub(crate) fn angle_in_space<A: Arm<N>, R: Real, const N: usize>(of_links: &[R; N], i: usize) -> R {
    let mut angle = of_links[i];
    for rotation in &of_links[first_bearing::<A, N>(i)..i] {
        angle = angle + *rotation;
    }
    angle
}

/// Posture and accelerations at one instant.
#[derive(Clone, Copy)]
pub struct Instant<A: Arm<N>, R: Real, const N: usize> {
    /// Sines and cosines of the link angles.
    pub posture: A::Posture<R>,
    /// Accelerations.
    pub acceleration: Acceleration<R, N>,
}

/// An arm with its joints. `G` states at compile time which laws its gears may have, to keep
/// branches out of the innermost loop; `EFFECTS` states whether any joint has effects, which
/// requires a scalar of one lane.
#[derive(Clone, Copy)]
pub struct Plant<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool = false> {
    /// Geometry.
    pub arm: A,
    /// Inertial and gravity parameters.
    pub base: A::Base<R>,
    /// Drive trains.
    pub joints: [Joint<R, G>; N],
    /// Whether any motor has a settling time.
    pub settles: bool,
}

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Plant<A, R, G, N, EFFECTS> {
    /// Whether a joint's gear is rigid.
    #[inline(always)]
    pub fn is_rigid(&self, joint: usize) -> bool {
        G::RIGID && self.joints[joint].rigid
    }

    /// [`Joint::dry_friction`] of one joint.
    #[inline(always)]
    pub fn dry_friction(&self, velocity: R, load: R, joint: usize) -> R {
        self.joints[joint].dry_friction::<EFFECTS>(velocity, load)
    }

    /// Friction limit of each motor in a state.
    #[inline(always)]
    pub(crate) fn friction_limits(&self, x: &State<R, N>) -> [R; N] {
        let mut limits = [R::splat(0.0); N];
        let mut loads = limits;
        if EFFECTS {
            let mut trains = self.outlined_drive_trains(x);
            for i in 0..self.arm.joints() {
                self.add_drive_train(x, i, &mut trains);
                loads[i] = motor_of(&self.arm, i, trains.ratio[i], &trains.torque, loads[i]);
            }
        }
        for i in 0..self.arm.joints() {
            limits[i] = self.dry_friction(x.motor_velocity[i], loads[i], i);
        }
        limits
    }

    /// Torque [N m] of effects on a motor.
    #[inline(always)]
    fn added_torque(&self, x: &State<R, N>, i: usize) -> R {
        self.joints[i]
            .effects
            .motor_torque(x.motor_angle[i], x.motor_velocity[i])
    }

    /// Posture and accelerations for given motor torques and friction modes.
    #[inline(always)]
    pub fn instant(
        &self,
        x: &State<R, N>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> Instant<A, R, N> {
        let posture = self.arm.posture(&x.link_angle);
        Instant {
            posture,
            acceleration: self.accelerations_at(x, &posture, torque, modes),
        }
    }

    /// Accelerations from (1) and (2).
    ///
    /// A rigid gear has no row of its own: its motor enters the link's row, see
    /// [`Plant::add_rigid_row`]. Behind a transmission, the outputs of the gears replace the links in
    /// these rows.
    #[inline(always)]
    fn accelerations(
        &self,
        x: &State<R, N>,
        at: &A::Posture<R>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> Acceleration<R, N> {
        let (mut inertia, mut load, part) = self.link_equations(x, at);
        let [mut motor, mut force, mut base] = [[R::splat(0.0); N]; 3];
        let mut gears = self.outlined_drive_trains(x);
        let block = self.rigid_block();
        if G::RIGID && N > 2 {
            symmetrise(&mut inertia);
        }
        if let Some(block) = &block {
            reflect(block, &mut inertia, &mut load);
        }
        for i in 0..self.arm.joints() {
            if self.is_rigid(i) {
                let drive = self.drive_torque(x, torque[i], R::splat(0.0), modes, i);
                force[i] = self.add_rigid_row(&mut inertia, drive, load[i], modes, i);
            } else {
                self.add_drive_train(x, i, &mut gears);
                motor[i] = self.motor_acceleration(x, torque[i], &gears, modes, i);
                force[i] = gears.torque[i] - load[i];
                if EFFECTS {
                    let bearing = Self::base_torque(x, i);
                    base[i] = self.joints[i]
                        .effects
                        .base_acceleration(&bearing, gears.torque[i]);
                }
            }
        }
        let is_outlined = A::OUTLINED == Outlined::Parts;
        let mut link = solve(&inertia, &force, (self.arm.joints(), is_outlined));
        for i in 0..self.arm.joints() {
            if self.is_rigid(i) {
                motor[i] = link[i] / self.joints[i].ratio;
            }
        }
        if let Some(block) = &block {
            link = product(block, &link);
        }
        Acceleration {
            motor,
            link,
            part,
            base,
        }
    }

    /// M_L, the load c_L + g_L + D_L dtheta_L of (2) with that of effects, and the accelerations of
    /// flexible parts.
    #[inline(always)]
    fn link_equations(&self, x: &State<R, N>, at: &A::Posture<R>) -> ([[R; N]; N], [R; N], [R; N]) {
        let (inertia, bias) = self.arm.equations(&self.base, at, &x.link_velocity);
        let [mut part, mut loads] = [[R::splat(0.0); N]; 2];
        if EFFECTS {
            [part, loads] = self.part_accelerations_and_loads(x);
        }
        for i in 0..self.arm.joints() {
            let viscous = self.joints[i].link_viscous;
            let load = viscous.mul_add(x.link_velocity[i], bias[i]);
            loads[i] = if EFFECTS { load + loads[i] } else { load };
        }
        (inertia, loads, part)
    }

    /// ddtheta_M of (1) for a sliding motor, and -dtheta_M / tau for a held one.
    #[inline(always)]
    fn motor_acceleration(
        &self,
        x: &State<R, N>,
        torque: R,
        gears: &DriveTrains<R, N>,
        modes: &Modes<R, N>,
        i: usize,
    ) -> R {
        let (joint, ratio, free) = (&self.joints[i], gears.ratio[i], modes.free[i]);
        let at_motor = motor_of(&self.arm, i, ratio, &gears.torque, R::splat(0.0));
        let drive = self.drive_torque(x, torque, at_motor, modes, i);
        let net = motor_of(&self.arm, i, -ratio, &gears.torque, drive);
        let settling = (free - 1.0) * joint.settling_rate;
        settling.mul_add(x.motor_velocity[i], free * joint.motor_mobility * net)
    }

    /// Adds the motor behind a rigid gear to the link's row, (5), and returns the row's force.
    ///
    /// The inertia and friction of the motor enter as m_M/n^2 and d_M/n^2. A sticking motor holds
    /// its link: the row and column of that link are removed from the equations.
    #[inline(always)]
    fn add_rigid_row(
        &self,
        inertia: &mut [[R; N]; N],
        drive: R,
        load: R,
        modes: &Modes<R, N>,
        i: usize,
    ) -> R {
        let (joint, free) = (&self.joints[i], modes.free[i]);
        let row = R::splat(1.0) / joint.ratio;
        inertia[i][i] = (joint.motor_inertia * row).mul_add(row, inertia[i][i]);
        for j in 0..self.arm.joints() {
            if j != i {
                inertia[i][j] = inertia[i][j] * free;
                inertia[j][i] = inertia[j][i] * free;
            }
        }
        free * (drive * row - load)
    }

    /// Torque E u - D_M dtheta_M - f_M sgn(dtheta_M) [N m] that drives a motor, for a gear torque
    /// `at_motor`.
    #[inline(always)]
    fn drive_torque(
        &self,
        x: &State<R, N>,
        torque: R,
        at_motor: R,
        modes: &Modes<R, N>,
        i: usize,
    ) -> R {
        let (joint, velocity) = (&self.joints[i], x.motor_velocity[i]);
        let mut applied = torque;
        if EFFECTS {
            applied = applied + self.added_torque(x, i);
        }
        let dry = self.dry_friction(velocity, at_motor, i);
        let dry = dry.mul_add(modes.direction[i], joint.offset);
        (-joint.motor_viscous).mul_add(velocity, applied - dry)
    }

    /// The transmission of the joints behind rigid gears, with rows of the identity for the others;
    /// `None` if no transmission couples joints behind rigid gears.
    #[inline(always)]
    fn rigid_block(&self) -> Option<[[R; N]; N]> {
        if !G::RIGID || self.arm.transmission().is_none() {
            return None;
        }
        let mut block = [[R::splat(0.0); N]; N];
        let mut any = false;
        for i in 0..self.arm.joints() {
            block[i][i] = R::splat(1.0);
            if self.is_rigid(i) {
                any = true;
                for j in 0..self.arm.joints() {
                    block[i][j] = R::splat(share(&self.arm, i, j));
                }
            }
        }
        any.then_some(block)
    }

    /// Torque [N m] at each motor, without its offset, that holds the motor: at rest, or as it
    /// settles.
    ///
    /// Friction holds the motor while this torque is within +-[`Plant::dry_friction`], because
    /// Sgn(0) = [-1, 1].
    #[inline(always)]
    pub fn holding_torques(&self, x: &State<R, N>, torque: &[R; N], modes: &Modes<R, N>) -> [R; N] {
        let mut trains = self.outlined_drive_trains(x);
        let mut holding = [R::splat(0.0); N];
        for i in 0..self.arm.joints() {
            let joint = &self.joints[i];
            holding[i] = torque[i] - joint.offset;
            if EFFECTS {
                holding[i] = holding[i] + self.added_torque(x, i);
            }
            if !self.is_rigid(i) {
                let brake = joint.motor_inertia * joint.settling_rate - joint.motor_viscous;
                self.add_drive_train(x, i, &mut trains);
                let ratio = -trains.ratio[i];
                holding[i] = motor_of(&self.arm, i, ratio, &trains.torque, holding[i]);
                holding[i] = brake.mul_add(x.motor_velocity[i], holding[i]);
            }
        }
        for i in 0..self.arm.joints() {
            if self.is_rigid(i) {
                return run_out_of_line::<R, _>(RigidLoadWork(self, x, torque, modes, &holding));
            }
        }
        holding
    }

    /// Subtracts the loads behind rigid gears from the `holding` torques: the torque of the motor's
    /// row with that motor at rest.
    #[inline(always)]
    fn subtract_rigid_loads(
        &self,
        x: &State<R, N>,
        torque: &[R; N],
        modes: &Modes<R, N>,
        holding: &[R; N],
    ) -> [R; N] {
        let mut holding = *holding;
        let at = self.arm.posture(&x.link_angle);
        let (mut inertia, bias) = self.arm.equations(&self.base, &at, &x.link_velocity);
        symmetrise(&mut inertia);
        let mut loads = [R::splat(0.0); N];
        if EFFECTS {
            loads = self.part_accelerations_and_loads(x)[1];
        }
        for i in 0..self.arm.joints() {
            if !self.is_rigid(i) {
                continue;
            }
            let mut held = *modes;
            held.direction[i] = R::splat(0.0);
            held.free[i] = R::splat(0.0);
            let others = self.accelerations_at(x, &at, torque, &held).link;
            let mut torques = bias;
            for k in 0..self.arm.joints() {
                let viscous = self.joints[k].link_viscous;
                torques[k] = viscous.mul_add(x.link_velocity[k], torques[k]);
                if EFFECTS {
                    torques[k] = torques[k] + loads[k];
                }
                for j in 0..self.arm.joints() {
                    torques[k] = inertia[k][j].mul_add(others[j], torques[k]);
                }
            }
            let ratio = self.joints[i].ratio;
            let zero = R::splat(0.0);
            holding[i] = holding[i] - motor_of(&self.arm, i, ratio, &torques, zero);
        }
        holding
    }
}
