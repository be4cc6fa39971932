//! Variational equations of the Runge-Kutta step, for arms with elastic gears.
//!
//! Within a step with fixed friction modes, the derivatives of the motion obey linear equations
//! whose coefficients are the same in every direction. The simulated step records a [`Trace`] of
//! its four stages; [`LinearisedStep`] computes the coefficients of all four in lanes; each
//! [`crate::sensitivity::tangent_block::TangentBlock`] of directions advances through the stages
//! with a few multiply-adds.
//!
//! Torsions replace motor angles, because no equation depends on motor angles alone. With gear
//! torques s, primes for derivatives, and without the terms of parameters:
//!
//! - s' = K delta' + d_G (n dtheta_M' - dtheta_L')
//! - n ddtheta_M' = -(n^2/m_M) s' - (d_M/m_M) n dtheta_M'
//! - ddtheta_L' = M_L^-1 (s' - (M_L ddtheta_L + c + g)' - d_L dtheta_L')

use crate::arm::{Arm, Outlined};
use crate::experiment::Source;
use crate::joint::gear::{Gears, Spring};
use crate::plant::config::Config;
use crate::plant::{Modes, Plant, State};
use crate::scalar::{Lanes, Real, inverse, run_out_of_line, works};
use crate::sensitivity::Variant;
use crate::sensitivity::effect::EffectSensitivity;
use crate::sensitivity::forcing::{GEAR, LINK_VISCOUS_QUAD, LinkForcing, MOTOR, Quads, zero_quads};
use crate::sensitivity::trace::{Stages, Trace};

/// Coefficients of the linear equations at the four stages, in the units of
/// [`crate::sensitivity::tangent::Tangent`].
pub(crate) struct LinearisedStep<A: Arm<N>, L: Lanes, G: Gears, const N: usize> {
    pub(crate) plant: Plant<A, L, G, N>,
    shared: [Shared<L, G>; N],
    /// Number of parameters of each gear's law.
    of_law: [usize; N],
    /// Half of the integrator's step [s].
    pub(crate) half: f64,
    pub(crate) stiffness: [Stages; N],
    pub(crate) inverse: [[Stages; N]; N],
    /// Derivatives of the load torque of each link with respect to link angles and velocities.
    pub(crate) by_angle: [[Stages; N]; N],
    pub(crate) by_velocity: [[Stages; N]; N],
    pub(crate) damping: [f64; N],
    /// n ddtheta_M' per gear torque, per n dtheta_M' and per motor torque.
    pub(crate) motor: [[f64; N]; 3],
    /// Derivatives with respect to parameters, and those with respect to sizes of effects of each
    /// further variant.
    pub(crate) quads: Vec<Quads<N>>,
    pub(crate) link_forcing: LinkForcing,
    /// At the four stages; updated in place, because it is long for long chains.
    regressor: A::Regressor<L>,
    /// Effects of size zero, of each variant.
    pub(crate) effects: Vec<EffectSensitivity<L, N>>,
    pub(crate) settling: [Option<Settling>; N],
}

/// Terms of a gear's derivatives that do not depend on the torsion.
type Shared<L, G> = <<G as Gears>::Spring<L> as Spring<L>>::Shared;

/// Motion of a settling motor over half a step and over a whole one, relative to constant velocity:
/// its angle changes by v tau (1 - exp(-t/tau)) instead of v t, its velocity is v exp(-t/tau)
/// instead of v.
#[derive(Clone, Copy)]
pub(crate) struct Settling {
    /// Change of the angle per velocity, times the gear ratio like all that follows.
    pub(crate) angle: [f64; 2],
    /// Change of the velocity per velocity.
    pub(crate) velocity: [f64; 2],
    /// Derivatives of both with respect to the settling time.
    pub(crate) by_time: [[f64; 2]; 2],
}

impl Settling {
    /// Motion over a step of length `h`; velocities are angles per `half` [s].
    fn new(time: f64, speed: f64, h: f64, half: f64) -> Self {
        let parts = [0.5 * h, h];
        let decay = parts.map(|t| (-t / time).exp());
        let each = |f: &dyn Fn(f64, f64) -> f64| [f(parts[0], decay[0]), f(parts[1], decay[1])];
        Self {
            angle: each(&|t, decay| (time * (1.0 - decay) - t) / half),
            velocity: each(&|_, decay| decay - 1.0),
            by_time: [
                each(&|t, decay| speed * (1.0 - decay - decay * t / time)),
                each(&|t, decay| half * speed * decay * t / (time * time)),
            ],
        }
    }
}

