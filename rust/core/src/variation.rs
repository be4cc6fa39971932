//! The variational equations of the very Runge-Kutta step, for arms whose gears are all elastic.
//!
//! Within a step whose friction modes stay, the derivatives of the motion obey linear equations
//! whose coefficients are the same in every direction. The nominal step leaves a [`Trace`] of its
//! four stages; [`Linearised`] makes the coefficients of all four from it at once, stages side by
//! side; and each [`crate::column::Column`] of directions goes through the stages with a few multiply-adds.
//!
//! The coordinates are twist and twist rate of the gears in place of the motors' angles and
//! velocities: nothing depends on those alone. With s the gear torques, primes for derivatives:
//!
//! - s' = K twist' + d_G rate' + its own change with K1 ... T2, d_G
//! - n ddtheta_M' = -(n^2/m_M) s' - (d_M/m_M) (rate' + dtheta_L') + ...
//! - ddtheta_L' = M_L^-1 (s' - (M_L ddtheta_L + c + g)' - d_L dtheta_L') - ...

use crate::arm::{Arm, MOST_BASE};
use crate::config::{Config, GearKind, SETTLING};
use crate::gear::PerSlope;
use crate::onset::{Drive, Onset};
use crate::plant::{Acceleration, Modes, Plant, State, Watch, solve};
use crate::real::Real;

/// A number at each of the four stages.
pub(crate) type Stages = [f64; 4];

/// What the nominal step went through.
///
/// Stage by stage, not quantity by quantity: a vector loaded from numbers that were just stored one
/// by one would wait until the whole step has retired.
#[derive(Clone, Copy)]
pub(crate) struct Trace<const N: usize> {
    pub(crate) ratio: [f64; N],
    pub(crate) stages: [Stage<N>; 4],
}

/// One of its stages.
#[derive(Clone, Copy)]
pub(crate) struct Stage<const N: usize> {
    pub(crate) angle: [f64; N],
    pub(crate) velocity: [f64; N],
    pub(crate) twist: [f64; N],
    pub(crate) motor_velocity: [f64; N],
    pub(crate) motor_acceleration: [f64; N],
    pub(crate) link_acceleration: [f64; N],
}

impl<const N: usize> Trace<N> {
    pub(crate) fn new(ratio: [f64; N]) -> Self {
        let nothing = [0.0; N];
        let stage = Stage {
            angle: nothing,
            velocity: nothing,
            twist: nothing,
            motor_velocity: nothing,
            motor_acceleration: nothing,
            link_acceleration: nothing,
        };
        Self {
            ratio,
            stages: [stage; 4],
        }
    }

    /// A number at each stage.
    #[inline(always)]
    pub(crate) fn each(&self, number: impl Fn(&Stage<N>) -> f64) -> Stages {
        [0, 1, 2, 3].map(|k| number(&self.stages[k]))
    }

    /// The same, stages side by side, from the `first`.
    #[inline(always)]
    fn across<L: Real>(&self, first: usize, number: impl Fn(&Stage<N>) -> f64) -> L {
        L::load(&self.each(number)[first..])
    }

    /// The same of each joint.
    #[inline(always)]
    fn joints<L: Real>(&self, first: usize, numbers: impl Fn(&Stage<N>) -> &[f64; N]) -> [L; N] {
        let mut all = [L::splat(0.0); N];
        for i in 0..N {
            all[i] = self.across(first, |stage| numbers(stage)[i]);
        }
        all
    }
}

impl<S: Real, const N: usize> Watch<S, N> for Trace<N> {
    #[inline(always)]
    fn stage(&mut self, k: usize, x: &State<S, N>, a: &Acceleration<S, N>) {
        let stage = &mut self.stages[k];
        for i in 0..N {
            let twist = S::splat(self.ratio[i]).mul_add(x.motor_angle[i], -x.link_angle[i]);
            stage.angle[i] = x.link_angle[i].lane(0);
            stage.velocity[i] = x.link_velocity[i].lane(0);
            stage.twist[i] = twist.lane(0);
            stage.motor_velocity[i] = x.motor_velocity[i].lane(0);
            stage.motor_acceleration[i] = a.motor[i].lane(0);
            stage.link_acceleration[i] = a.link[i].lane(0);
        }
    }
}

