//! Programs of the horizontal two-link arm.

use strainwave_core::arm::TwoLink;
use strainwave_core::experiment::{Diverged, Member, Record, Task};
use strainwave_core::joint::gear::Slopes;
use strainwave_core::program::{
    Case, FastPrograms, forward, forward_avx512, simulate, simulate_together,
    simulate_together_avx512,
};
use strainwave_core::sensitivity::{Request, Sensitivities};

type Arm = TwoLink<true>;
type LevelArm = TwoLink<false>;

/// Programs for linear and three-slope gears without gravity.
pub static FAST: FastPrograms<Arm, 2> = FastPrograms {
    simulation: level_simulate,
    together: Some(level_together),
    together_avx512: Some(level_together_avx512),
    forward: level_forward,
    forward_avx512: level_forward_avx512,
};

fn level_simulate(task: &Task<Arm, 2>, member: &Member<'_, 2>) -> Result<Record<2>, Diverged> {
    simulate::<LevelArm, Slopes, 2, false>(&task.with_arm(Arm::level), member)
}

type Recordings = Vec<Result<Record<2>, Diverged>>;

fn level_together(cases: &[Case<'_, Arm, 2>]) -> Recordings {
    simulate_together::<LevelArm, Slopes, 2>(&all_level(cases))
}

fn level_together_avx512(cases: &[Case<'_, Arm, 2>]) -> Recordings {
    simulate_together_avx512::<LevelArm, Slopes, 2>(&all_level(cases))
}

fn all_level<'a>(cases: &[Case<'a, Arm, 2>]) -> Vec<Case<'a, LevelArm, 2>> {
    let level = |(task, member): &Case<'a, Arm, 2>| (task.with_arm(Arm::level), *member);
    cases.iter().map(level).collect()
}

fn level_forward(request: &Request<'_, Arm, 2>) -> Result<Sensitivities<2>, Diverged> {
    let task = request.task.with_arm(Arm::level);
    forward::<LevelArm, Slopes, 2, true>(&request.with_task(&task))
}

fn level_forward_avx512(request: &Request<'_, Arm, 2>) -> Result<Sensitivities<2>, Diverged> {
    let task = request.task.with_arm(Arm::level);
    forward_avx512::<LevelArm, Slopes, 2, true>(&request.with_task(&task))
}
