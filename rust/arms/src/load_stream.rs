//! Load on the last link of an identified arm, sample by sample.
//!
//! tau = Y(q, dq, ddq) pi + friction + Y_n phi, with the ten standard parameters phi of the load. Both
//! sides pass the same causal low-passes, so that they have the same delay. In each block of time, a
//! triangular factor of the friction of the joints and of phi is updated by the rows of all joints;
//! friction comes first, because each joint has its own. The products of these rows with those of the
//! arm's parameters give the effect of the errors of pi on phi. Planar arms, whose parameters are
//! sums, have a chain for the columns of the load.

mod factor;
mod low_pass;

use std::collections::VecDeque;

use factor::append;
use low_pass::LowPass;
use strainwave_core::compiled::{CompiledArm, LinkMotion};

/// Standard parameters of a body.
pub const BODY: usize = 10;
/// Friction of a joint: viscous, Coulomb, offset.
pub const FRICTION: usize = 3;
/// Share of a filtered row in which a joint may stick, above which the row is not used.
const MAX_STICKING: f64 = 0.1;
/// Periods of the bandwidth until a filter that starts at standstill has settled.
const SETTLING_PERIODS: f64 = 1.5;

/// Friction of a joint in addition to viscous and Coulomb friction, as size times law.
#[derive(Clone, Debug)]
pub struct Term {
    /// Joint from 0.
    pub joint: usize,
    /// Law over motor velocity, load of the gear and shape.
    pub law: Law,
    /// Shape parameter of the law.
    pub shape: f64,
    /// Size.
    pub size: f64,
}

/// Laws of further friction and springs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Law {
    /// (S15): proportional to the load of the gear.
    Load,
    /// Proportional to load and speed.
    LoadSpeed,
    /// Viscous friction of one direction.
    Direction,
    /// (S10): falls with speed.
    Stribeck,
    /// (S16): power of the speed.
    Power,
    /// Spring between link and base, without friction.
    Spring,
}

/// Reference velocity [rad/s] of (S16), and the offset of its ratio.
const POWER: (f64, f64) = (100.0, 0.01);

impl Law {
    fn per_size(self, velocity: f64, load: f64, shape: f64) -> f64 {
        match self {
            Self::Load => load.abs(),
            Self::LoadSpeed => (load * velocity).abs(),
            Self::Direction => velocity - shape * velocity.signum(),
            Self::Stribeck => (-(velocity / shape).powi(2)).exp(),
            Self::Power => (velocity.abs() / POWER.0 + POWER.1).powf(shape) - POWER.1.powf(shape),
            Self::Spring => 0.0,
        }
    }
}

/// The identified arm and the clock of its samples; lists have an entry per joint.
#[derive(Clone, Debug)]
pub struct Settings {
    /// [s] between samples.
    pub sample_time: f64,
    /// [Hz] of the equations, -3 dB.
    pub bandwidth: f64,
    /// [Hz] of the poles of the low-pass of the motion.
    pub motion_poles: f64,
    /// Samples between rows of the equations.
    pub samples_per_row: usize,
    /// Rows of a block of time.
    pub rows_per_block: usize,
    /// Blocks that are kept; the oldest is dropped.
    pub blocks: usize,
    /// Link angles per motor angle, row by row.
    pub transmission: Vec<f64>,
    /// Its inverse.
    pub inverse: Vec<f64>,
    /// Base parameters of the links.
    pub links: Vec<f64>,
    /// [kg m^2] of the motors.
    pub motor_inertia: Vec<f64>,
    /// Viscous, Coulomb and offset of each joint, at the motor.
    pub friction: Vec<f64>,
    /// Links from 0 whose viscous friction several motors carry, and its value.
    pub shared: Vec<(usize, f64)>,
    /// Further friction.
    pub terms: Vec<Term>,
    /// [rad/(N m), m/N] of the gears.
    pub compliance: Vec<f64>,
    /// [rad] that the encoders read too little, at the motor.
    pub zero: Vec<f64>,
    /// Motor torque [N m] per unit of the input.
    pub per_command: Vec<f64>,
    /// Decay of the current loop over a sample; zero without one.
    pub decay: Vec<f64>,
    /// [samples] by which inputs are later than the angles; negative: earlier.
    pub delay: Vec<f64>,
    /// [rad/s] of a motor below which it may stick.
    pub slow: Vec<f64>,
    /// Reciprocal standard deviation of the errors of each joint's equations.
    pub weight: Vec<f64>,
}