/// The row of the equations that a parameter enters.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Row {
    /// The gear's torque.
    Gear,
    /// n times the motor's acceleration.
    Motor,
    /// The links' accelerations, all of them.
    Links,
}

/// Where a parameter enters: a row, of which joint, and the entry that says how much.
#[derive(Clone, Copy)]
pub(crate) struct Place {
    pub(crate) row: Row,
    pub(crate) joint: usize,
    pub(crate) entry: usize,
}

/// Every parameter's places.
pub(crate) type Places = Vec<Vec<Place>>;

/// Of a configuration's parameters, each with N entries of its own from the second on; those of a
/// kinematic error, which enters two rows, have their second ones behind all these.
pub(crate) fn places<A: Arm<N>, const N: usize>(config: &Config<A, N>) -> Places {
    let names = config.parameter_names();
    let behind = 1 + names.len() * N;
    let place = |(k, &(name, joint)): (usize, &(&str, Option<usize>))| {
        let (i, entry) = (joint.unwrap_or(1) - 1, 1 + k * N);
        let at = |row, joint, entry| Place { row, joint, entry };
        match name {
            "motor_inertia"
            | "motor_viscous_friction"
            | "motor_coulomb_friction"
            | "friction_offset"
            | "stribeck_friction" => vec![at(Row::Motor, i, entry)],
            // theirs stay zero: the first acts through `Settling` alone, the others not at all
            // where the effect itself is nothing
            SETTLING | "stribeck_velocity" | "hysteresis_twist" => vec![at(Row::Motor, i, entry)],
            "hysteresis_torque" => vec![at(Row::Gear, i, entry)],
            "kinematic_error_cos" | "kinematic_error_sin" => {
                let other = behind + 2 * i + usize::from(name.ends_with("sin"));
                vec![at(Row::Gear, i, entry), at(Row::Motor, i, other)]
            }
            _ if name.starts_with("gear_") => vec![at(Row::Gear, i, entry)],
            _ => (0..N).map(|j| at(Row::Links, j, entry + j)).collect(),
        }
    };
    names.iter().enumerate().map(place).collect()
}

/// Coefficients of the linear equations at the four stages.
pub(crate) struct Linearised<A: Arm<N>, L: Real, const N: usize> {
    plant: Plant<A, L, N, true>,
    per_slope: [PerSlope<L>; N],
    gears: [GearKind; N],
    pub(crate) stiffness: [Stages; N],
    pub(crate) inverse: [[Stages; N]; N],
    pub(crate) by_angle: [[Stages; N]; N],
    pub(crate) by_velocity: [[Stages; N]; N],
    pub(crate) damping: [f64; N],
    /// n ddtheta_M' per gear torque, per n dtheta_M' and per motor torque.
    pub(crate) motor: [[f64; N]; 3],
    /// What each parameter adds to its row: N places each, from the second on.
    pub(crate) entries: Vec<Stages>,
    /// How many parameters each joint's effects have.
    of_effects: [usize; N],
    /// What a little of the effects that the arm lacks would add.
    pub(crate) onset: Option<Onset<N>>,
    pub(crate) settling: [Option<Settling>; N],
}

/// How a held motor that settles moves over half a step and over the whole, beside a steady one:
/// its angle by v tau (1 - exp(-t/tau)) instead of v t, its velocity by v exp(-t/tau) instead of v.
#[derive(Clone, Copy)]
pub(crate) struct Settling {
    /// Change of the angle per velocity, times the gear ratio as all that follows.
    pub(crate) angle: [f64; 2],
    /// Change of the velocity per velocity.
    pub(crate) velocity: [f64; 2],
    /// Both again, per settling time.
    pub(crate) by_time: [[f64; 2]; 2],
}

