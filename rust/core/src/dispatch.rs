//! The processor decides, at run time, how many arms are integrated side by side.
//!
//! This is the only place that picks a scalar which needs more than the target's baseline, and it
//! asks the processor first.

use rayon::prelude::*;

use crate::arm::Arm;
#[cfg(target_arch = "x86_64")]
use crate::lanes::{F64x4, F64x8};
#[cfg(target_arch = "x86_64")]
use crate::real::Fused;
use crate::real::Real;
use crate::simulate::{Diverged, Member, Record, SideBySide, Task};

/// Registers' worth of arms that take turns.
const GROUPS: usize = 2;

/// What the processor offers.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// Nothing beyond the baseline of the target.
    Portable,
    /// AVX2 and fused multiply-add: four numbers a register.
    Avx2,
    /// AVX-512: eight numbers a register.
    Avx512,
}

impl Width {
    /// The widest that this processor has.
    pub fn detect() -> Self {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            if avx2 && is_x86_feature_detected!("avx512f") {
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
    assert!(width <= Width::detect(), "this processor has no {width:?}");
    if task.config.is_elastic() {
        simulate_arms::<A, N, true>(task, members, width)
    } else {
        simulate_arms::<A, N, false>(task, members, width)
    }
}

fn simulate_arms<A: Arm<N>, const N: usize, const ELASTIC: bool>(
    task: &Task<A, N>,
    members: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    if let [only] = members {
        return single::<A, N, ELASTIC>(task, std::slice::from_ref(only), width);
    }
    let lanes = width.lanes();
    members
        .par_chunks(lanes)
        .flat_map_iter(|chunk| {
            // The last group is filled up with copies of its last member.
            let filled: Vec<Member<'_, N>> = (0..lanes)
                .map(|lane| chunk[lane.min(chunk.len() - 1)])
                .collect();
            group::<A, N, ELASTIC>(task, &filled, width)
                .into_iter()
                .take(chunk.len())
        })
        .collect()
}

fn single<A: Arm<N>, const N: usize, const ELASTIC: bool>(
    task: &Task<A, N>,
    member: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    match width {
        Width::Portable => f64::scope(SideBySide::<A, f64, f64, N, ELASTIC>::new(task, member)),
        #[cfg(target_arch = "x86_64")]
        _ => Fused::scope(SideBySide::<A, Fused, Fused, N, ELASTIC>::new(task, member)),
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("only x86-64 detects vectors"),
    }
}

fn group<A: Arm<N>, const N: usize, const ELASTIC: bool>(
    task: &Task<A, N>,
    members: &[Member<'_, N>],
    width: Width,
) -> Results<N> {
    match width {
        Width::Portable => f64::scope(SideBySide::<A, f64, f64, N, ELASTIC>::new(task, members)),
        #[cfg(target_arch = "x86_64")]
        Width::Avx2 => F64x4::scope(SideBySide::<A, F64x4, Fused, N, ELASTIC>::new(
            task, members,
        )),
        #[cfg(target_arch = "x86_64")]
        Width::Avx512 => F64x8::scope(SideBySide::<A, F64x8, Fused, N, ELASTIC>::new(
            task, members,
        )),
        #[cfg(not(target_arch = "x86_64"))]
        _ => unreachable!("only x86-64 detects vectors"),
    }
}