/// The equations of a block of time.
#[derive(Clone, Debug)]
struct Block {
    /// Upper triangle (n + 1, n + 1) of friction, load and torque.
    factor: Vec<f64>,
    /// (n, n_arm): rows of friction and load times those of the arm's parameters, summed.
    products: Vec<f64>,
    rows: usize,
}

/// A stream of samples of one arm.
#[derive(Clone, Debug)]
pub struct LoadStream {
    settings: Settings,
    joints: usize,
    /// Torques behind the current loops.
    currents: Vec<f64>,
    /// Motor angles and torques, the newest first.
    history: VecDeque<Vec<f64>>,
    /// Of motor angles and torques, for the torsion of elastic gears.
    drives: LowPass,
    /// Of motor angles, torques, link angles.
    motion: LowPass,
    /// Of the columns of all rows.
    equations: LowPass,
    columns: Vec<f64>,
    samples: usize,
    blocks: Vec<Block>,
    current: usize,
    is_new: bool,
}

impl Settings {
    /// Columns of a row: links, motor, shared, friction, load, torque, and whether it may stick.
    fn width(&self) -> usize {
        self.links.len() + 1 + self.shared.len() + FRICTION + BODY + 2
    }

    /// Direction of the friction of a joint.
    fn direction(&self, i: usize, velocity: f64) -> f64 {
        (velocity / self.slow[i]).clamp(-1.0, 1.0)
    }

    /// Torque that the gear of joint i carries, at the motor, and its further friction.
    fn carried(&self, i: usize, torque: f64, velocity: f64, acceleration: f64) -> (f64, f64) {
        let [viscous, coulomb, offset] = [0, 1, 2].map(|k| self.friction[FRICTION * i + k]);
        let direction = self.direction(i, velocity);
        let friction = viscous * velocity + coulomb * direction + offset;
        let net = torque - friction - self.motor_inertia[i] * acceleration;
        let per_load = |load: f64| -> f64 {
            let own = self.terms.iter().filter(|term| term.joint == i);
            own.map(|term| term.size * term.law.per_size(velocity, load, term.shape))
                .sum()
        };
        // the gear carries the load of the arm too, and friction grows with it
        let further = direction * per_load(net - direction * per_load(net));
        (net - further, further)
    }
}

impl LoadStream {
    /// A stream without samples, for an arm with that many joints.
    #[must_use]
    pub fn new(settings: Settings, joints: usize) -> Self {
        let poles = settings.bandwidth / low_pass::BANDWIDTH_OF_POLES;
        let wide = joints * settings.width();
        let n = FRICTION * joints + BODY;
        let block = Block {
            factor: vec![0.0; (n + 1) * (n + 1)],
            products: vec![0.0; n * (settings.links.len() + joints + settings.shared.len())],
            rows: 0,
        };
        Self {
            joints,
            currents: vec![0.0; joints],
            history: VecDeque::new(),
            drives: LowPass::new(settings.motion_poles, settings.sample_time, 2 * joints),
            motion: LowPass::new(settings.motion_poles, settings.sample_time, 3 * joints),
            equations: LowPass::new(poles, settings.sample_time, wide),
            columns: vec![0.0; wide],
            samples: 0,
            blocks: vec![block; settings.blocks],
            current: 0,
            is_new: true,
            settings,
        }
    }

    /// Forgets all samples; the next one may follow a gap.
    pub fn reset(&mut self) {
        *self = Self::new(self.settings.clone(), self.joints);
    }

