//! Experiments with derivatives of all recorded quantities, consistent with each step of the
//! integrator: [`dual_simulation`] uses dual numbers, [`forward`] follows the simulation with
//! variational equations.
//!
//! Derivatives include those of the times of friction events. If an arbitrarily small change of a
//! parameter changes the sequence of events, the derivative does not exist, and that of the
//! simulated sequence is returned. The derivative of an encoder reading is that of the angle.

mod block_trajectory;
pub(crate) mod dual_simulation;
pub(crate) mod effect;
mod event;
mod forcing;
pub(crate) mod forward;
mod holding;
mod sample_buffer;
mod sensing;
mod step_length;
mod tangent;
mod tangent_block;
mod trace;
mod variational;

use crate::experiment::{Member, Record, RecordOf, Source, Task, values};
use crate::scalar::{Dual, Real};
use crate::sensors::decimation::Decimation;

/// A request for the derivatives of an experiment.
#[derive(Clone, Copy)]
pub struct Request<'a, A, const N: usize> {
    /// The experiment.
    pub task: &'a Task<A, N>,
    /// Parameters of the arm, and initial state.
    pub member: &'a Member<'a, N>,
    /// The parameters and initial states to differentiate with respect to.
    pub directions: &'a [Source],
    /// Further directions, of the same motion.
    pub variants: &'a [Variant<'a>],
    /// Low-pass and decimation of the samples; `None`: all samples.
    pub decimation: Option<&'a Decimation>,
}

/// Directions by sizes of effects that are zero, with other values of the parameters that have no
/// influence then, as frequencies.
#[derive(Clone, Copy, Debug)]
pub struct Variant<'a> {
    /// Parameters of the arm.
    pub parameters: &'a [f64],
    /// The sizes.
    pub directions: &'a [Source],
}

impl<'a, A, const N: usize> Request<'a, A, N> {
    /// The same request with another representation of the arm.
    pub fn with_task<'b, B>(&self, task: &'b Task<B, N>) -> Request<'b, B, N>
    where
        'a: 'b,
    {
        Request {
            task,
            member: self.member,
            directions: self.directions,
            variants: self.variants,
            decimation: self.decimation,
        }
    }
}

/// Recorded quantities and their derivatives.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivities<const N: usize> {
    /// Samples, or their rows behind a low-pass.
    pub values: Record<N>,
    /// For each quantity samples, or rows, times joints times directions; the last index varies
    /// fastest.
    pub tangents: Vec<Vec<f64>>,
}

/// Rows of a recording behind a low-pass, if there is one.
#[inline(always)]
pub(crate) fn decimated<V: Real, const N: usize>(
    record: Record<N>,
    decimation: Option<&Decimation>,
) -> Record<N> {
    let Some(decimation) = decimation else {
        return record;
    };
    let mut all = Vec::with_capacity(record.len());
    for (k, samples) in record.iter().enumerate() {
        let rows = decimation.of::<V>(k, samples.as_flattened(), N);
        all.push(rows.as_chunks::<N>().0.to_vec());
    }
    all
}

impl<const N: usize> Sensitivities<N> {
    /// Adds derivatives in other directions of the same motion, of `width` in all.
    pub fn append(&mut self, other: &Self, [width, more]: [usize; 2]) {
        for (own, others) in self.tangents.iter_mut().zip(&other.tangents) {
            let cells = own.len().max(others.len()) / width.max(more).max(1);
            let mut all = Vec::with_capacity(own.len() + others.len());
            for k in 0..cells {
                all.extend_from_slice(&own[k * width..][..width]);
                all.extend_from_slice(&others[k * more..][..more]);
            }
            *own = all;
        }
    }

    /// Rows behind a low-pass, if there is one; a sample has `width` derivatives.
    pub(crate) fn decimated(self, decimation: Option<&Decimation>, width: usize) -> Self {
        let Some(low_pass) = decimation else {
            return self;
        };
        let rows = |(k, samples): (usize, Vec<f64>)| low_pass.of::<f64>(k, &samples, width);
        Self {
            values: decimated::<f64, N>(self.values, decimation),
            tangents: self.tangents.into_iter().enumerate().map(rows).collect(),
        }
    }

    /// Stores the directions that begin at index `first`, of `width` in all, for each of the joints.
    fn store_directions<S: Real, V: Real>(
        &mut self,
        record: &RecordOf<Dual<S, V>, N>,
        joints: usize,
        [first, width]: [usize; 2],
    ) {
        let lanes = V::LANES.min(width - first);
        for (quantity, rows) in self.tangents.iter_mut().zip(record) {
            let cells = rows.iter().flat_map(|row| &row[..joints]);
            for (tangent, cell) in quantity.chunks_mut(width.max(1)).zip(cells) {
                for lane in 0..lanes {
                    tangent[first + lane] = cell.tangent.lane(lane);
                }
            }
        }
        self.values = values(record);
    }
}
