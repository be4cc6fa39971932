//! Derivatives of recorded quantities, sample by sample.

use std::ops::Range;

use crate::scalar::{Aligned, Real};
use crate::sensors::decimation::{Decimation, Decimator};

/// The current sample of all blocks, and all earlier samples or their rows behind a low-pass.
pub(crate) struct SampleBuffer {
    joints: usize,
    /// Those of each variant, among the padded directions.
    directions: Vec<Range<usize>>,
    /// Number of directions, with those that fill blocks.
    padded_directions: usize,
    /// Directions for each quantity and joint.
    sample: Aligned,
    decimated: Option<Decimator>,
    /// For each quantity samples, or rows, times joints times directions.
    pub(crate) tangents: Vec<Vec<f64>>,
}

impl SampleBuffer {
    /// Buffer for given numbers of quantities, samples and joints.
    pub(crate) fn new(
        [quantities, samples, joints]: [usize; 3],
        (directions, padded_directions): (Vec<Range<usize>>, usize),
        decimation: Option<&Decimation>,
    ) -> Self {
        let width: usize = directions.iter().map(Range::len).sum();
        let rows = decimation.map_or(samples, |decimation| decimation.rows(samples));
        Self {
            joints,
            directions,
            padded_directions,
            sample: Aligned::zeros(quantities * joints * padded_directions),
            decimated: decimation
                .filter(|_| width > 0)
                .map(|decimation| Decimator::new(decimation, joints * padded_directions, samples)),
            tangents: (0..quantities)
                .map(|_| Vec::with_capacity(rows * joints * width))
                .collect(),
        }
    }

    /// The derivatives of one quantity and joint in the current sample.
    #[inline(always)]
    pub(crate) fn entry(&mut self, quantity: usize, joint: usize) -> &mut [f64] {
        &mut self.sample[(quantity * self.joints + joint) * self.padded_directions..]
            [..self.padded_directions]
    }

    /// Stores the current sample.
    pub(crate) fn store_sample<V: Real>(&mut self) {
        let whole = match &mut self.decimated {
            None => Some(&self.sample[..]),
            Some(decimated) => decimated.push::<V>(&self.sample),
        };
        let Some(numbers) = whole.filter(|_| self.padded_directions > 0) else {
            return;
        };
        let quantities = numbers.chunks_exact(self.joints * self.padded_directions);
        for (all, joints) in self.tangents.iter_mut().zip(quantities) {
            for joint in joints.chunks_exact(self.padded_directions) {
                for range in &self.directions {
                    all.extend_from_slice(&joint[range.clone()]);
                }
            }
        }
    }
}
