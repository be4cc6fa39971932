//! Motors, gears and links in one right-hand side, (1) and (2) for given friction modes, and the
//! Runge-Kutta step.

pub mod config;
pub mod friction;
pub mod rigid;

use crate::actuation::current_loop::StepTorque;
use crate::arm::transmission::{link_of, motor_of, product, reflect, share};
use crate::arm::{Arm, Outlined};
use crate::joint::effects::{BaseTorque, JointState, PartDeflection, Torsion};
use crate::joint::gear::{Gears, Spring};
use crate::joint::{DriveTrains, Joint};
use crate::scalar::{Real, Work, run_out_of_line, solve, symmetrise};

/// State: angles [rad] and velocities [rad/s] of motors and links, and the states of effects.
#[derive(Clone, Copy, Debug)]
pub struct State<R, const N: usize> {
    /// theta_M.
    pub motor_angle: [R; N],
    /// dtheta_M.
    pub motor_velocity: [R; N],
    /// theta_L.
    pub link_angle: [R; N],
    /// dtheta_L.
    pub link_velocity: [R; N],
    /// z, hysteresis torque relative to its largest, within [-1, 1]; zero without hysteresis.
    pub hysteresis: [R; N],
    /// Angles of flexible parts in space; unused without them.
    pub part_angle: [R; N],
    /// Velocities of flexible parts in space.
    pub part_velocity: [R; N],
    /// s [N m] of the springs under the bases; unused for rigid bases.
    pub base_torque: [R; N],
    /// ds [N m/s].
    pub base_torque_rate: [R; N],
}

/// Accelerations [rad/s^2].
#[derive(Clone, Copy, Debug)]
pub struct Acceleration<R, const N: usize> {
    /// ddtheta_M.
    pub motor: [R; N],
    /// ddtheta_L.
    pub link: [R; N],
    /// Accelerations of the flexible parts, in space.
    pub part: [R; N],
    /// dds [N m/s^2] of the springs under the bases.
    pub base: [R; N],
}

/// Friction mode of each motor during a step.
///
/// `direction` is +1 or -1 while the motor slides in that direction against the Coulomb torque, and
/// 0 while it is held; `free` is 1 while it slides and 0 while it is held: it sticks, or settles at
/// the rate `-dtheta_M / tau`. A joint without Coulomb friction is always free, with direction 0.
#[derive(Clone, Copy, Debug)]
pub struct Modes<R, const N: usize> {
    /// Sign that Coulomb friction opposes.
    pub direction: [R; N],
    /// 1 sliding, 0 held.
    pub free: [R; N],
}

