//! Functions that are compiled for each arm.
//!
//! A program is one instance of a generic function of this module. Each program takes seconds to
//! compile, so an arm has few of them. [`Programs`] lists fast programs, which are justified by a
//! benchmark, and general programs for every gear law and every effect. On x86-64 the processor's
//! features decide at run time which of them are used; every aarch64 processor uses the same. This
//! is the only module that names scalars beyond the baseline of the target; each program checks the
//! processor's features first.

use std::marker::PhantomData;

use crate::arm::Arm;
use crate::experiment::simulate::Simulate;
use crate::experiment::together::{SimulateTogether, can_share};
use crate::experiment::{Diverged, Member, Record, Task, values};
use crate::joint::gear::{AllLaws, Gears, Slopes};
#[cfg(target_arch = "x86_64")]
use crate::scalar::lanes::F64x8;
#[cfg(any(target_arch = "aarch64", target_arch = "x86_64"))]
use crate::scalar::lanes::{F64x2 as Baseline, Fused as One, Pack as Several};
use crate::scalar::{Lanes, Real};
use crate::sensitivity::dual_simulation::differentiate_over_dual_numbers;
use crate::sensitivity::effect::without_plant_effects;
use crate::sensitivity::forward::ForwardSensitivity;
use crate::sensitivity::{Request, Sensitivities, Variant};

/// On other targets one scalar serves for everything.
#[cfg(not(any(target_arch = "aarch64", target_arch = "x86_64")))]
mod scalars {
    pub(super) type One = f64;
    pub(super) type Several = f64;
    pub(super) type Baseline = f64;
}
#[cfg(not(any(target_arch = "aarch64", target_arch = "x86_64")))]
use scalars::{Baseline, One, Several};

/// The registers of a processor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Width {
    /// The baseline of the target.
    Portable,
    /// NEON, of every aarch64 processor: two numbers in a register, and fused multiply-add.
    Neon,
    /// AVX2 and fused multiply-add: four numbers in a register.
    Avx2,
    /// AVX-512 (F, VL, DQ, BW): eight numbers in a register.
    Avx512,
}

impl Width {
    /// The registers of this processor, from the narrowest.
    pub fn available() -> &'static [Self] {
        #[cfg(target_arch = "x86_64")]
        {
            let avx2 = is_x86_feature_detected!("avx2") && is_x86_feature_detected!("fma");
            let avx512 = is_x86_feature_detected!("avx512f")
                && is_x86_feature_detected!("avx512vl")
                && is_x86_feature_detected!("avx512dq")
                && is_x86_feature_detected!("avx512bw");
            if avx2 && avx512 {
                return &[Self::Portable, Self::Avx2, Self::Avx512];
            }
            if avx2 {
                return &[Self::Portable, Self::Avx2];
            }
        }
        if cfg!(target_arch = "aarch64") {
            return &[Self::Portable, Self::Neon];
        }
        &[Self::Portable]
    }

    /// The widest registers of this processor.
    pub fn detect() -> Self {
        Self::available()[Self::available().len() - 1]
    }

    /// The narrowest registers for which all programs but [`baseline`] are compiled.
    pub const COMPILED: Self = if cfg!(target_arch = "x86_64") {
        Self::Avx2
    } else if cfg!(target_arch = "aarch64") {
        Self::Neon
    } else {
        Self::Portable
    };

    /// Numbers in a register.
    pub fn lanes(self) -> usize {
        match self {
            Self::Portable => 1,
            Self::Neon => 2,
            Self::Avx2 => 4,
            Self::Avx512 => 8,
        }
    }

    /// # Panics
    /// The processor has no registers of this width.
    pub(crate) fn require(self) {
        assert!(
            Self::available().contains(&self),
            "this processor does not support {self:?}"
        );
    }
}