    /// Adds one sample of motor angles [rad] and inputs, torques [N m] or voltages [V].
    ///
    /// The last ten parameters of `chain` are those of the last link; `None`: it is the arm.
    ///
    /// # Panics
    /// The lists have another length than the arm has joints.
    pub fn update(
        &mut self,
        arm: &dyn CompiledArm,
        chain: Option<&dyn CompiledArm>,
        angle: &[f64],
        input: &[f64],
    ) {
        let n = self.joints;
        assert!(angle.len() == n && input.len() == n, "an entry per joint");
        let mut signals = vec![0.0; 3 * n];
        for i in 0..n {
            signals[i] = angle[i] + self.settings.zero[i];
            let torque = self.settings.per_command[i] * input[i];
            let (decay, before) = (self.settings.decay[i], self.currents[i]);
            let is_first = self.samples == 0;
            signals[n + i] = if decay == 0.0 || is_first {
                torque
            } else {
                before
            };
            self.currents[i] = torque + decay * (signals[n + i] - torque);
        }
        self.align(&mut signals[..2 * n]);
        self.add_links(&mut signals);
        self.motion.pass(&signals);
        self.fill_columns(arm, chain);
        self.equations.pass(&self.columns);
        self.samples += 1;
        let settled = SETTLING_PERIODS / (self.settings.bandwidth * self.settings.sample_time);
        let is_settled = self.samples as f64 > settled;
        if is_settled && self.samples.is_multiple_of(self.settings.samples_per_row) {
            self.append_rows();
        }
    }

    /// Filled blocks from the oldest: factors and products, row by row.
    #[must_use]
    pub fn equations(&self) -> Vec<(&[f64], &[f64])> {
        let count = self.blocks.len();
        let from_oldest = (1..=count).map(|k| &self.blocks[(self.current + k) % count]);
        let filled = from_oldest.filter(|block| block.rows > 0);
        filled
            .map(|block| (&block.factor[..], &block.products[..]))
            .collect()
    }

    /// Adds the link angles to motor angles and torques, behind gears that are twisted.
    ///
    /// The torques of the gears are those of filtered signals; angles and torques have the same delay.
    fn add_links(&mut self, signals: &mut [f64]) {
        let (n, settings) = (self.joints, &self.settings);
        let mut gears = vec![0.0; n];
        if settings.compliance.iter().any(|x| *x != 0.0) {
            self.drives.pass(&signals[..2 * n]);
            let [drives, velocity, acceleration] = self.drives.derivatives();
            for i in 0..n {
                let (net, _) = settings.carried(i, drives[n + i], velocity[i], acceleration[i]);
                for (j, gear) in gears.iter_mut().enumerate() {
                    *gear += net * settings.inverse[i * n + j];
                }
            }
            signals[..2 * n].copy_from_slice(drives);
        }
        for i in 0..n {
            let ratios = &settings.transmission[i * n..(i + 1) * n];
            signals[2 * n + i] = dot(ratios, &signals[..n]) - settings.compliance[i] * gears[i];
        }
    }

    /// Replaces angles and torques by those of the latest common time.
    fn align(&mut self, signals: &mut [f64]) {
        let delay = &self.settings.delay;
        if delay.iter().all(|samples| *samples == 0.0) {
            return;
        }
        let latest = delay.iter().copied().fold(0.0, f64::max);
        let longest = latest - delay.iter().copied().fold(0.0, f64::min);
        self.history.push_front(signals.to_vec());
        self.history.truncate(longest as usize + 2);
        let oldest = self.history.len() - 1;
        for (k, signal) in signals.iter_mut().enumerate() {
            let ago = if k < self.joints {
                latest
            } else {
                latest - delay[k - self.joints]
            };
            let (whole, part) = (ago as usize, ago.fract());
            let at = |samples: usize| self.history[samples.min(oldest)][k];
            *signal = at(whole) + part * (at(whole + 1) - at(whole));
        }
    }

