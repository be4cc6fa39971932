//! Experiments with the derivatives of all that is recorded, consistent with the integrator step by
//! step: the chain of [`crate::simulate`] itself, run over numbers with derivatives.
//!
//! The instants of friction's events move with the parameters, and their derivatives are in. Where
//! a change of a parameter, however small, changes the sequence of events, there is no derivative;
//! the one given then is that of the sequence seen. An encoder's is that of the angle it reads.

use crate::arm::Arm;
use crate::dual::Dual;
use crate::experiment::{Diverged, Member, Record, RecordOf, Source, Task, values};
use crate::real::Real;
use crate::simulate::SideBySide;
use crate::thinning::Thinning;

/// What was recorded, and how it depends on what was asked for.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivities<const N: usize> {
    /// As [`crate::dispatch::simulate`] gives it, or its rows behind a low-pass.
    pub values: Record<N>,
    /// For each quantity samples, or rows, times joints times directions, the last running fastest.
    pub tangents: Vec<Vec<f64>>,
}

/// The whole chain over numbers with derivatives: `V::LANES` directions at a time, each with its own
/// simulation.
///
/// # Errors
/// The motion diverged.
pub(crate) fn by_duals<
    A: Arm<N>,
    S: Real,
    V: Real,
    const N: usize,
    const ELASTIC: bool,
    const EFFECTS: bool,
>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
) -> Result<Sensitivities<N>, Diverged> {
    let mut all = Sensitivities {
        values: Record::new(),
        tangents: vec![vec![0.0; task.clock.samples * N * directions.len()]; task.record.len()],
    };
    let members = std::slice::from_ref(member);
    for first in (0..directions.len().max(1)).step_by(V::LANES) {
        let given = |source, value| seeded(source, value, &directions[first..]);
        let chain = SideBySide::<A, Dual<S, V>, _, N, ELASTIC, EFFECTS>::new(task, members, given);
        for record in Dual::<S, V>::scope(chain) {
            all.take(&record?, first, directions.len());
        }
    }
    Ok(all)
}

/// A number that moves with the directions that are its own.
pub(crate) fn seeded<S: Real, V: Real>(
    source: Source,
    value: f64,
    directions: &[Source],
) -> Dual<S, V> {
    let mut number = Dual::<S, V>::splat(value);
    for (lane, &direction) in directions.iter().take(V::LANES).enumerate() {
        if direction == source {
            number.tangent.set_lane(lane, 1.0);
        }
    }
    number
}

/// A record's rows behind a low-pass, if there is one.
#[inline(always)]
pub(crate) fn thinned<V: Real, const N: usize>(
    record: Record<N>,
    thinning: Option<&Thinning>,
) -> Record<N> {
    let Some(thinning) = thinning else {
        return record;
    };
    let mut all = Vec::with_capacity(record.len());
    for (k, samples) in record.iter().enumerate() {
        let rows = thinning.of::<V>(k, samples.as_flattened(), N);
        all.push(rows.as_chunks::<N>().0.to_vec());
    }
    all
}

impl<const N: usize> Sensitivities<N> {
    /// The rows behind a low-pass, if there is one.
    pub(crate) fn thinned(self, thinning: Option<&Thinning>, directions: usize) -> Self {
        let Some(low_pass) = thinning else {
            return self;
        };
        let rows =
            |(k, samples): (usize, Vec<f64>)| low_pass.of::<f64>(k, &samples, N * directions);
        Self {
            values: thinned::<f64, N>(self.values, thinning),
            tangents: self.tangents.into_iter().enumerate().map(rows).collect(),
        }
    }

    /// Puts in the directions from the `first`, of `width` in all.
    fn take<S: Real, V: Real>(
        &mut self,
        record: &RecordOf<Dual<S, V>, N>,
        first: usize,
        width: usize,
    ) {
        let lanes = V::LANES.min(width - first);
        for (quantity, rows) in self.tangents.iter_mut().zip(record) {
            let cells = rows.as_flattened();
            for (own, cell) in quantity.chunks_mut(width.max(1)).zip(cells) {
                for lane in 0..lanes {
                    own[first + lane] = cell.tangent.lane(lane);
                }
            }
        }
        self.values = values(record);
    }
}