impl Settling {
    fn new(time: f64, speed: f64, h: f64) -> Self {
        let parts = [0.5 * h, h];
        let left = parts.map(|t| (-t / time).exp());
        let each = |f: &dyn Fn(f64, f64) -> f64| [f(parts[0], left[0]), f(parts[1], left[1])];
        Self {
            angle: each(&|t, left| time * (1.0 - left) - t),
            velocity: each(&|_, left| left - 1.0),
            by_time: [
                each(&|t, left| speed * (1.0 - left - left * t / time)),
                each(&|t, left| speed * left * t / (time * time)),
            ],
        }
    }
}

impl<A: Arm<N>, L: Real, const N: usize> Linearised<A, L, N> {
    /// Of an arm without effects. Directions are by the parameters of `asked`, which may have
    /// effects whose sizes are nothing.
    pub(crate) fn new(
        config: &Config<A, N>,
        parameters: &[f64],
        (asked, all): (&Config<A, N>, &[f64]),
    ) -> Self {
        let plant: Plant<A, L, N, true> = config.plant_of(|k| L::splat(parameters[k]));
        let places = places(asked);
        Self {
            per_slope: plant.joints.map(|joint| joint.spring.per_slope()),
            gears: config.joints.map(|joint| joint.gear),
            stiffness: [[0.0; 4]; N],
            inverse: [[[0.0; 4]; N]; N],
            by_angle: [[[0.0; 4]; N]; N],
            by_velocity: [[[0.0; 4]; N]; N],
            damping: plant.joints.map(|joint| joint.gear_damping.lane(0)),
            motor: [[0.0; N]; 3],
            entries: vec![[0.0; 4]; 1 + all.len() * N + 2 * N],
            of_effects: asked.joints.map(|joint| joint.effects.names().count()),
            onset: asked.has_effects().then(|| Onset::new(asked, all, &places)),
            settling: [None; N],
            plant,
        }
    }

    /// Makes the coefficients of a step that begins in a posture.
    #[inline(always)]
    pub(crate) fn update<S: Real>(
        &mut self,
        trace: &Trace<N>,
        begin: &A::Posture<S>,
        modes: &Modes<S, N>,
        h: f64,
    ) {
        for i in 0..N {
            self.settling[i] = None;
            let time = self.plant.joints[i].settling_time.lane(0);
            if time > 0.0 && modes.free[i].lane(0) == 0.0 {
                let speed = self.plant.joints[i].ratio.lane(0) * trace.stages[0].motor_velocity[i];
                self.settling[i] = Some(Settling::new(time, speed, h));
            }
            let joint = &self.plant.joints[i];
            let (n, mobility) = (joint.ratio.lane(0), joint.motor_mobility.lane(0));
            let free = modes.free[i].lane(0) * mobility;
            self.motor[0][i] = -n * n * free;
            self.motor[1][i] = -joint.motor_viscous.lane(0) * free;
            self.motor[2][i] = n * free;
        }
        for first in (0..4).step_by(L::LANES) {
            self.links(trace, &A::spread(begin), first);
            self.drives(trace, modes, first);
        }
        if let Some(onset) = &self.onset {
            onset.twist(&mut self.entries, trace, h);
        }
    }

    /// Link side, for the stages from the `first`.
    #[inline(always)]
    fn links(&mut self, trace: &Trace<N>, begin: &A::Posture<L>, first: usize) {
        let mut turned: [L; N] = trace.joints(first, |stage| &stage.angle);
        for i in 0..N {
            turned[i] = turned[i] - L::splat(trace.stages[0].angle[i]);
        }
        let dq = trace.joints(first, |stage| &stage.velocity);
        let ddq = trace.joints(first, |stage| &stage.link_acceleration);
        let at = A::near(begin, &turned);
        let base = &self.plant.base;
        let inertia = A::inertia(base, &at);
        let mut slopes = A::slopes(base, &at, &dq, &ddq);
        for i in 0..N {
            slopes.velocity[i][i] = slopes.velocity[i][i] + self.plant.joints[i].link_viscous;
        }
        let mut columns = [[L::splat(0.0); N]; N];
        for j in 0..N {
            columns[j][j] = L::splat(1.0);
            columns[j] = solve(&inertia, &columns[j]);
        }
        for i in 0..N {
            for j in 0..N {
                columns[j][i].store(&mut self.inverse[i][j][first..]);
                if A::FELT[j] {
                    let force = column(&slopes.angle, j);
                    resisted(&columns, &force, i).store(&mut self.by_angle[i][j][first..]);
                }
                let force = column(&slopes.velocity, j);
                resisted(&columns, &force, i).store(&mut self.by_velocity[i][j][first..]);
            }
        }
        let regressor: [[L; N]; MOST_BASE] = A::regressor(&at, &dq, &ddq);
        for b in 0..A::NAMES.len() {
            for i in 0..N {
                let entry = &mut self.entries[1 + b * N + i];
                resisted(&columns, &regressor[b], i).store(&mut entry[first..]);
            }
        }
        let mut k = A::NAMES.len();
        for j in 0..N {
            let own = &mut self.entries[1 + (k + 4) * N..][..N];
            for i in 0..N {
                (-columns[j][i] * dq[j]).store(&mut own[i][first..]);
            }
            k += 5 + self.gears[j].parameters() + self.of_effects[j];
        }
    }

