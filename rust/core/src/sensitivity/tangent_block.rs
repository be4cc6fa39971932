//! A block of directions, and its step.

use crate::actuation::current_loop::StepTorque;
use crate::arm::transmission::{link_of, motor_of, share};
use crate::arm::{Arm, Outlined};
use crate::experiment::Source;
use crate::joint::gear::Gears;
use crate::plant::config::{Config, Role};
use crate::scalar::{Lanes, run_out_of_line, works};
use crate::sensitivity::forcing::{Forcing, Row};
use crate::sensitivity::step_length::StepLengthSensitivity;
use crate::sensitivity::tangent::{Response, Tangent, Workspace, advance, set_sums};
use crate::sensitivity::variational::LinearisedStep;

/// Derivatives in `V::LANES` directions.
pub(crate) struct TangentBlock<V: Lanes, const N: usize> {
    pub(crate) tangent: Tangent<V, N>,
    forcing: Forcing<V, N>,
    /// 1 in directions of the joint's settling time, else 0.
    settling: [V; N],
}

impl<V: Lanes, const N: usize> TangentBlock<V, N> {
    pub(crate) fn new<A: Arm<N>>(
        config: &Config<A, N>,
        directions: &[Source],
        tangent: Tangent<V, N>,
    ) -> Self {
        let roles = config.roles();
        let mut settling = [V::splat(0.0); N];
        for (lane, direction) in directions.iter().take(V::LANES).enumerate() {
            if let &Source::Parameter(k) = direction
                && let (Role::Settling, joint) = roles[k]
            {
                settling[joint].set_lane(lane, 1.0);
            }
        }
        Self {
            tangent,
            forcing: Forcing::new(config, directions),
            settling,
        }
    }

    /// The equations of stage `k` of a `WHOLE` step or a part of one; for some arms in a separate
    /// function.
    #[inline(always)]
    pub(crate) fn respond<A: Arm<N>, L: Lanes, G: Gears, const WHOLE: bool>(
        &self,
        step: &LinearisedStep<A, L, G, N>,
        k: usize,
        x: &Tangent<V, N>,
        torque: Option<&[V; N]>,
        response: &mut Response<V, N>,
    ) {
        if A::OUTLINED == Outlined::Parts || A::OUTLINED == Outlined::Stages && !WHOLE {
            run_out_of_line::<V, _>(ResponseWork(self, step, k, x, torque, response));
        } else {
            self.compute_response(step, k, x, torque, response);
        }
    }

    #[inline(always)]
    fn compute_response<A: Arm<N>, L: Lanes, G: Gears>(
        &self,
        step: &LinearisedStep<A, L, G, N>,
        k: usize,
        x: &Tangent<V, N>,
        torque: Option<&[V; N]>,
        response: &mut Response<V, N>,
    ) {
        let c = V::splat;
        let forced = |row, joint| self.forcing.of(&step.quads, row, joint, k);
        let (arm, one) = (&step.plant.arm, [c(1.0); N]);
        let mut load = [c(0.0); N];
        for i in 0..arm.joints() {
            let rate = link_of(arm, i, &one, &x.motor, -x.link[i]);
            let damped = c(step.damping[i]).mul_add(rate, forced(Row::Gear, i));
            let gear = c(step.stiffness[i][k]).mul_add(x.torsion[i], damped);
            let mut motor = forced(Row::Motor, i);
            if let Some(torque) = torque {
                motor = c(step.motor[2][i]).mul_add(torque[i], motor);
            }
            let dragged = c(step.motor[1][i]).mul_add(x.motor[i], motor);
            response.rate[i] = rate;
            response.gear[i] = gear;
            response.motor[i] = match arm.transmission() {
                None => c(step.motor[0][i]).mul_add(gear, dragged),
                Some(_) => dragged, // the torques of all gears follow
            };
            let mut link_load = forced(Row::Link, i);
            for j in 0..arm.joints() {
                if A::DEPENDS_ON_ANGLE[j] {
                    link_load = c(step.by_angle[i][j][k]).mul_add(x.angle[j], link_load);
                }
                link_load = c(step.by_velocity[i][j][k]).mul_add(x.link[j], link_load);
            }
            load[i] = gear - link_load;
        }
        if arm.transmission().is_some() {
            for i in 0..arm.joints() {
                let slope = c(step.motor[0][i]);
                let dragged = response.motor[i];
                response.motor[i] = motor_of(arm, i, slope, &response.gear, dragged);
            }
        }
        for i in 0..arm.joints() {
            let mut link = load[0] * step.inverse[i][0][k];
            for j in 1..arm.joints() {
                link = c(step.inverse[i][j][k]).mul_add(load[j], link);
            }
            response.link[i] = link;
        }
    }

    /// Advances by a whole step after its first stage.
    #[inline(always)]
    pub(crate) fn advance<A: Arm<N>, L: Lanes, G: Gears>(
        &mut self,
        step: &LinearisedStep<A, L, G, N>,
        first: &Response<V, N>,
        torque: Option<&StepTorque<V, N>>,
        workspace: &mut Workspace<V, N>,
    ) {
        self.advance_part::<A, L, G, true>(step, first, torque, 1.0, workspace);
    }

