//! Decimation of recorded samples through a low-pass.
//!
//! A comparison with a measurement needs far fewer numbers than the derivatives of all samples, so
//! the derivatives remain in the caches of the processor.

use std::ops::Range;

use crate::scalar::{Aligned, Real, Work};

/// A low-pass for each quantity: row r is the sum of taps[t] x[r step + t].
#[derive(Clone, Debug)]
pub struct Decimation {
    taps: Vec<Vec<f64>>,
    step: usize,
}

impl Decimation {
    /// From taps for each quantity and the number of samples from row to row; `None` unless all
    /// lists have the same length, a multiple of that number.
    pub fn new(taps: Vec<Vec<f64>>, step: usize) -> Option<Self> {
        let length = taps.first()?.len();
        let whole = step > 0 && length > 0 && length.is_multiple_of(step);
        let alike = taps.iter().all(|list| list.len() == length);
        (whole && alike).then_some(Self { taps, step })
    }

    /// Number of quantities.
    pub fn quantities(&self) -> usize {
        self.taps.len()
    }

    /// Number of rows for a number of samples: those for which the low-pass has all samples.
    pub fn rows(&self, samples: usize) -> usize {
        let length = self.taps[0].len();
        if samples < length {
            return 0;
        }
        (samples - length) / self.step + 1
    }

    /// Rows of a quantity's samples of `width` numbers each.
    #[inline(always)]
    pub(crate) fn of<V: Real>(&self, quantity: usize, samples: &[f64], width: usize) -> Vec<f64> {
        let taps = &self.taps[quantity];
        let rows = self.rows(samples.len() / width.max(1));
        let mut all = vec![0.0; rows * width];
        let mut column = Vec::with_capacity(samples.len() / width.max(1));
        for column_index in 0..width {
            column.clear();
            column.extend(samples[column_index..].iter().step_by(width));
            for row in 0..rows {
                all[row * width + column_index] = product::<V>(taps, &column[row * self.step..]);
            }
        }
        all
    }
}

/// Sum of taps times numbers.
#[inline(always)]
fn product<V: Real>(taps: &[f64], numbers: &[f64]) -> f64 {
    let (taps, rest) = taps.split_at(taps.len() / V::LANES * V::LANES);
    let (numbers, behind) = numbers.split_at(taps.len());
    let mut sums = V::splat(0.0);
    for (taps, numbers) in taps
        .chunks_exact(V::LANES)
        .zip(numbers.chunks_exact(V::LANES))
    {
        sums = V::load(taps).mul_add(V::load(numbers), sums);
    }
    let mut sum: f64 = (0..V::LANES).map(|lane| sums.lane(lane)).sum();
    for (tap, number) in rest.iter().zip(behind) {
        sum += tap * number;
    }
    sum
}

/// Samples passing through a [`Decimation`]: every `step` samples are added to all rows that
/// include them.
pub(crate) struct Decimator {
    decimation: Decimation,
    /// Numbers of one quantity in a sample or row.
    width: usize,
    /// Number of rows.
    rows: usize,
    /// Samples since the last whole block, by quantity and sample.
    block: Aligned,
    filled: usize,
    /// Number of whole blocks.
    blocks: usize,
    /// Incomplete rows, each at its number modulo their count, by quantity.
    partial_rows: Aligned,
}

impl Decimator {
    pub(crate) fn new(decimation: &Decimation, width: usize, samples: usize) -> Self {
        let numbers = decimation.taps.len() * width;
        Self {
            width,
            rows: decimation.rows(samples),
            block: Aligned::zeros(numbers * decimation.step),
            filled: 0,
            blocks: 0,
            partial_rows: Aligned::zeros(numbers * (decimation.taps[0].len() / decimation.step)),
            decimation: decimation.clone(),
        }
    }

