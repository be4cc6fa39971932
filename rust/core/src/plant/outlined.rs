//! Parts of the equations that are compiled as separate functions, so that programs stay small.

use super::{Acceleration, Instant, Modes, Plant, State};
use crate::arm::{Arm, Outlined};
use crate::joint::DriveTrains;
use crate::joint::gear::Gears;
use crate::scalar::{Real, run_out_of_line, works};

works! {
    ['p, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool]
    ['p, A, R, G, N, EFFECTS]
    /// [`Plant::compute_drive_trains`].
    DriveTrainWork(0: &'p Plant<A, R, G, N, EFFECTS>, 1: &'p State<R, N>)
        -> DriveTrains<R, N> = Plant::compute_drive_trains;
    /// [`Plant::accelerations`].
    AccelerationWork(0: &'p Plant<A, R, G, N, EFFECTS>, 1: &'p State<R, N>, 2: &'p A::Posture<R>,
        3: &'p [R; N], 4: &'p Modes<R, N>) -> Acceleration<R, N> = Plant::accelerations;
    /// [`Plant::hysteresis_states`].
    pub(super) HysteresisWork(0: &'p Plant<A, R, G, N, EFFECTS>, 1: &'p State<R, N>, 2: &'p State<R, N>, 3: R)
        -> [R; N] = Plant::hysteresis_states;
    /// [`Plant::subtract_rigid_loads`].
    pub(super) RigidLoadWork(0: &'p Plant<A, R, G, N, EFFECTS>, 1: &'p State<R, N>, 2: &'p [R; N],
        3: &'p Modes<R, N>, 4: &'p [R; N]) -> [R; N] = Plant::subtract_rigid_loads;
    /// [`Plant::holding_torques_and_limits`].
    pub(super) HoldingWork(0: &'p Plant<A, R, G, N, EFFECTS>, 1: &'p State<R, N>, 2: &'p [R; N],
        3: &'p Modes<R, N>) -> [[R; N]; 2] = Plant::holding_torques_and_limits;
    /// [`Plant::instant`].
    pub(super) BeginWork(0: &'p Plant<A, R, G, N, EFFECTS>, 1: &'p State<R, N>, 2: &'p [R; N],
        3: &'p Modes<R, N>) -> Instant<A, R, N> = Plant::instant;
}

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Plant<A, R, G, N, EFFECTS> {
    /// Gears of all joints; zeros for arms whose stages are not outlined and which have no
    /// transmission, to which [`Plant::add_drive_train`] adds them where they are needed.
    #[inline(always)]
    pub(super) fn outlined_drive_trains(&self, x: &State<R, N>) -> DriveTrains<R, N> {
        match A::OUTLINED {
            Outlined::Nothing => DriveTrains::zero(),
            Outlined::Stages => self.compute_drive_trains(x),
            Outlined::Parts => run_out_of_line::<R, _>(DriveTrainWork(self, x)),
        }
    }

    /// Adds the gear of a joint, unless [`Plant::outlined_drive_trains`] has computed it.
    #[inline(always)]
    pub(super) fn add_drive_train(
        &self,
        x: &State<R, N>,
        i: usize,
        trains: &mut DriveTrains<R, N>,
    ) {
        if A::OUTLINED == Outlined::Nothing {
            self.compute_drive_train(x, i, trains);
        }
    }

    /// Accelerations; with effects in a separate function.
    #[inline(always)]
    pub(super) fn accelerations_at(
        &self,
        x: &State<R, N>,
        at: &A::Posture<R>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> Acceleration<R, N> {
        if EFFECTS || A::OUTLINED != Outlined::Nothing {
            // inlined into every stage, the exponentials and sines of effects would be half of the
            // program
            run_out_of_line::<R, _>(AccelerationWork(self, x, at, torque, modes))
        } else {
            self.accelerations(x, at, torque, modes)
        }
    }
}