    /// Advances by a part of a step after its first stage.
    ///
    /// The classical Runge-Kutta step with stages at half of the part and at its end. `WHOLE`
    /// states that the part is one, which removes a factor from most sums.
    #[inline(always)]
    pub(crate) fn advance_part<A: Arm<N>, L: Lanes, G: Gears, const WHOLE: bool>(
        &mut self,
        step: &LinearisedStep<A, L, G, N>,
        first: &Response<V, N>,
        torque: Option<&StepTorque<V, N>>,
        part: f64,
        workspace: &mut Workspace<V, N>,
    ) {
        let c = V::splat;
        let time = if WHOLE { None } else { Some(c(part)) };
        let twice = Some(c(2.0 * part));
        let Workspace {
            stages: [at, next],
            responses: [second, third, fourth],
            sums,
        } = workspace;
        let x = &self.tangent;
        let middle = torque.map(|torque| &torque.middle);
        let end = torque.map(|torque| &torque.end);
        at.become_stage::<A>(x, time, x, first);
        self.settle_held_motors(step, at, x, (part, 0));
        self.respond::<_, _, _, WHOLE>(step, 1, at, middle, second);
        next.become_stage::<A>(x, time, at, second);
        self.settle_held_motors(step, next, at, (part, 0));
        self.respond::<_, _, _, WHOLE>(step, 2, next, middle, third);
        at.become_stage::<A>(x, twice, next, third);
        self.settle_held_motors(step, at, next, (2.0 * part, 1));
        // before the fourth stage, because the sums need fewer registers than their terms
        set_sums(sums, [first, second, third]);
        self.respond::<_, _, _, WHOLE>(step, 3, at, end, fourth);
        let (third_part, square) = (c(part / 3.0), c(part * part / 1.5));
        let (arm, one, to) = (&step.plant.arm, [c(1.0); N], next);
        let [positions, velocities] = sums;
        for i in 0..arm.joints() {
            to.motor[i] = third_part.mul_add(velocities.motor[i] + fourth.motor[i], x.motor[i]);
            to.link[i] = third_part.mul_add(velocities.link[i] + fourth.link[i], x.link[i]);
            to.angle[i] = square.mul_add(positions.link[i], advance(x.angle[i], x.link[i], twice));
            let torsion = link_of(arm, i, &one, &positions.motor, -positions.link[i]);
            to.torsion[i] = square.mul_add(torsion, advance(x.torsion[i], first.rate[i], twice));
        }
        self.settle_held_motors(step, to, x, (0.0, 1));
        self.tangent = *to;
    }

    /// Derivatives of the end of a step of length `h` with respect to its length, for a block
    /// without parameters.
    #[inline(always)]
    pub(crate) fn by_step_length<A: Arm<N>, L: Lanes, G: Gears>(
        &self,
        step: &LinearisedStep<A, L, G, N>,
        by: &StepLengthSensitivity<V, N>,
        h: f64,
    ) -> Tangent<V, N> {
        let (c, time) = (V::splat, h / step.half);
        let [second, mut third, mut fourth] = by.stages;
        let (half, sixth) = (c(0.5 * time), time / 6.0);
        let [middle, end] = &by.torque;
        let [mut a2, mut a3, mut a4] = [Response::zero(); 3];
        self.respond::<_, _, _, false>(step, 1, &second, Some(middle), &mut a2);
        third.push(half, &a2);
        self.respond::<_, _, _, false>(step, 2, &third, Some(middle), &mut a3);
        fourth.shift(&step.plant.arm, c(0.5 * time * time), &a2);
        fourth.push(c(time), &a3);
        self.respond::<_, _, _, false>(step, 3, &fourth, Some(end), &mut a4);
        let mut to = by.end;
        for a in [&a2, &a3] {
            to.shift(&step.plant.arm, c(time * sixth), a);
            to.push(c(2.0 * sixth), a);
        }
        to.push(c(sixth), &a4);
        to
    }

    /// Applies settling motors to a later stage, after half a step (`end` = 0) or a whole one
    /// (`end` = 1). The stage was advanced with the velocities of the stage `before` over `elapsed`
    /// half steps.
    #[inline(always)]
    fn settle_held_motors<A: Arm<N>, L: Lanes, G: Gears>(
        &self,
        step: &LinearisedStep<A, L, G, N>,
        stage: &mut Tangent<V, N>,
        before: &Tangent<V, N>,
        (elapsed, end): (f64, usize),
    ) {
        let c = V::splat;
        for i in 0..step.plant.arm.joints() {
            let Some(settling) = &step.settling[i] else {
                continue;
            };
            let motor = self.tangent.motor[i];
            let [by_time, velocity_by_time] = settling.by_time.map(|parts| c(parts[end]));
            // velocity at the start of the step minus velocity with which the stage was advanced
            let difference = motor - before.motor[i];
            for j in 0..step.plant.arm.joints() {
                if j != i && step.plant.arm.transmission().is_none() {
                    continue;
                }
                let share = c(share(&step.plant.arm, j, i));
                let torsion = &mut stage.torsion[j];
                *torsion = (share * elapsed).mul_add(difference, *torsion);
                *torsion = (share * settling.angle[end]).mul_add(motor, *torsion);
                *torsion = (share * by_time).mul_add(self.settling[i], *torsion);
            }
            stage.motor[i] = c(settling.velocity[end]).mul_add(motor, stage.motor[i]);
            stage.motor[i] = velocity_by_time.mul_add(self.settling[i], stage.motor[i]);
        }
    }
}

works! {
    ['b, A: Arm<N>, L: Lanes, V: Lanes, G: Gears, const N: usize] ['b, A, L, V, G, N]
    /// [`TangentBlock::compute_response`].
    ResponseWork(0: &'b TangentBlock<V, N>, 1: &'b LinearisedStep<A, L, G, N>, 2: usize,
        3: &'b Tangent<V, N>, 4: Option<&'b [V; N]>, 5: &'b mut Response<V, N>) -> ()
        = TangentBlock::compute_response;
}