    /// Unfiltered columns of all rows at the filtered motion.
    fn fill_columns(&mut self, arm: &dyn CompiledArm, chain: Option<&dyn CompiledArm>) {
        let (n, settings) = (self.joints, &self.settings);
        let [motors, velocity, acceleration] = self.motion.derivatives();
        let (q, dq, ddq) = (&motors[2 * n..], &velocity[2 * n..], &acceleration[2 * n..]);
        let torque = &motors[n..2 * n];
        let motion = LinkMotion {
            angle: q,
            velocity: dq,
            acceleration: ddq,
        };
        let regressor = arm.base_regressor(&motion);
        let of_chain = chain.map(|chain| chain.base_regressor(&motion));
        let of_load = of_chain.as_ref().unwrap_or(&regressor);
        let per_joint = of_load.len() / n;
        let (links, shared, width) = (
            settings.links.len(),
            settings.shared.len(),
            settings.width(),
        );
        let (friction, load_at) = (links + 1 + shared, links + 1 + shared + FRICTION);
        for i in 0..n {
            let row = &mut self.columns[i * width..(i + 1) * width];
            row.fill(0.0);
            for j in 0..n {
                let ratio = settings.transmission[j * n + i];
                if ratio != 0.0 {
                    for (x, y) in row.iter_mut().zip(&regressor[j * links..(j + 1) * links]) {
                        *x += ratio * y;
                    }
                    let last = &of_load[(j + 1) * per_joint - BODY..(j + 1) * per_joint];
                    for (x, y) in row[load_at..].iter_mut().zip(last) {
                        *x += ratio * y;
                    }
                }
            }
            let direction = settings.direction(i, velocity[i]);
            row[links] = acceleration[i];
            for (k, (link, _)) in settings.shared.iter().enumerate() {
                row[links + 1 + k] = settings.transmission[link * n + i] * dq[*link];
            }
            row[friction..friction + FRICTION].copy_from_slice(&[velocity[i], direction, 1.0]);
            let rotor = settings.motor_inertia[i] * acceleration[i];
            let (_, further) = settings.carried(i, torque[i], velocity[i], acceleration[i]);
            let springs: f64 = settings
                .terms
                .iter()
                .filter(|term| term.law == Law::Spring)
                .map(|t| settings.transmission[t.joint * n + i] * t.size * q[t.joint])
                .sum();
            let by_links = settings.shared.iter().zip(&row[links + 1..]);
            let shared_friction: f64 = by_links.map(|((_, size), x)| size * x).sum();
            let known = dot(&row[..links], &settings.links) + rotor + springs + shared_friction;
            row[width - 2] = torque[i] - known - further;
            row[width - 1] = f64::from(velocity[i].abs() < settings.slow[i]);
        }
    }

    /// Updates the block of the present time by the filtered rows of all joints.
    fn append_rows(&mut self) {
        let (n, links) = (self.joints, self.settings.links.len());
        let (shared, width) = (self.settings.shared.len(), self.settings.width());
        let count = FRICTION * n + BODY;
        let filtered = self.equations.values();
        let mut equations = filtered.chunks_exact(width);
        if equations.all(|row| row[width - 1] > MAX_STICKING) {
            return;
        }
        if self.blocks[self.current].rows == self.settings.rows_per_block || self.is_new {
            self.current = (self.current + 1) % self.blocks.len();
            let block = &mut self.blocks[self.current];
            block.factor.fill(0.0);
            block.products.fill(0.0);
            block.rows = 0;
            self.is_new = false;
        }
        let block = &mut self.blocks[self.current];
        block.rows += 1;
        for (i, row) in filtered.chunks_exact(width).enumerate() {
            if row[width - 1] > MAX_STICKING {
                continue;
            }
            let weight = self.settings.weight[i];
            let mut equation = [0.0; FRICTION + BODY + 1];
            for (entry, x) in equation.iter_mut().zip(&row[links + 1 + shared..]) {
                *entry = weight * x;
            }
            let at = |k: usize| match k {
                k if k < FRICTION => FRICTION * i + k,
                k => FRICTION * n + k - FRICTION,
            };
            let arm_columns = links + n + shared;
            for (k, x) in equation[..FRICTION + BODY].iter().enumerate() {
                let products = &mut block.products[at(k) * arm_columns..][..arm_columns];
                for (sum, y) in products.iter_mut().zip(&row[..links]) {
                    *sum += weight * x * y;
                }
                products[links + i] += weight * x * row[links];
                for s in 0..shared {
                    products[links + n + s] += weight * x * row[links + 1 + s];
                }
            }
            append(&mut block.factor, count + 1, &mut equation, at);
        }
    }
}

fn dot(x: &[f64], y: &[f64]) -> f64 {
    x.iter().zip(y).map(|(a, b)| a * b).sum()
}