/// Simulates one experiment.
pub type Simulation<A, const N: usize> =
    fn(&Task<A, N>, &Member<'_, N>) -> Result<Record<N>, Diverged>;
/// An experiment, and the parameters and inputs of the arm in it.
pub type Case<'a, A, const N: usize> = (Task<A, N>, Member<'a, N>);
/// Simulates several experiments at once, at most [`Width::lanes`].
pub type SimulationTogether<A, const N: usize> =
    fn(&[Case<'_, A, N>]) -> Vec<Result<Record<N>, Diverged>>;
/// Simulates one experiment with derivatives.
pub type Differentiation<A, const N: usize> =
    fn(&Request<'_, A, N>) -> Result<Sensitivities<N>, Diverged>;

/// The compiled programs of an arm.
#[derive(Clone, Copy)]
pub struct Programs<A: 'static, const N: usize> {
    /// Programs for linear and three-slope gears.
    pub fast: FastPrograms<A, N>,
    /// Programs for all gears and effects.
    pub general: GeneralPrograms<A, N>,
    /// Derivatives over dual numbers for the baseline of the target: the only program for x86-64
    /// processors without AVX2.
    pub baseline: Differentiation<A, N>,
}

/// Programs for linear and three-slope gears.
#[derive(Clone, Copy)]
pub struct FastPrograms<A: 'static, const N: usize> {
    /// Simulation without effects.
    pub simulation: Simulation<A, N>,
    /// Simulations of experiments that [`can_share`] one, without effects; `None`: one at a time.
    pub together: Option<SimulationTogether<A, N>>,
    /// As `together`, on AVX-512.
    pub together_avx512: Option<SimulationTogether<A, N>>,
    /// Derivatives, with effects of the drive, and other effects of size zero.
    pub forward: Differentiation<A, N>,
    /// As `forward`, on AVX-512.
    pub forward_avx512: Differentiation<A, N>,
}

/// Programs for every gear law and effect.
#[derive(Clone, Copy)]
pub struct GeneralPrograms<A: 'static, const N: usize> {
    /// Simulation.
    pub simulation: Simulation<A, N>,
    /// As in [`FastPrograms`], for all elastic gears.
    pub forward: Differentiation<A, N>,
    /// Derivatives by dual numbers.
    pub dual_numbers: Differentiation<A, N>,
    /// As `dual_numbers`, on AVX-512.
    pub dual_numbers_avx512: Differentiation<A, N>,
}

impl<A: Arm<N>, const N: usize> GeneralPrograms<A, N> {
    /// Compiles the general programs of an arm in the calling crate.
    pub const fn compile() -> Self {
        Self {
            simulation: simulate::<A, AllLaws, N, true>,
            forward: forward::<A, AllLaws, N, true>,
            dual_numbers: dual_numbers::<A, AllLaws, N, true>,
            dual_numbers_avx512: dual_numbers::<A, AllLaws, N, true>,
        }
    }

    /// The general programs as fast ones.
    pub fn as_fast(&self) -> FastPrograms<A, N> {
        FastPrograms {
            simulation: self.simulation,
            together: None,
            together_avx512: None,
            forward: self.forward,
            forward_avx512: self.forward,
        }
    }
}

/// Simulates an arm whose gears are in the set `G`, with effects only if `EFFECTS`.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The processor lacks [`Width::COMPILED`], or a gear is not in the set.
pub fn simulate<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    task: &Task<A, N>,
    member: &Member<'_, N>,
) -> Result<Record<N>, Diverged> {
    Width::COMPILED.require();
    let lift = |_, value| One::splat(value);
    let record = One::scope(Simulate::<A, One, _, G, N, EFFECTS>::new(
        task, member, lift,
    ))?;
    Ok(values(&record))
}