impl<R: Real, const N: usize> Modes<R, N> {
    /// Whether a motor slides in every lane.
    #[inline(always)]
    fn all_free(&self, joint: usize) -> bool {
        !(self.free[joint] - R::splat(1.0)).any_negative()
    }
}

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

    /// Gears of all joints; zeros for arms whose stages are not outlined and which have no
    /// transmission, to which [`Plant::add_drive_train`] adds them where they are needed.
    #[inline(always)]
    fn outlined_drive_trains(&self, x: &State<R, N>) -> DriveTrains<R, N> {
        match A::OUTLINED {
            Outlined::Nothing => DriveTrains::zero(),
            Outlined::Stages => self.compute_drive_trains(x),
            Outlined::Parts => run_out_of_line::<R, _>(DriveTrainWork(self, x)),
        }
    }

    /// Adds the gear of a joint, unless [`Plant::outlined_drive_trains`] has computed it.
    #[inline(always)]
    fn add_drive_train(&self, x: &State<R, N>, i: usize, trains: &mut DriveTrains<R, N>) {
        if A::OUTLINED == Outlined::Nothing {
            self.compute_drive_train(x, i, trains);
        }
    }

    #[inline(always)]
    fn compute_drive_trains(&self, x: &State<R, N>) -> DriveTrains<R, N> {
        let mut trains = DriveTrains::zero();
        for i in 0..self.arm.joints() {
            self.compute_drive_train(x, i, &mut trains);
        }
        trains
    }

    #[inline(always)]
    fn compute_drive_train(&self, x: &State<R, N>, i: usize, trains: &mut DriveTrains<R, N>) {
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

    /// State of the spring under the `i`-th joint's base.
    #[inline(always)]
    fn base_torque(x: &State<R, N>, i: usize) -> BaseTorque<R> {
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
                let slope = R::splat(1.0) + compliance * joint.spring.stiffness(strain);
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
    fn deflection(x: &State<R, N>, i: usize) -> PartDeflection<R> {
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
    fn part_accelerations_and_loads(&self, x: &State<R, N>) -> [[R; N]; 2] {
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
    fn hysteresis_states(&self, begin: &State<R, N>, stage: &State<R, N>, t: &R) -> [R; N] {
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
                z[i] = effects.hysteresis_after(z[i], &from.torsion[i], &to.torsion[i], *t);
            }
        }
        z
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

    /// Accelerations; with effects in a separate function.
    #[inline(always)]
    fn accelerations_at(
        &self,
        x: &State<R, N>,
        at: &A::Posture<R>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> Acceleration<R, N> {
        if EFFECTS || A::OUTLINED != Outlined::Nothing {
            // inlined into every stage, the exponentials and sines of effects would be half of the
            // program
            run_out_of_line::<R, _>(AccelerationWork(self, x, at, torque, modes))
        } else {
            self.accelerations(x, at, torque, modes)
        }
    }

    /// Accelerations from (1) and (2).
    ///
    /// A rigid gear has no separate row: the inertia and friction of its motor enter the link's
    /// row as m_M/n^2 and d_M/n^2, (5). A sticking motor behind a rigid gear holds its link: the
    /// row and column of that link are removed from the equations. Behind a transmission, the
    /// outputs of the gears replace the links in these rows.
    #[inline(always)]
    fn accelerations(
        &self,
        x: &State<R, N>,
        at: &A::Posture<R>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> Acceleration<R, N> {
        let (mut inertia, bias) = self.arm.equations(&self.base, at, &x.link_velocity);
        let [mut part, mut loads, mut base] = [[R::splat(0.0); N]; 3];
        if EFFECTS {
            [part, loads] = self.part_accelerations_and_loads(x);
        }
        let (mut trains, zero) = (self.outlined_drive_trains(x), R::splat(0.0));
        for i in 0..self.arm.joints() {
            let load = self.joints[i]
                .link_viscous
                .mul_add(x.link_velocity[i], bias[i]);
            loads[i] = if EFFECTS { load + loads[i] } else { load };
        }
        let block = self.rigid_block();
        if G::RIGID && N > 2 {
            symmetrise(&mut inertia);
        }
        if let Some(block) = &block {
            reflect(block, &mut inertia, &mut loads);
        }
        let mut motor = [zero; N];
        let mut force = [zero; N];
        for i in 0..self.arm.joints() {
            let joint = &self.joints[i];
            let mut applied = torque[i];
            if EFFECTS {
                applied = applied + self.added_torque(x, i);
            }
            if self.is_rigid(i) {
                let drive = self.drive_torque(x, modes, [applied, zero], i);
                let row = R::splat(1.0) / joint.ratio;
                inertia[i][i] = (joint.motor_inertia * row).mul_add(row, inertia[i][i]);
                force[i] = modes.free[i] * (drive * row - loads[i]);
                for j in 0..self.arm.joints() {
                    if j != i {
                        inertia[i][j] = inertia[i][j] * modes.free[i];
                        inertia[j][i] = inertia[j][i] * modes.free[i];
                    }
                }
            } else {
                self.add_drive_train(x, i, &mut trains);
                let ratio = trains.ratio[i];
                let at_motor = motor_of(&self.arm, i, ratio, &trains.torque, zero);
                let drive = self.drive_torque(x, modes, [applied, at_motor], i);
                let net = motor_of(&self.arm, i, -ratio, &trains.torque, drive);
                let settling = (modes.free[i] - R::splat(1.0)) * joint.settling_rate;
                motor[i] = settling.mul_add(
                    x.motor_velocity[i],
                    modes.free[i] * joint.motor_mobility * net,
                );
                force[i] = trains.torque[i] - loads[i];
                if EFFECTS {
                    let bearing = Self::base_torque(x, i);
                    base[i] = joint.effects.base_acceleration(&bearing, trains.torque[i]);
                }
            }
        }
        let mut link = solve(
            &inertia,
            &force,
            (self.arm.joints(), A::OUTLINED == Outlined::Parts),
        );
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

    /// Torque [N m] that drives a motor: the torque `applied` to it minus friction, with a gear
    /// torque `at_motor`.
    #[inline(always)]
    fn drive_torque(
        &self,
        x: &State<R, N>,
        modes: &Modes<R, N>,
        [applied, at_motor]: [R; 2],
        i: usize,
    ) -> R {
        let (joint, velocity) = (&self.joints[i], x.motor_velocity[i]);
        let dry = self.dry_friction(velocity, at_motor, i);
        let dry = dry.mul_add(modes.direction[i], joint.offset);
        (-joint.motor_viscous).mul_add(velocity, applied - dry)
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
        let half = R::splat(0.5) * h;
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
        let sixth = h * R::splat(1.0 / 6.0);
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
            stage.hysteresis = run_out_of_line::<R, _>(HysteresisWork(self, begin, stage, &t));
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

/// Methods of [`Plant`] as [`Work`].
macro_rules! plant_work {
    ($($(#[$doc:meta])* $name:ident($($at:tt: $argument:ty),*) -> $output:ty = $method:ident;)*) => {$(
        $(#[$doc])*
        struct $name<'p, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>(
            &'p Plant<A, R, G, N, EFFECTS>,
            $(&'p $argument),*
        );

        impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Work
            for $name<'_, A, R, G, N, EFFECTS>
        {
            type Output = $output;
            #[inline(always)]
            fn run(self) -> $output {
                self.0.$method($(self.$at),*)
            }
        }
    )*};
}
pub(crate) use plant_work;

plant_work! {
    /// [`Plant::compute_drive_trains`].
    DriveTrainWork(1: State<R, N>) -> DriveTrains<R, N> = compute_drive_trains;
    /// [`Plant::accelerations`].
    AccelerationWork(1: State<R, N>, 2: A::Posture<R>, 3: [R; N], 4: Modes<R, N>) -> Acceleration<R, N>
        = accelerations;
    /// [`Plant::hysteresis_states`].
    HysteresisWork(1: State<R, N>, 2: State<R, N>, 3: R) -> [R; N] = hysteresis_states;
    /// [`Plant::subtract_rigid_loads`].
    RigidLoadWork(1: State<R, N>, 2: [R; N], 3: Modes<R, N>, 4: [R; N]) -> [R; N]
        = subtract_rigid_loads;
}

impl<R: Real, const N: usize> State<R, N> {
    /// Copies what a step changes.
    #[inline(always)]
    pub(crate) fn copy_from<const EFFECTS: bool>(&mut self, other: &Self) {
        if EFFECTS {
            *self = *other;
            return;
        }
        self.motor_angle = other.motor_angle;
        self.motor_velocity = other.motor_velocity;
        self.link_angle = other.link_angle;
        self.link_velocity = other.link_velocity;
    }

    /// Sets q + t q', q' + t a, the second stage of a step, and returns the rotations of the links.
    #[inline(always)]
    fn set_second<const EFFECTS: bool>(
        &mut self,
        begin: &Self,
        t: R,
        a: &Acceleration<R, N>,
    ) -> [R; N] {
        let mut rotation = begin.link_velocity;
        for i in 0..N {
            rotation[i] = t * begin.link_velocity[i];
            self.motor_angle[i] = t.mul_add(begin.motor_velocity[i], begin.motor_angle[i]);
            self.link_angle[i] = begin.link_angle[i] + rotation[i];
            self.motor_velocity[i] = t.mul_add(a.motor[i], begin.motor_velocity[i]);
            self.link_velocity[i] = t.mul_add(a.link[i], begin.link_velocity[i]);
            if EFFECTS {
                self.part_angle[i] = t.mul_add(begin.part_velocity[i], begin.part_angle[i]);
                self.part_velocity[i] = t.mul_add(a.part[i], begin.part_velocity[i]);
                self.base_torque[i] = t.mul_add(begin.base_torque_rate[i], begin.base_torque[i]);
                self.base_torque_rate[i] = t.mul_add(a.base[i], begin.base_torque_rate[i]);
            }
        }
        rotation
    }

    /// Sets q + t q' + s a, q' + r b, a later stage of a step or its end, and returns the rotations of
    /// the links.
    #[inline(always)]
    fn set_later<const EFFECTS: bool>(
        &mut self,
        begin: &Self,
        t: R,
        s: R,
        a: &Acceleration<R, N>,
        r: R,
        b: &Acceleration<R, N>,
    ) -> [R; N] {
        let mut rotation = begin.link_velocity;
        for i in 0..N {
            rotation[i] = s.mul_add(a.link[i], t * begin.link_velocity[i]);
            self.motor_angle[i] = s.mul_add(
                a.motor[i],
                t.mul_add(begin.motor_velocity[i], begin.motor_angle[i]),
            );
            self.link_angle[i] = begin.link_angle[i] + rotation[i];
            self.motor_velocity[i] = r.mul_add(b.motor[i], begin.motor_velocity[i]);
            self.link_velocity[i] = r.mul_add(b.link[i], begin.link_velocity[i]);
            if EFFECTS {
                self.part_angle[i] = s.mul_add(
                    a.part[i],
                    t.mul_add(begin.part_velocity[i], begin.part_angle[i]),
                );
                self.part_velocity[i] = r.mul_add(b.part[i], begin.part_velocity[i]);
                self.base_torque[i] = s.mul_add(
                    a.base[i],
                    t.mul_add(begin.base_torque_rate[i], begin.base_torque[i]),
                );
                self.base_torque_rate[i] = r.mul_add(b.base[i], begin.base_torque_rate[i]);
            }
        }
        rotation
    }
}

impl<R: Real, const N: usize> Acceleration<R, N> {
    #[inline(always)]
    fn plus<const EFFECTS: bool>(&self, other: &Self) -> Self {
        let mut total = *self;
        for i in 0..N {
            total.motor[i] = total.motor[i] + other.motor[i];
            total.link[i] = total.link[i] + other.link[i];
            if EFFECTS {
                total.part[i] = total.part[i] + other.part[i];
                total.base[i] = total.base[i] + other.base[i];
            }
        }
        total
    }
}