impl<A: Arm<N>, L: Lanes, G: Gears, const N: usize> LinearisedStep<A, L, G, N> {
    /// For an arm without effects and steps of length `step` [s]. Directions, of which a block has
    /// `lanes`, are by the parameters of `requested`, which may have effects of size zero, in several
    /// variants; the motion begins in a state.
    pub(crate) fn new<S: Real>(
        config: &Config<A, N>,
        parameters: &[f64],
        (requested, variants): (&Config<A, N>, &[Variant<'_>]),
        (directions, lanes): (&[Source], usize),
        begin: &State<S, N>,
        step: f64,
    ) -> Self {
        let plant: Plant<A, L, G, N> = config.plant_of(|k| L::splat(parameters[k]));
        let half = 0.5 * step;
        Self {
            shared: plant.joints.map(|joint| joint.spring.shared()),
            of_law: config.joints.map(|joint| joint.gear.parameters.len()),
            half,
            stiffness: [[0.0; 4]; N],
            inverse: [[[0.0; 4]; N]; N],
            by_angle: [[[0.0; 4]; N]; N],
            by_velocity: [[[0.0; 4]; N]; N],
            damping: plant.joints.map(|joint| joint.gear_damping.lane(0) / half),
            motor: [[0.0; N]; 3],
            quads: vec![zero_quads(); variants.len()],
            link_forcing: LinkForcing::new(requested, directions, lanes),
            regressor: config.arm.zero_regressor(),
            effects: variants
                .iter()
                .filter(|_| requested.has_effects())
                .map(|one| EffectSensitivity::new(requested, one.parameters, one.directions, begin))
                .collect(),
            settling: [None; N],
            plant,
        }
    }

    /// Computes the coefficients of a step that begins in a posture; for some arms in a separate
    /// function, compiled for the registers of `V`.
    #[inline(always)]
    pub(crate) fn update<V: Real, S: Real>(
        &mut self,
        trace: &Trace<A, N>,
        begin: &A::Posture<S>,
        modes: &Modes<S, N>,
        h: f64,
    ) {
        if A::OUTLINED == Outlined::Nothing {
            self.compute(trace, begin, modes, h);
        } else {
            run_out_of_line::<V, _>(UpdateWork(self, trace, begin, modes, h));
        }
    }

    #[inline(always)]
    fn compute<S: Real>(
        &mut self,
        trace: &Trace<A, N>,
        begin: &A::Posture<S>,
        modes: &Modes<S, N>,
        h: f64,
    ) {
        for i in 0..self.plant.arm.joints() {
            self.motor(trace, modes, i, h);
        }
        for first in (0..4).step_by(L::LANES) {
            self.links(
                trace,
                &A::map_posture(begin, |number| L::splat(number.lane(0))),
                first,
            );
            for i in 0..self.plant.arm.joints() {
                self.gear(trace, i, first);
            }
        }
        let push = std::array::from_fn(|i| -self.motor[2][i]);
        for (effects, quads) in self.effects.iter().zip(&mut self.quads) {
            effects.add_to_quads(quads, &self.plant, (trace, h), modes, &push);
        }
    }

    /// Sets the states of effects to the end of a step.
    #[inline(always)]
    pub(crate) fn advance_effect_states<S: Real>(
        &mut self,
        trace: &Trace<A, N>,
        end: &State<S, N>,
        h: f64,
    ) {
        for effects in &mut self.effects {
            effects.advance_effect_states(&self.plant, trace, end, h);
        }
    }

    /// Coefficients of one motor, sliding or held.
    #[inline(always)]
    fn motor<S: Real>(&mut self, trace: &Trace<A, N>, modes: &Modes<S, N>, i: usize, h: f64) {
        let (joint, half) = (&self.plant.joints[i], self.half);
        let (time, n) = (joint.settling_time.lane(0), joint.ratio.lane(0));
        self.settling[i] = None;
        if time > 0.0 && modes.free[i].lane(0) == 0.0 {
            let speed = n * trace.stages[0].motor_velocity[i];
            self.settling[i] = Some(Settling::new(time, speed, h, half));
        }
        let free = modes.free[i].lane(0) * joint.motor_mobility.lane(0) * half;
        let push = n * free * half;
        self.motor[0][i] = -n * push;
        self.motor[1][i] = -joint.motor_viscous.lane(0) * free;
        self.motor[2][i] = push;
        let direction = modes.direction[i].lane(0);
        for k in 0..4 {
            let stage = &trace.stages[k];
            let (acceleration, velocity) = (stage.motor_acceleration[i], stage.motor_velocity[i]);
            let by = [acceleration, velocity, direction, 1.0];
            store_scaled::<L>(&mut self.quads[0][i][MOTOR].0[k], &by, -push);
        }
    }

    /// Coefficients of the links, for the stages from the `first`.
    #[inline(always)]
    fn links(&mut self, trace: &Trace<A, N>, begin: &A::Posture<L>, first: usize) {
        let mut rotation: [L; N] = trace.joints(first, |stage| &stage.angle);
        for i in 0..self.plant.arm.joints() {
            rotation[i] = rotation[i] - trace.stages[0].angle[i];
        }
        let dq = trace.joints(first, |stage| &stage.velocity);
        let ddq = trace.joints(first, |stage| &stage.link_acceleration);
        let arm = &self.plant.arm;
        let at = arm.near(begin, &rotation);
        let base = &self.plant.base;
        let (inertia, mut slopes) = arm.linearised_equations(base, &at, &dq, &ddq);
        for i in 0..self.plant.arm.joints() {
            slopes.velocity[i][i] = slopes.velocity[i][i] + self.plant.joints[i].link_viscous;
        }
        let (square, rate) = (L::splat(self.half * self.half), L::splat(1.0 / self.half));
        let inverse = inverse(&inertia, square, arm.joints());
        for j in 0..self.plant.arm.joints() {
            for i in 0..self.plant.arm.joints() {
                inverse[j][i].store(&mut self.inverse[i][j][first..]);
                if A::DEPENDS_ON_ANGLE[j] {
                    slopes.angle[i][j].store(&mut self.by_angle[i][j][first..]);
                }
                (rate * slopes.velocity[i][j]).store(&mut self.by_velocity[i][j][first..]);
            }
        }
        arm.update_regressor(&at, &dq, &ddq, &mut self.regressor);
        let (by, zero) = (self.regressor.as_ref(), L::splat(0.0));
        self.link_forcing.set(arm, by, first);
        for i in 0..arm.joints() {
            let four = [dq[i], zero, zero, zero];
            L::store_rows(&four, &mut self.quads[0][i][LINK_VISCOUS_QUAD].0[first..]);
        }
    }

    /// Coefficients of one gear, for the stages from the `first`.
    #[inline(always)]
    fn gear(&mut self, trace: &Trace<A, N>, i: usize, first: usize) {
        let (joint, quads) = (&self.plant.joints[i], &mut self.quads[0][i]);
        let torsion = trace.across::<L>(first, |stage| stage.torsion[i]);
        let rate = trace.across::<L>(first, |stage| stage.rate[i]);
        let stiffness = joint.spring.stiffness(torsion);
        stiffness.store(&mut self.stiffness[i][first..]);
        let by = joint.spring.by_parameters(torsion, &self.shared[i]);
        L::store_rows(&[rate, by[0], by[1], by[2]], &mut quads[GEAR].0[first..]);
        if self.of_law[i] > 3 {
            L::store_rows(
                &[by[3], by[4], by[5], by[6]],
                &mut quads[GEAR + 1].0[first..],
            );
        }
    }
}

works! {
    ['s, A: Arm<N>, L: Lanes, S: Real, G: Gears, const N: usize] ['s, A, L, S, G, N]
    /// [`LinearisedStep::compute`].
    UpdateWork(0: &'s mut LinearisedStep<A, L, G, N>, 1: &'s Trace<A, N>, 2: &'s A::Posture<S>,
        3: &'s Modes<S, N>, 4: f64) -> () = LinearisedStep::compute;
}

/// Stores four numbers times a factor, as one vector if possible.
#[inline(always)]
fn store_scaled<L: Real>(to: &mut [f64; 4], numbers: &[f64; 4], factor: f64) {
    for first in (0..4).step_by(L::LANES) {
        (L::load(&numbers[first..]) * factor).store(&mut to[first..]);
    }
}
