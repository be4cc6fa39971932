//! Lists of numbers that begin at a cache line.

use std::ops::{Deref, DerefMut};

/// Size of a cache line, and of the widest register [bytes].
const LINE: usize = 64;

/// A list of numbers that begins at a cache line, because loading a register from two lines takes
/// twice as long.
pub(crate) struct Aligned {
    numbers: Vec<f64>,
    first: usize,
}

impl Aligned {
    /// A list of zeros.
    pub(crate) fn zeros(count: usize) -> Self {
        let mut numbers = vec![0.0; count + LINE / size_of::<f64>()];
        let first = numbers.as_ptr().align_offset(LINE);
        numbers.truncate(first + count);
        Self { numbers, first }
    }
}

impl Deref for Aligned {
    type Target = [f64];
    #[inline(always)]
    fn deref(&self) -> &[f64] {
        &self.numbers[self.first..]
    }
}

impl DerefMut for Aligned {
    #[inline(always)]
    fn deref_mut(&mut self) -> &mut [f64] {
        &mut self.numbers[self.first..]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn list_is_aligned_and_has_requested_length() {
        for count in [0, 1, 7, 8, 1000] {
            let mut numbers = Aligned::zeros(count);
            assert_eq!(numbers.as_ptr() as usize % LINE, 0);
            assert_eq!(numbers.len(), count);
            numbers.fill(1.0);
            assert_eq!(numbers.iter().sum::<f64>(), count as f64);
        }
    }
}
