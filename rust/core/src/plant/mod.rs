//! Motors, gears and links in one right-hand side, (1) and (2) for given friction modes, and the
//! Runge-Kutta step.

pub mod config;
pub mod friction;
pub mod rigid;

use crate::actuation::current_loop::StepTorque;
use crate::arm::Arm;
use crate::joint::effects::{BaseTorque, JointState, PartDeflection, Torsion};
use crate::joint::gear::{Gears, Spring};
use crate::joint::{Gear, Joint};
use crate::scalar::{Real, Work, run_out_of_line, solve};

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

    /// Friction limit of one joint in a state.
    #[inline(always)]
    pub(crate) fn dry_friction_in(&self, x: &State<R, N>, i: usize) -> R {
        let mut load = R::splat(0.0);
        if EFFECTS && !self.is_rigid(i) {
            let gear = self.gear(x, i);
            load = gear.local_ratio * self.transmitted(x, i, &gear.torsion);
        }
        self.dry_friction(x.motor_velocity[i], load, i)
    }

    /// Torque [N m] of effects on a motor.
    #[inline(always)]
    fn added_torque(&self, x: &State<R, N>, i: usize) -> R {
        self.joints[i]
            .effects
            .motor_torque(x.motor_angle[i], x.motor_velocity[i])
    }

    /// [`Joint::unloaded_link_angle`] of one joint.
    pub fn unloaded_link_angle(&self, motor_angle: R, joint: usize) -> R {
        self.joints[joint].unloaded_link_angle::<EFFECTS>(motor_angle)
    }

    /// The `i`-th joint's gear.
    #[inline(always)]
    pub(crate) fn gear(&self, x: &State<R, N>, i: usize) -> Gear<R> {
        let joint = &self.joints[i];
        let (mut angle, mut velocity) = (x.link_angle[i], x.link_velocity[i]);
        if EFFECTS {
            angle = angle - joint.effects.base_rotation(x.base_torque[i]);
            velocity = velocity - joint.effects.base_rotation(x.base_torque_rate[i]);
        }
        joint.gear::<EFFECTS>([x.motor_angle[i], angle], [x.motor_velocity[i], velocity])
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
        for i in (0..N).filter(|&i| !self.is_rigid(i)) {
            let joint = &self.joints[i];
            let compliance = joint.effects.base_rotation(R::splat(1.0));
            let mut converged_at = None;
            for round in 0..400 {
                let torsion = self.gear(x, i).torsion;
                let torque = self.transmitted(x, i, &torsion);
                let strain = joint.effects.strain(torsion.angle);
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
        for i in 0..N {
            x.part_angle[i] = angle_in_space::<A, R, N>(&x.link_angle, i);
            x.part_velocity[i] = angle_in_space::<A, R, N>(&x.link_velocity, i);
        }
    }

    /// Accelerations of the flexible parts, and load torques of effects on each joint [N m].
    #[inline(always)]
    fn part_accelerations_and_loads(&self, x: &State<R, N>) -> [[R; N]; 2] {
        let mut loads = self.static_loads(&x.link_angle);
        let mut part = [R::splat(0.0); N];
        for i in 0..N {
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
        for i in 0..N {
            let effects = &self.joints[i].effects;
            loads[i] = loads[i] + effects.load(link_angle[i]);
            let weight = effects.weight(angle_in_space::<A, R, N>(link_angle, i));
            for sum in &mut loads[first_bearing::<A, N>(i)..=i] {
                *sum = *sum + weight;
            }
        }
        loads
    }

    /// Torque of the `i`-th joint's gear [N m].
    #[inline(always)]
    pub(crate) fn transmitted(&self, x: &State<R, N>, i: usize, torsion: &Torsion<R>) -> R {
        self.joints[i].transmitted::<EFFECTS>(torsion, x.hysteresis[i])
    }

    /// Hysteresis states at a stage `t` after the beginning.
    #[inline(always)]
    fn hysteresis_states(&self, begin: &State<R, N>, stage: &State<R, N>, t: R) -> [R; N] {
        let mut z = begin.hysteresis;
        for i in 0..N {
            let effects = &self.joints[i].effects;
            if effects.hysteresis.is_some() {
                let (from, to) = (self.gear(begin, i).torsion, self.gear(stage, i).torsion);
                z[i] = effects.hysteresis_after(z[i], &from, &to, t);
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
        if EFFECTS || A::HAS_OUTLINED_EQUATIONS {
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
    /// row and column of that link are removed from the equations.
    #[inline(always)]
    fn accelerations(
        &self,
        x: &State<R, N>,
        at: &A::Posture<R>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> Acceleration<R, N> {
        let mut inertia = self.arm.inertia(&self.base, at);
        let bias = self.arm.bias(&self.base, at, &x.link_velocity);
        let [mut part, mut loads, mut base] = [[R::splat(0.0); N]; 3];
        if EFFECTS {
            [part, loads] = self.part_accelerations_and_loads(x);
        }
        let mut motor = [R::splat(0.0); N];
        let mut force = [R::splat(0.0); N];
        for i in 0..N {
            let joint = &self.joints[i];
            let mut load = joint.link_viscous.mul_add(x.link_velocity[i], bias[i]);
            let mut applied = torque[i];
            if EFFECTS {
                load = load + loads[i];
                applied = applied + self.added_torque(x, i);
            }
            if self.is_rigid(i) {
                let drive = self.drive_torque(x, modes, [applied, R::splat(0.0)], i);
                let row = R::splat(1.0) / joint.ratio;
                inertia[i][i] = (joint.motor_inertia * row).mul_add(row, inertia[i][i]);
                force[i] = modes.free[i] * (drive * row - load);
                for j in 0..N {
                    if j != i {
                        inertia[i][j] = inertia[i][j] * modes.free[i];
                        inertia[j][i] = inertia[j][i] * modes.free[i];
                    }
                }
            } else {
                let gear = self.gear(x, i);
                let transmitted = self.transmitted(x, i, &gear.torsion);
                let at_motor = gear.local_ratio * transmitted;
                let drive = self.drive_torque(x, modes, [applied, at_motor], i);
                let net = (-gear.local_ratio).mul_add(transmitted, drive);
                let settling = (modes.free[i] - R::splat(1.0)) * joint.settling_rate;
                motor[i] = settling.mul_add(
                    x.motor_velocity[i],
                    modes.free[i] * joint.motor_mobility * net,
                );
                force[i] = transmitted - load;
                if EFFECTS {
                    let bearing = Self::base_torque(x, i);
                    base[i] = joint.effects.base_acceleration(&bearing, transmitted);
                }
            }
        }
        let link = solve(&inertia, &force);
        for i in 0..N {
            if self.is_rigid(i) {
                motor[i] = link[i] / self.joints[i].ratio;
            }
        }
        Acceleration {
            motor,
            link,
            part,
            base,
        }
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
        let mut holding = [R::splat(0.0); N];
        for i in 0..N {
            let joint = &self.joints[i];
            holding[i] = torque[i] - joint.offset;
            if EFFECTS {
                holding[i] = holding[i] + self.added_torque(x, i);
            }
            if !self.is_rigid(i) {
                let brake = joint.motor_inertia * joint.settling_rate - joint.motor_viscous;
                let gear = self.gear(x, i);
                let transmitted = self.transmitted(x, i, &gear.torsion);
                holding[i] = (-gear.local_ratio).mul_add(transmitted, holding[i]);
                holding[i] = brake.mul_add(x.motor_velocity[i], holding[i]);
            }
        }
        for i in 0..N {
            if self.is_rigid(i) {
                return run_out_of_line::<R, _>(RigidLoadWork(self, x, torque, modes, holding));
            }
        }
        holding
    }

    /// Subtracts the loads behind rigid gears from the `holding` torques: the torque of the link's
    /// row with that link at rest.
    #[inline(always)]
    fn subtract_rigid_loads(
        &self,
        x: &State<R, N>,
        torque: &[R; N],
        modes: &Modes<R, N>,
        mut holding: [R; N],
    ) -> [R; N] {
        let at = self.arm.posture(&x.link_angle);
        let inertia = self.arm.inertia(&self.base, &at);
        let bias = self.arm.bias(&self.base, &at, &x.link_velocity);
        let mut loads = [R::splat(0.0); N];
        if EFFECTS {
            loads = self.part_accelerations_and_loads(x)[1];
        }
        for i in 0..N {
            if !self.is_rigid(i) {
                continue;
            }
            let mut held = *modes;
            held.direction[i] = R::splat(0.0);
            held.free[i] = R::splat(0.0);
            let others = self.accelerations_at(x, &at, torque, &held).link;
            let mut load = bias[i];
            if EFFECTS {
                load = load + loads[i];
            }
            for j in 0..N {
                if j != i {
                    load = inertia[i][j].mul_add(others[j], load);
                }
            }
            holding[i] = holding[i] - self.joints[i].ratio * load;
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
        let complete_stage = |(stage, rotation): Stage<R, N>, t: R| {
            let mut held = self.settle_held_motors(x, stage, modes, t);
            if EFFECTS {
                held.hysteresis = run_out_of_line::<R, _>(HysteresisWork(self, x, &held, t));
            }
            (held, rotation)
        };
        let second = complete_stage(x.second_stage::<EFFECTS>(half, a1), half);
        let a2 = self.accelerations_near(now, &second, &torque.middle, modes);
        watch.stage(1, &second.0, &a2);
        let third = complete_stage(
            x.later_stage::<EFFECTS>(half, half * half, a1, half, &a2),
            half,
        );
        let a3 = self.accelerations_near(now, &third, &torque.middle, modes);
        watch.stage(2, &third.0, &a3);
        let fourth = complete_stage(x.later_stage::<EFFECTS>(h, h * half, &a2, h, &a3), h);
        let a4 = self.accelerations_near(now, &fourth, &torque.end, modes);
        watch.stage(3, &fourth.0, &a4);
        let sixth = h * R::splat(1.0 / 6.0);
        let inner = a2.plus::<EFFECTS>(&a3);
        let for_angle = a1.plus::<EFFECTS>(&inner);
        let for_velocity = for_angle.plus::<EFFECTS>(&inner).plus::<EFFECTS>(&a4);
        complete_stage(
            x.later_stage::<EFFECTS>(h, h * sixth, &for_angle, sixth, &for_velocity),
            h,
        )
        .0
    }

    /// Sets the held motors at a stage `t` after the beginning to dtheta_M(t) = dtheta_M(0)
    /// exp(-t/tau).
    ///
    /// The equation is solved exactly instead of integrated, so tau may be any part of the step.
    #[inline(always)]
    fn settle_held_motors(
        &self,
        begin: &State<R, N>,
        mut stage: State<R, N>,
        modes: &Modes<R, N>,
        t: R,
    ) -> State<R, N> {
        if !self.settles {
            return stage;
        }
        for i in 0..N {
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
        stage
    }

    /// Accelerations at a later stage, whose link angles differ little from those of `now`.
    #[inline(always)]
    fn accelerations_near(
        &self,
        now: &Instant<A, R, N>,
        (x, rotation): &Stage<R, N>,
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
        for i in 0..N {
            let joint = &self.joints[i];
            let v = x.motor_velocity[i];
            energy = energy + half * joint.motor_inertia * v * v;
            for j in 0..N {
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
            torsion: self.gear(x, i).torsion,
            z: x.hysteresis[i],
            deflection: Self::deflection(x, i),
            part_velocity: x.part_velocity[i],
            base: Self::base_torque(x, i),
        }
    }

    /// Power [W] dissipated by friction and damping in given friction modes.
    pub fn dissipation(&self, x: &State<R, N>, modes: &Modes<R, N>) -> R {
        let mut power = R::splat(0.0);
        for (i, joint) in self.joints.iter().enumerate() {
            let v = x.motor_velocity[i];
            let w = x.link_velocity[i];
            power = power + joint.motor_viscous * v * v + joint.link_viscous * w * w;
            let dry = self.dry_friction_in(x, i);
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
        std::array::from_fn(|i| {
            if self.is_rigid(i) {
                R::splat(0.0)
            } else {
                self.transmitted(x, i, &self.gear(x, i).torsion)
            }
        })
    }
}

/// [`Plant::accelerations`].
struct AccelerationWork<'p, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>(
    &'p Plant<A, R, G, N, EFFECTS>,
    &'p State<R, N>,
    &'p A::Posture<R>,
    &'p [R; N],
    &'p Modes<R, N>,
);

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Work
    for AccelerationWork<'_, A, R, G, N, EFFECTS>
{
    type Output = Acceleration<R, N>;
    #[inline(always)]
    fn run(self) -> Self::Output {
        self.0.accelerations(self.1, self.2, self.3, self.4)
    }
}

/// [`Plant::hysteresis_states`].
struct HysteresisWork<'p, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>(
    &'p Plant<A, R, G, N, EFFECTS>,
    &'p State<R, N>,
    &'p State<R, N>,
    R,
);

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Work
    for HysteresisWork<'_, A, R, G, N, EFFECTS>
{
    type Output = [R; N];
    #[inline(always)]
    fn run(self) -> Self::Output {
        self.0.hysteresis_states(self.1, self.2, self.3)
    }
}

/// [`Plant::subtract_rigid_loads`].
struct RigidLoadWork<'p, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>(
    &'p Plant<A, R, G, N, EFFECTS>,
    &'p State<R, N>,
    &'p [R; N],
    &'p Modes<R, N>,
    [R; N],
);

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Work
    for RigidLoadWork<'_, A, R, G, N, EFFECTS>
{
    type Output = [R; N];
    #[inline(always)]
    fn run(self) -> Self::Output {
        self.0.subtract_rigid_loads(self.1, self.2, self.3, self.4)
    }
}

/// A state within a step, and the rotations of the links since its beginning.
type Stage<R, const N: usize> = (State<R, N>, [R; N]);

impl<R: Real, const N: usize> State<R, N> {
    /// q + t q', q' + t a: the second stage.
    #[inline(always)]
    fn second_stage<const EFFECTS: bool>(&self, t: R, a: &Acceleration<R, N>) -> Stage<R, N> {
        let mut next = *self;
        let mut rotation = self.link_velocity;
        for i in 0..N {
            rotation[i] = t * self.link_velocity[i];
            next.motor_angle[i] = t.mul_add(self.motor_velocity[i], self.motor_angle[i]);
            next.link_angle[i] = self.link_angle[i] + rotation[i];
            next.motor_velocity[i] = t.mul_add(a.motor[i], self.motor_velocity[i]);
            next.link_velocity[i] = t.mul_add(a.link[i], self.link_velocity[i]);
            if EFFECTS {
                next.part_angle[i] = t.mul_add(self.part_velocity[i], self.part_angle[i]);
                next.part_velocity[i] = t.mul_add(a.part[i], self.part_velocity[i]);
                next.base_torque[i] = t.mul_add(self.base_torque_rate[i], self.base_torque[i]);
                next.base_torque_rate[i] = t.mul_add(a.base[i], self.base_torque_rate[i]);
            }
        }
        (next, rotation)
    }

    /// q + t q' + s a, q' + r b: the later stages and the end.
    #[inline(always)]
    fn later_stage<const EFFECTS: bool>(
        &self,
        t: R,
        s: R,
        a: &Acceleration<R, N>,
        r: R,
        b: &Acceleration<R, N>,
    ) -> Stage<R, N> {
        let mut next = *self;
        let mut rotation = self.link_velocity;
        for i in 0..N {
            rotation[i] = s.mul_add(a.link[i], t * self.link_velocity[i]);
            next.motor_angle[i] = s.mul_add(
                a.motor[i],
                t.mul_add(self.motor_velocity[i], self.motor_angle[i]),
            );
            next.link_angle[i] = self.link_angle[i] + rotation[i];
            next.motor_velocity[i] = r.mul_add(b.motor[i], self.motor_velocity[i]);
            next.link_velocity[i] = r.mul_add(b.link[i], self.link_velocity[i]);
            if EFFECTS {
                next.part_angle[i] = s.mul_add(
                    a.part[i],
                    t.mul_add(self.part_velocity[i], self.part_angle[i]),
                );
                next.part_velocity[i] = r.mul_add(b.part[i], self.part_velocity[i]);
                next.base_torque[i] = s.mul_add(
                    a.base[i],
                    t.mul_add(self.base_torque_rate[i], self.base_torque[i]),
                );
                next.base_torque_rate[i] = r.mul_add(b.base[i], self.base_torque_rate[i]);
            }
        }
        (next, rotation)
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
