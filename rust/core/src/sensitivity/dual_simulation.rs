//! The chain of [`crate::experiment::simulate`] run over numbers with derivatives.

use crate::arm::Arm;
use crate::experiment::simulate::SideBySide;
use crate::experiment::{Diverged, Member, Record, Source, Task};
use crate::joint::gear::Gears;
use crate::scalar::{Dual, Real};
use crate::sensitivity::Sensitivities;

/// The whole chain over numbers with derivatives: `V::LANES` directions at a time, each with its own
/// simulation.
///
/// # Errors
/// The motion diverged.
pub(crate) fn by_duals<
    A: Arm<N>,
    S: Real,
    V: Real,
    G: Gears,
    const N: usize,
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
        let chain = SideBySide::<A, Dual<S, V>, _, G, N, EFFECTS>::new(task, members, given);
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