    /// Adds a sample, by quantity, and returns the row that it completes, if any.
    pub(crate) fn push<V: Real>(&mut self, sample: &[f64]) -> Option<&[f64]> {
        let (step, width) = (self.decimation.step, self.width);
        for (k, values) in sample.chunks_exact(width).enumerate() {
            self.block[(k * step + self.filled) * width..][..width].copy_from_slice(values);
        }
        self.filled += 1;
        if self.filled < step {
            return None;
        }
        V::scope(AddWork::<V>(self, std::marker::PhantomData));
        self.filled = 0;
        self.blocks += 1;
        let row = self.blocks.checked_sub(self.parts())?;
        (row < self.rows).then(|| &self.partial_rows[self.range(row)])
    }

    /// Number of blocks of a row.
    fn parts(&self) -> usize {
        self.decimation.taps[0].len() / self.decimation.step
    }

    /// Location of an incomplete row.
    fn range(&self, row: usize) -> Range<usize> {
        let numbers = self.decimation.taps.len() * self.width;
        let first = row % self.parts() * numbers;
        first..first + numbers
    }

    /// Adds the block to all rows that include it, two at a time, so that loaded samples serve
    /// both.
    #[inline(always)]
    fn add<V: Real>(&mut self) {
        let newest = self.range(self.blocks);
        self.partial_rows[newest].fill(0.0);
        let first = (self.blocks + 1).saturating_sub(self.parts());
        let mut rows = first..=self.blocks;
        while let Some(row) = rows.next() {
            match rows.next() {
                Some(next) => self.add_to::<V, 2>([row, next]),
                None => self.add_to::<V, 1>([row]),
            }
        }
    }

    /// Adds the block to `R` rows.
    #[inline(always)]
    fn add_to<V: Real, const R: usize>(&mut self, rows: [usize; R]) {
        let (step, width) = (self.decimation.step, self.width);
        let taps_from = rows.map(|row| (self.blocks - row) * step);
        let ranges = rows.map(|row| self.range(row));
        let Ok(mut sums) = self.partial_rows.get_disjoint_mut(ranges) else {
            unreachable!("ranges of rows are disjoint");
        };
        let blocks = self.block.chunks_exact(step * width);
        for (k, (block, taps)) in blocks.zip(&self.decimation.taps).enumerate() {
            let mut targets = sums.each_mut().map(|sums| &mut sums[k * width..][..width]);
            let taps = taps_from.map(|from| &taps[from..][..step]);
            let mut first = 0;
            add_products::<V, 4, R>(&mut targets, block, &taps, &mut first);
            add_products::<V, 2, R>(&mut targets, block, &taps, &mut first);
            add_products::<V, 1, R>(&mut targets, block, &taps, &mut first);
        }
    }
}

/// Adds taps times samples to the sums of each row from the `first` number on, `C` registers at a
/// time, so that multiply-adds overlap.
#[inline(always)]
fn add_products<V: Real, const C: usize, const R: usize>(
    rows: &mut [&mut [f64]; R],
    block: &[f64],
    taps: &[&[f64]; R],
    first: &mut usize,
) {
    let width = rows[0].len();
    while *first + C * V::LANES <= width {
        let mut sums = [[V::splat(0.0); C]; R];
        for r in 0..R {
            for c in 0..C {
                sums[r][c] = V::load(&rows[r][*first + c * V::LANES..]);
            }
        }
        for (t, sample) in block.chunks_exact(width).enumerate() {
            let sample = &sample[*first..][..C * V::LANES];
            for c in 0..C {
                let number = V::load(&sample[c * V::LANES..]);
                for r in 0..R {
                    sums[r][c] = V::splat(taps[r][t]).mul_add(number, sums[r][c]);
                }
            }
        }
        for r in 0..R {
            for c in 0..C {
                sums[r][c].store(&mut rows[r][*first + c * V::LANES..]);
            }
        }
        *first += C * V::LANES;
    }
}

/// [`Decimator::add`].
struct AddWork<'t, V>(&'t mut Decimator, std::marker::PhantomData<V>);

impl<V: Real> Work for AddWork<'_, V> {
    type Output = ();
    #[inline(always)]
    fn run(self) {
        self.0.add::<V>();
    }
}

#[cfg(test)]
mod tests;