/// Simulates several experiments without effects at once, each in a lane of the registers.
///
/// # Panics
/// The processor lacks [`Width::COMPILED`], a gear is not in the set, or the experiments cannot share
/// a simulation.
pub fn simulate_together<A: Arm<N>, G: Gears, const N: usize>(
    cases: &[Case<'_, A, N>],
) -> Vec<Result<Record<N>, Diverged>> {
    Width::COMPILED.require();
    Several::scope(SimulateTogether::<A, One, Several, G, N>::new(cases))
}

/// [`simulate_together`] with eight lanes per AVX-512 register.
///
/// # Panics
/// The processor lacks AVX-512, a gear is not in the set, or the experiments cannot share a
/// simulation.
#[cfg(target_arch = "x86_64")]
pub fn simulate_together_avx512<A: Arm<N>, G: Gears, const N: usize>(
    cases: &[Case<'_, A, N>],
) -> Vec<Result<Record<N>, Diverged>> {
    Width::Avx512.require();
    F64x8::scope(SimulateTogether::<A, One, F64x8, G, N>::new(cases))
}

/// [`simulate_together`], because this target has no wider registers.
#[cfg(not(target_arch = "x86_64"))]
pub fn simulate_together_avx512<A: Arm<N>, G: Gears, const N: usize>(
    cases: &[Case<'_, A, N>],
) -> Vec<Result<Record<N>, Diverged>> {
    simulate_together::<A, G, N>(cases)
}

/// Simulates an arm with elastic gears, with derivatives by the variational equations.
///
/// With `EFFECTS`, directions may be parameters of the drive's effects and sizes of other effects;
/// the latter must be zero.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The processor lacks [`Width::COMPILED`], a gear is not in the set, or an effect on motor, gear
/// or link has a nonzero size.
pub fn forward<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    Width::COMPILED.require();
    forward_on::<A, One, Several, Several, G, N, EFFECTS>(request)
}

/// [`forward`] with eight directions per AVX-512 register.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The processor lacks AVX-512, a gear is not in the set, or an effect on motor, gear or link has a
/// nonzero size.
#[cfg(target_arch = "x86_64")]
pub fn forward_avx512<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    Width::Avx512.require();
    forward_on::<A, One, F64x8, Several, G, N, EFFECTS>(request)
}

/// [`forward`], because this target has no wider registers.
///
/// # Errors
/// The motion diverged.
#[cfg(not(target_arch = "x86_64"))]
pub fn forward_avx512<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    forward::<A, G, N, EFFECTS>(request)
}

/// Simulates an arm with derivatives over dual numbers: slower than [`forward`], but also for rigid
/// gears and effects of any size.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The processor lacks [`Width::COMPILED`], or a gear is not in the set.
pub fn dual_numbers<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    Width::COMPILED.require();
    differentiate_over_dual_numbers::<A, One, Several, G, N, EFFECTS>(request)
}

/// [`dual_numbers`] with eight directions per simulation.
///
/// # Errors
/// The motion diverged.
///
/// # Panics
/// The processor lacks AVX-512, or a gear is not in the set.
#[cfg(target_arch = "x86_64")]
pub fn dual_numbers_avx512<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    Width::Avx512.require();
    differentiate_over_dual_numbers::<A, One, F64x8, G, N, EFFECTS>(request)
}

/// [`dual_numbers`], because this target has no wider registers.
///
/// # Errors
/// The motion diverged.
#[cfg(not(target_arch = "x86_64"))]
pub fn dual_numbers_avx512<A: Arm<N>, G: Gears, const N: usize, const EFFECTS: bool>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    dual_numbers::<A, G, N, EFFECTS>(request)
}

/// [`dual_numbers`] for every gear law and effect on the baseline of the target.
///
/// # Errors
/// The motion diverged.
pub fn baseline<A: Arm<N>, const N: usize>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    differentiate_over_dual_numbers::<A, f64, Baseline, AllLaws, N, true>(request)
}

fn forward_on<
    A: Arm<N>,
    S: Lanes,
    V: Lanes,
    L: Lanes,
    G: Gears,
    const N: usize,
    const EFFECTS: bool,
>(
    request: &Request<'_, A, N>,
) -> Result<Sensitivities<N>, Diverged> {
    let Request { task, member, .. } = *request;
    let own = Variant {
        parameters: member.parameters,
        directions: request.directions,
    };
    let variants: Vec<_> = [own].iter().chain(request.variants).copied().collect();
    let members: Vec<_> = variants
        .iter()
        .map(|one| Member {
            parameters: one.parameters,
            ..*member
        })
        .collect();
    let run = |plain: &Task<A, N>, member: &Member<'_, N>| {
        V::scope(ForwardSensitivity::<A, S, V, L, G, N, EFFECTS> {
            task: plain,
            member,
            requested: task,
            variants: &variants,
            members: &members,
            decimation: request.decimation,
            scalars: PhantomData,
        })
    };
    if !EFFECTS || !task.config.has_effects() {
        return run(task, member);
    }
    let (config, parameters) =
        without_plant_effects(&task.config, member.parameters).expect("effects of size zero");
    let plain = Task {
        config,
        servo: task.servo.clone(),
        record: task.record.clone(),
        link_sensors: task.link_sensors.clone(),
        ..*task
    };
    let without = Member {
        parameters: &parameters,
        ..*member
    };
    run(&plain, &without)
}

