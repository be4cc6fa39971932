//! The processor decides, at run time, how many arms are integrated side by side.
//!
//! This is the only place that picks a scalar which needs more than the target's baseline, and it
//! asks the processor first.

use std::marker::PhantomData;

use rayon::prelude::*;

use crate::arm::Arm;
use crate::experiment::simulate::SideBySide;
use crate::experiment::{Diverged, Member, Record, Source, Task, values};
use crate::joint::gear::{AllLaws, Gears, Slopes};
#[cfg(target_arch = "x86_64")]
use crate::scalar::lanes::{F64x4, F64x8, Fused};
use crate::scalar::{Lanes, Real};
use crate::sensitivity::Sensitivities;
use crate::sensitivity::dual_simulation::by_duals;
use crate::sensitivity::effect::without_effects;
use crate::sensitivity::forward::ForwardSensitivity;
use crate::sensors::decimation::Decimation;

/// Registers' worth of arms that take turns.
const GROUPS: usize = 2;

/// What the processor offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// Nothing beyond the baseline of the target.
    Portable,
    /// AVX2 and fused multiply-add: four numbers a register.
    Avx2,
    /// AVX-512 as servers have had it since 2017 (F, VL, DQ, BW): eight numbers a register.
    Avx512,
}

impl Width {
    /// The widest that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            let avx512 = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw");
            if avx2 && avx512 {
                return Self::Avx512;
            }
            if avx2 {
                return Self::Avx2;
            }
        }
        Self::Portable
    }

    /// Arms integrated side by side in a batch: some registers' worth, so that their chains of
    /// operations hide each other's latency.
    pub fn lanes(self) -> usize {
        match self {
            Self::Portable => 2,
            Self::Avx2 => GROUPS * 4,
            Self::Avx512 => GROUPS * 8,
        }
    }
}

/// The result of each member of a batch.
pub type Results<const N: usize> = Vec<Result<Record<N>, Diverged>>;

/// Simulates every member, several side by side and groups of them in parallel.
///
/// # Panics
/// `width` is more than the processor has.
pub fn simulate<A: Arm<N>, const N: usize>(
    task: &Task<A, N>,
    members: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    if A::COMPACT || task.config.has_effects() {
        one_by_one(task, members, width)
    } else if task.config.has_gears::<Slopes>() {
        simulate_with::<A, Slopes, N>(task, members, width)
    } else {
        simulate_with::<A, AllLaws, N>(task, members, width)
    }
}

/// [`simulate`] of an arm without effects whose gears are of a given set of laws.
///
/// # Panics
/// `width` is more than the processor has, or a gear is of another law.
pub fn simulate_with<A: Arm<N>, G: Gears, const N: usize>(
    task: &Task<A, N>,
    members: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    assert!(width <= Width::detect(), "this processor has no {width:?}");
    if let [only] = members {
        return single::<A, G, N, false>(task, std::slice::from_ref(only), width);
    }
    let lanes = width.lanes();
    members
        .par_chunks(lanes)
        .flat_map_iter(|chunk| {
            // The last group is filled up with copies of its last member.
            let filled: Vec<Member<'_, N>> = (0..lanes)
                .map(|lane| chunk[lane.min(chunk.len() - 1)])
                .collect();
            group::<A, G, N>(task, &filled, width)
                .into_iter()
                .take(chunk.len())
        })
        .collect()
}

/// Arms with effects, whose equations are written for one lane, and those of which one program has to
/// do: it is that for all kinds of joints.
fn one_by_one<A: Arm<N>, const N: usize>(
    task: &Task<A, N>,
    members: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    assert!(width <= Width::detect(), "this processor has no {width:?}");
    members
        .par_iter()
        .flat_map_iter(|member| {
            single::<A, AllLaws, N, true>(task, std::slice::from_ref(member), width)
        })
        .collect()
}

fn single<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    task: &Task<A, N>,
    member: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    match width {
        Width::Portable => side_by_side::<A, f64, G, N, EFFECTS>(task, member),
        #[cfg(target_arch = "x86_64")]
        _ => side_by_side::<A, Fused, G, N, EFFECTS>(task, member),
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("only x86-64 detects vectors"),
    }
}

fn group<A: Arm<N>, G: Gears, const N: usize>(
    task: &Task<A, N>,
    members: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    match width {
        Width::Portable => side_by_side::<A, f64, G, N, false>(task, members),
        #[cfg(target_arch = "x86_64")]
        Width::Avx2 => side_by_side::<A, F64x4, G, N, false>(task, members),
        #[cfg(target_arch = "x86_64")]
        Width::Avx512 => side_by_side::<A, F64x8, G, N, false>(task, members),
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("only x86-64 detects vectors"),
    }
}

