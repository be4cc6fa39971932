//! Sampled linear control laws, one per joint.

use std::sync::Arc;

use super::Controller;
use crate::scalar::{Real, works};

/// Largest number of states of the law of a joint.
pub const MAX_LAW_STATES: usize = 16;

/// A linear law for each joint, from the encoder reading y to the voltage u [V]:
///
/// v_k = C x_k + D (r_k, w_k, y_k),   u_k = v_k + feed-forward_k, limited
/// x_k+1 = A x_k + B (r_k, w_k, y_k) + E (u_k - feed-forward_k)
///
/// w [rad/s] is the velocity of the reference, and r = theta_M(0) + integral(w) [rad] its angle, as
/// in [`super::PiPosition`]. E multiplies the voltage that reaches the motor without the
/// feed-forward, which is v_k if the output is not limited. An observer with this input models the
/// deviation from the motion that the feed-forward drives. States that hold keep their value while
/// the output is limited.
#[derive(Clone, Debug)]
pub struct LinearServo<const N: usize> {
    /// Laws of the joints; `None`: the joint is not under control, and neither are joints without
    /// entry. Shared by the copies of a servo for fewer joints.
    pub laws: Arc<[Option<JointLaw>]>,
    /// Largest voltage [V].
    pub limit: f64,
    /// Time between two readings [s].
    pub period: f64,
}

/// Law of a joint.
#[derive(Clone, Debug)]
pub struct JointLaw {
    states: Vec<LawState>,
    /// D: voltage per (r, w, y).
    d: [f64; 3],
}

/// Row of a law for one of its states.
#[derive(Clone, Copy, Debug)]
pub struct LawState {
    /// Row of A, with zeros beyond the states.
    pub a: [f64; MAX_LAW_STATES],
    /// Row of B, for (r, w, y).
    pub b: [f64; 3],
    /// Entry of C.
    pub c: f64,
    /// Entry of E.
    pub e: f64,
    /// Whether the state keeps its value while the output is limited.
    pub holds: bool,
    /// Value at rest per encoder reading [rad] and per voltage [V].
    pub rest: [f64; 2],
}

/// State of the laws.
#[derive(Clone)]
pub struct LinearServoMemory<R, const N: usize> {
    /// States of each law.
    states: Vec<[R; MAX_LAW_STATES]>,
    /// theta_M(0) + integral(w) [rad].
    path: [R; N],
}

impl JointLaw {
    /// A law; `None` for more than [`MAX_LAW_STATES`] states.
    pub fn new(states: Vec<LawState>, d: [f64; 3]) -> Option<Self> {
        (states.len() <= MAX_LAW_STATES).then_some(Self { states, d })
    }

    /// Voltage for inputs (r, w, y) and a feed-forward voltage.
    #[inline(always)]
    fn command<R: Real>(
        &self,
        x: &mut [R; MAX_LAW_STATES],
        inputs: &[R; 3],
        feed_forward: R,
        limit: f64,
    ) -> R {
        let mut unlimited = add_product(&self.d, inputs, feed_forward);
        for (state, &one) in self.states.iter().zip(&*x) {
            unlimited = R::splat(state.c).mul_add(one, unlimited);
        }
        let is_limited = unlimited.lane(0).abs() > limit;
        let voltage = if is_limited {
            R::splat(limit).copysign(unlimited)
        } else {
            unlimited
        };
        let without_feed_forward = voltage - feed_forward;
        let before = *x;
        for (state, one) in self.states.iter().zip(x) {
            if !(is_limited && state.holds) {
                let driven = without_feed_forward * state.e;
                let driven = add_product(&state.b, inputs, driven);
                *one = add_product(&state.a[..self.states.len()], &before, driven);
            }
        }
        voltage
    }
}

/// `sum` plus the product of a row and a column.
#[inline(always)]
fn add_product<R: Real>(row: &[f64], column: &[R], mut sum: R) -> R {
    for (&entry, &one) in row.iter().zip(column) {
        sum = R::splat(entry).mul_add(one, sum);
    }
    sum
}

impl<const N: usize> LinearServo<N> {
    /// The controller of the first joints.
    pub(crate) fn of_first_joints<const M: usize>(&self) -> LinearServo<M> {
        LinearServo {
            laws: Arc::clone(&self.laws),
            limit: self.limit,
            period: self.period,
        }
    }
}

impl<const N: usize> Controller<N> for LinearServo<N> {
    type Memory<R: Real> = LinearServoMemory<R, N>;

    fn at_rest<R: Real>(&self, voltage: &[f64; N], encoder: &[R; N]) -> LinearServoMemory<R, N> {
        let mut states = vec![[R::splat(0.0); MAX_LAW_STATES]; self.laws.len().min(N)];
        for (i, law) in self.laws.iter().take(N).enumerate() {
            for (k, state) in law.iter().flat_map(|law| law.states.iter().enumerate()) {
                let [per_angle, per_volt] = state.rest;
                states[i][k] = encoder[i] * per_angle + per_volt * voltage[i];
            }
        }
        LinearServoMemory {
            states,
            path: *encoder,
        }
    }

    /// `reference` holds motor velocities [rad/s].
    // Not inlined: it runs once per period, and every program has its callers several times.
    #[inline(never)]
    fn command<R: Real>(
        &self,
        memory: &mut LinearServoMemory<R, N>,
        reference: &[f64; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N] {
        const { assert!(R::LANES == 1) };
        R::scope(Command(self, memory, reference, encoder, feed_forward))
    }

    fn drives(&self, joint: usize) -> bool {
        self.laws.get(joint).is_some_and(Option::is_some)
    }
}

impl<const N: usize> LinearServo<N> {
    #[inline(always)]
    fn compute_command<R: Real>(
        &self,
        memory: &mut LinearServoMemory<R, N>,
        reference: &[f64; N],
        encoder: &[R; N],
        feed_forward: &[f64; N],
    ) -> [R; N] {
        let LinearServoMemory { states, path } = memory;
        let mut voltage = feed_forward.map(R::splat);
        for (i, x) in states.iter_mut().enumerate() {
            if let Some(law) = &self.laws[i] {
                let inputs = [path[i], R::splat(reference[i]), encoder[i]];
                voltage[i] = law.command(x, &inputs, voltage[i], self.limit);
            }
            path[i] = path[i] + reference[i] * self.period;
        }
        voltage
    }
}

works! {
    ['a, R: Real, const N: usize] ['a, R, N]
    /// [`LinearServo::command`].
    Command(0: &'a LinearServo<N>, 1: &'a mut LinearServoMemory<R, N>, 2: &'a [f64; N],
        3: &'a [R; N], 4: &'a [f64; N]) -> [R; N] = LinearServo::compute_command;
}
