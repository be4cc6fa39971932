//! Channels of a log from recorded quantities, with derivatives by other variables.

use crate::compiled::Derivatives;

/// A channel: a quantity of a joint, times a factor.
#[derive(Clone, Copy, Debug)]
pub struct Channel {
    /// Index of the quantity in the record.
    pub quantity: usize,
    /// Index of the joint.
    pub joint: usize,
    /// Factor of the reading.
    pub factor: f64,
}

/// Derivatives of directions by other variables: a matrix, directions times columns, with few
/// entries.
#[derive(Clone, Debug)]
pub struct ChainRule {
    columns: usize,
    diagonals: Vec<Diagonal>,
}

/// Entries (direction + k, column + k) of a matrix.
#[derive(Clone, Debug)]
struct Diagonal {
    direction: usize,
    column: usize,
    entries: Vec<f64>,
}

impl ChainRule {
    /// From a matrix, directions times columns.
    pub fn new(matrix: &[f64], columns: usize) -> Self {
        let mut diagonals: Vec<Diagonal> = Vec::new();
        for (direction, row) in matrix.chunks_exact(columns.max(1)).enumerate() {
            for (column, &entry) in row.iter().enumerate().filter(|(_, entry)| **entry != 0.0) {
                let continued = diagonals.iter_mut().find(|one| {
                    let length = one.entries.len();
                    one.direction + length == direction && one.column + length == column
                });
                match continued {
                    Some(diagonal) => diagonal.entries.push(entry),
                    None => diagonals.push(Diagonal {
                        direction,
                        column,
                        entries: vec![entry],
                    }),
                }
            }
        }
        Self { columns, diagonals }
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// Adds derivatives by the directions, times a factor, to those by the columns.
    #[inline]
    fn add(&self, by_directions: &[f64], factor: f64, by_columns: &mut [f64]) {
        for diagonal in &self.diagonals {
            let length = diagonal.entries.len();
            let from = &by_directions[diagonal.direction..][..length];
            let to = &mut by_columns[diagonal.column..][..length];
            for ((to, from), entry) in to.iter_mut().zip(from).zip(&diagonal.entries) {
                *to += factor * entry * from;
            }
        }
    }
}

impl Derivatives {
    /// Readings of channels, rows times channels, and their derivatives, rows times channels times
    /// columns of the chain rule.
    ///
    /// # Panics
    /// A channel is of another quantity or joint, or the chain rule of other directions.
    pub fn of_channels(
        &self,
        joints: usize,
        channels: &[Channel],
        chain: &ChainRule,
    ) -> (Vec<f64>, Vec<f64>) {
        let rows = self.values.first().map_or(0, Vec::len) / joints.max(1);
        let (mut readings, width) = (Vec::with_capacity(rows * channels.len()), chain.columns);
        // grown cell by cell: zeros that are read before they are written cost two page faults
        let mut derivatives = Vec::with_capacity(rows * channels.len() * width);
        for row in 0..rows {
            for &Channel {
                quantity,
                joint,
                factor,
            } in channels
            {
                let cell = row * joints + joint;
                readings.push(factor * self.values[quantity][cell]);
                let tangents = &self.tangents[quantity];
                let directions = tangents.len() / (rows * joints);
                let by_directions = &tangents[cell * directions..][..directions];
                let begin = derivatives.len();
                derivatives.resize(begin + width, 0.0);
                chain.add(by_directions, factor, &mut derivatives[begin..]);
            }
        }
        (readings, derivatives)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Entries, most of them zero or one.
    fn entry() -> impl Strategy<Value = f64> {
        prop_oneof![5 => Just(0.0), 2 => Just(1.0), 1 => -2.0..2.0]
    }

    proptest! {
        #[test]
        fn derivatives_follow_the_chain_rule(
            (rows, joints, directions, columns) in (0..4_usize, 1..4_usize, 0..6_usize, 0..6_usize),
            entries in prop::collection::vec(entry(), 36),
            numbers in prop::collection::vec(-1.0..1.0, 2 * 3 * 3 * 7),
            channels in prop::collection::vec((0..2_usize, 0..3_usize, -2.0..2.0), 0..5),
        ) {
            let part = |from: usize, count: usize| numbers[from..][..count].to_vec();
            let cells = rows * joints;
            let derivatives = Derivatives {
                values: vec![part(0, cells), part(9, cells)],
                tangents: vec![part(0, cells * directions), part(63, cells * directions)],
            };
            let matrix = &entries[..directions * columns];
            let channels: Vec<Channel> = channels
                .into_iter()
                .map(|(quantity, joint, factor)| Channel {
                    quantity,
                    joint: joint % joints,
                    factor,
                })
                .collect();
            let chain = ChainRule::new(matrix, columns);
            let (readings, by_columns) = derivatives.of_channels(joints, &channels, &chain);
            prop_assert_eq!(readings.len(), rows * channels.len());
            prop_assert_eq!(by_columns.len(), readings.len() * columns);
            for (k, reading) in readings.iter().enumerate() {
                let channel = channels[k % channels.len()];
                let cell = k / channels.len() * joints + channel.joint;
                let value = derivatives.values[channel.quantity][cell];
                prop_assert_eq!(*reading, channel.factor * value);
                for c in 0..columns {
                    let expected: f64 = (0..directions)
                        .map(|d| {
                            let by = derivatives.tangents[channel.quantity][cell * directions + d];
                            channel.factor * matrix[d * columns + c] * by
                        })
                        .sum();
                    prop_assert!((by_columns[k * columns + c] - expected).abs() < 1e-13);
                }
            }
        }
    }
}