fn side_by_side<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>(
    task: &Task<A, N>,
    members: &[Member<'_, N>],
) -> Results<N> {
    let given = |_, value| R::One::splat(value);
    R::scope(SideBySide::<A, R, _, G, N, EFFECTS>::new(
        task, members, given,
    ))
    .into_iter()
    .map(|record| record.map(|record| values(&record)))
    .collect()
}

/// One arm in one experiment, with the derivatives of all that is recorded, or of its rows behind a
/// low-pass.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// `width` is more than the processor has, or the low-pass is for other quantities.
pub fn sensitivities<A: Arm<N>, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
    decimation: Option<&Decimation>,
    width: Width,
) -> Result<Sensitivities<N>, Diverged> {
    assert!(width <= Width::detect(), "this processor has no {width:?}");
    let quantities = decimation.map_or(task.record.len(), Decimation::quantities);
    assert_eq!(
        quantities,
        task.record.len(),
        "a low-pass for each quantity"
    );
    let slopes = task.config.has_gears::<Slopes>() && !A::COMPACT;
    if !task.config.is_elastic() || (width == Width::Portable && !slopes) {
        let found = by_duals_at(task, member, directions, width)?;
        return Ok(found.decimated(decimation, directions.len()));
    }
    let asked = (task, member);
    if !task.config.has_effects() {
        return match slopes {
            true => forward_at::<A, Slopes, N, false>(
                task, member, asked, directions, decimation, width,
            ),
            false => forward_any(task, member, asked, directions, decimation),
        };
    }
    if let Some((config, parameters)) = without_effects(&task.config, member.parameters)
        && !A::COMPACT
    {
        let plain = Task {
            config,
            record: task.record.clone(),
            ..*task
        };
        let member = Member {
            parameters: &parameters,
            ..*member
        };
        return match slopes {
            true => forward_at::<A, Slopes, N, true>(
                &plain, &member, asked, directions, decimation, width,
            ),
            false => forward_any(&plain, &member, asked, directions, decimation),
        };
    }
    let found = by_duals_at(task, member, directions, width)?;
    Ok(found.decimated(decimation, directions.len()))
}

/// [`sensitivities`] of an arm without effects whose gears are elastic and of a given set of laws.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// `width` is more than the processor has, or a gear is of another law.
pub fn sensitivities_with<A: Arm<N>, G: Gears, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
    width: Width,
) -> Result<Sensitivities<N>, Diverged> {
    assert!(width <= Width::detect(), "this processor has no {width:?}");
    let asked = (task, member);
    forward_at::<A, G, N, false>(task, member, asked, directions, None, width)
}

/// What [`sensitivities`] gives of all samples, by the chain over numbers with derivatives alone:
/// slower, for rigid gears and effects too, and what the faster way is checked against.
///
/// # Errors
/// The motion diverged.
pub fn by_duals_at<A: Arm<N>, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
    width: Width,
) -> Result<Sensitivities<N>, Diverged> {
    assert!(width <= Width::detect(), "this processor has no {width:?}");
    if A::COMPACT || task.config.has_effects() {
        duals::<A, AllLaws, N, true>(task, member, directions, width)
    } else {
        duals::<A, AllLaws, N, false>(task, member, directions, width)
    }
}

/// [`by_duals_at`] of an arm without effects whose gears are of a given set of laws.
///
/// # Errors
/// The motion diverged.
pub fn by_duals_with<A: Arm<N>, G: Gears, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
    width: Width,
) -> Result<Sensitivities<N>, Diverged> {
    assert!(width <= Width::detect(), "this processor has no {width:?}");
    duals::<A, G, N, false>(task, member, directions, width)
}

fn duals<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    directions: &[Source],
    width: Width,
) -> Result<Sensitivities<N>, Diverged> {
    match width {
        Width::Portable => by_duals::<A, f64, f64, G, N, EFFECTS>(task, member, directions),
        #[cfg(target_arch = "x86_64")]
        _ => by_duals::<A, Fused, F64x4, G, N, EFFECTS>(task, member, directions),
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("only x86-64 detects vectors"),
    }
}

fn forward_at<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    asked: (&Task<A, N>, &Member<'_, N>),
    directions: &[Source],
    decimation: Option<&Decimation>,
    width: Width,
) -> Result<Sensitivities<N>, Diverged> {
    let run = match width {
        Width::Portable => forward::<A, f64, f64, f64, G, N, EFFECTS>,
        #[cfg(target_arch = "x86_64")]
        Width::Avx2 => forward::<A, Fused, F64x4, F64x4, G, N, EFFECTS>,
        #[cfg(target_arch = "x86_64")]
        Width::Avx512 => forward::<A, Fused, F64x8, F64x4, G, N, EFFECTS>,
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("only x86-64 detects vectors"),
    };
    run(task, member, asked, directions, decimation)
}

/// Of gears of any law, and of arms of which few programs have to do: one program for all of these,
/// where there are vectors.
fn forward_any<A: Arm<N>, const N: usize>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    asked: (&Task<A, N>, &Member<'_, N>),
    directions: &[Source],
    decimation: Option<&Decimation>,
) -> Result<Sensitivities<N>, Diverged> {
    #[cfg(target_arch = "x86_64")]
    return forward::<A, Fused, F64x4, F64x4, AllLaws, N, true>(
        task, member, asked, directions, decimation,
    );
    #[cfg(not(target_arch = "x86_64"))]
    {
        let _ = (task, member, asked, directions, decimation);
        unreachable!("only x86-64 detects vectors")
    }
}

fn forward<
    A: Arm<N>,
    S: Lanes<One = S>,
    V: Lanes,
    L: Lanes,
    G: Gears,
    const N: usize,
    const EFFECTS: bool,
>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
    asked: (&Task<A, N>, &Member<'_, N>),
    directions: &[Source],
    decimation: Option<&Decimation>,
) -> Result<Sensitivities<N>, Diverged> {
    V::scope(ForwardSensitivity::<A, S, V, L, G, N, EFFECTS> {
        task,
        member,
        asked,
        directions,
        decimation,
        scalars: PhantomData,
    })
}