impl<A: Arm<N>, const N: usize> Programs<A, N> {
    /// Simulates one experiment with the fastest suitable program for a register width.
    ///
    /// # Errors
    /// The motion diverged.
    ///
    /// # Panics
    /// The processor has no registers of that width.
    pub fn simulate(
        &self,
        task: &Task<A, N>,
        member: &Member<'_, N>,
        width: Width,
    ) -> Result<Record<N>, Diverged> {
        width.require();
        if width < Width::COMPILED {
            let request = Request {
                task,
                member,
                directions: &[],
                variants: &[],
                decimation: None,
            };
            return Ok((self.baseline)(&request)?.values);
        }
        if task.config.has_gears::<Slopes>() && !task.config.has_plant_effects() {
            (self.fast.simulation)(task, member)
        } else {
            (self.general.simulation)(task, member)
        }
    }

    /// Simulates experiments on one arm, several at once where they can share a simulation.
    ///
    /// # Panics
    /// The processor has no registers of that width.
    pub fn simulate_all(
        &self,
        cases: &[Case<'_, A, N>],
        width: Width,
    ) -> Vec<Result<Record<N>, Diverged>> {
        width.require();
        let mut results = Vec::with_capacity(cases.len());
        while results.len() < cases.len() {
            let rest = &cases[results.len()..];
            let (first, member) = &rest[0];
            let shares = |case: &&Case<'_, A, N>| can_share(first, &case.0);
            let count = rest.iter().take(width.lanes()).take_while(shares).count();
            let has_program = first.config.has_gears::<Slopes>() && !first.config.has_effects();
            // the narrowest registers with enough lanes
            let together = match width {
                _ if !has_program || count == 1 || width < Width::COMPILED => None,
                Width::Avx512 if count > Width::Avx2.lanes() => self.fast.together_avx512,
                _ => self.fast.together,
            };
            match together {
                Some(program) => results.extend(program(&rest[..count])),
                None => results.push(self.simulate(first, member, width)),
            }
        }
        results
    }

    /// Simulates an experiment for each variant of a request.
    fn differentiate_one_by_one(
        &self,
        request: &Request<'_, A, N>,
        width: Width,
    ) -> Result<Sensitivities<N>, Diverged> {
        let own = Request {
            variants: &[],
            ..*request
        };
        let (mut all, mut count) = (self.differentiate(&own, width)?, own.directions.len());
        for &Variant {
            parameters,
            directions,
        } in request.variants
        {
            let member = &Member {
                parameters,
                ..*own.member
            };
            let other = Request {
                member,
                directions,
                ..own
            };
            let more = directions.len();
            all.append(&self.differentiate(&other, width)?, [count, more]);
            count += more;
        }
        Ok(all)
    }

    /// Simulates one experiment with derivatives, with the fastest suitable program.
    ///
    /// # Errors
    /// The motion diverged.
    ///
    /// # Panics
    /// The processor has no registers of that width, or the low-pass is for other quantities.
    pub fn differentiate(
        &self,
        request: &Request<'_, A, N>,
        width: Width,
    ) -> Result<Sensitivities<N>, Diverged> {
        width.require();
        let Request { task, member, .. } = *request;
        if let Some(decimation) = request.decimation {
            let (low_passes, quantities) = (decimation.quantities(), task.record.len());
            assert_eq!(low_passes, quantities, "a low-pass for each quantity");
        }
        let variants = request.variants;
        let has_no_size = |parameters| without_plant_effects(&task.config, parameters).is_some();
        let has_forward = width >= Width::COMPILED
            && task.config.is_elastic()
            && (!task.config.has_plant_effects()
                || has_no_size(member.parameters)
                    && variants.iter().all(|one| has_no_size(one.parameters)));
        if !variants.is_empty() && !has_forward {
            return self.differentiate_one_by_one(request, width);
        }
        if width < Width::COMPILED {
            return (self.baseline)(request);
        }
        match width {
            Width::Avx512 if !has_forward => (self.general.dual_numbers_avx512)(request),
            _ if !has_forward => (self.general.dual_numbers)(request),
            _ if !task.config.has_gears::<Slopes>() => (self.general.forward)(request),
            // compiled on aarch64 too, for the registers there
            Width::Neon | Width::Avx512 => (self.fast.forward_avx512)(request),
            _ => (self.fast.forward)(request),
        }
    }
}
