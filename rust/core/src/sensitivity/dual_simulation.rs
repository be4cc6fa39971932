//! The simulation of [`crate::experiment::simulate`] over dual numbers.

use crate::arm::Arm;
use crate::experiment::simulate::Simulate;
use crate::experiment::{Diverged, Record, Source};
use crate::joint::gear::Gears;
use crate::scalar::{Dual, Real};
use crate::sensitivity::{Request, Sensitivities};

/// Simulates over dual numbers: `V::LANES` directions at a time, with one simulation each.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The request has variants.
pub(crate) fn differentiate_over_dual_numbers<
    A: Arm<N>,
    S: Real,
    V: Real,
    G: Gears,
    const N: usize,
    const EFFECTS: bool,
>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    let Request {
        task,
        member,
        directions,
        variants,
        decimation,
    } = *request;
    assert!(variants.is_empty());
    let joints = task.config.arm.joints();
    let width = joints * directions.len();
    let mut all = Sensitivities {
        values: Record::new(),
        tangents: vec![vec![0.0; task.clock.samples * width]; task.record.len()],
    };
    for first in (0..directions.len().max(1)).step_by(V::LANES) {
        let lift = |source, value| seed_dual(source, value, &directions[first..]);
        let chain = Simulate::<A, Dual<S, V>, _, G, N, EFFECTS>::new(task, member, lift);
        let record = Dual::<S, V>::scope(chain)?;
        all.store_directions(&record, joints, [first, directions.len()]);
    }
    Ok(all.decimated(decimation, width))
}

/// A value with derivative one in the directions of its source, and zero in the others.
pub(crate) fn seed_dual<S: Real, V: Real>(
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