    /// Motors and gears, for the stages from the `first`.
    #[inline(always)]
    fn drives<S: Real>(&mut self, trace: &Trace<N>, modes: &Modes<S, N>, first: usize) {
        let mut k = A::NAMES.len();
        for i in 0..N {
            let joint = &self.plant.joints[i];
            let push = L::splat(-self.motor[2][i]);
            let velocity = trace.across::<L>(first, |stage| stage.motor_velocity[i]);
            let acceleration = trace.across::<L>(first, |stage| stage.motor_acceleration[i]);
            let twist = trace.across::<L>(first, |stage| stage.twist[i]);
            let rate = joint.ratio.mul_add(
                velocity,
                -trace.across::<L>(first, |stage| stage.velocity[i]),
            );
            let direction = L::splat(modes.direction[i].lane(0));
            let motor = [push * acceleration, push * velocity, push * direction, push];
            store::<L, N, _>(&mut self.entries, (k, first), &motor);
            k += 5;
            let stiffness = joint.spring.stiffness(twist);
            stiffness.store(&mut self.stiffness[i][first..]);
            if self.gears[i] == GearKind::ThreeSlope {
                let by = joint.spring.by_parameters(twist, &self.per_slope[i]);
                store::<L, N, _>(&mut self.entries, (k, first), &by);
            } else {
                store::<L, N, _>(&mut self.entries, (k, first), &[twist]);
            }
            k += self.gears[i].parameters();
            store::<L, N, _>(&mut self.entries, (k - 2, first), &[rate]);
            k += self.of_effects[i];
            if let Some(onset) = &self.onset {
                let angle = trace.across::<L>(first, |stage| stage.angle[i]);
                let drive = Drive {
                    motor_angle: (twist + angle) * L::splat(1.0 / trace.ratio[i]),
                    motor_velocity: velocity,
                    direction,
                    push,
                    stiffness,
                    transmitted: joint.gear_damping.mul_add(rate, joint.spring.torque(twist)),
                };
                onset.enter(&mut self.entries, (i, first), joint, &drive);
            }
        }
    }
}

/// What the parameters from the `k`-th on add to their one row.
#[inline(always)]
fn store<L: Real, const N: usize, const C: usize>(
    entries: &mut [Stages],
    (k, first): (usize, usize),
    values: &[L; C],
) {
    // one check, not one for each
    let own = &mut entries[1 + k * N..][..C * N];
    for c in 0..C {
        values[c].store(&mut own[c * N][first..]);
    }
}

#[inline(always)]
fn column<L: Copy, const N: usize>(matrix: &[[L; N]; N], j: usize) -> [L; N] {
    let mut column = matrix[0];
    for i in 0..N {
        column[i] = matrix[i][j];
    }
    column
}

/// What a torque that a link's row has on its left side takes from the acceleration of link `i`.
#[inline(always)]
fn resisted<L: Real, const N: usize>(inverse: &[[L; N]; N], torque: &[L; N], i: usize) -> L {
    let mut sum = -(inverse[0][i] * torque[0]);
    for j in 1..N {
        sum = (-inverse[j][i]).mul_add(torque[j], sum);
    }
    sum
}
