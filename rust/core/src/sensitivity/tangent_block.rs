//! A block of directions, and its step.

use crate::actuation::current_loop::StepTorque;
use crate::arm::transmission::{motor_of, share, torsion_of};
use crate::arm::{Arm, Outlined};
use crate::experiment::Source;
use crate::joint::gear::Gears;
use crate::plant::config::{Config, Role};
use crate::scalar::{Lanes, run_out_of_line, works};
use crate::sensitivity::forcing::Forcing;
use crate::sensitivity::step_length::StepLengthSensitivity;
use crate::sensitivity::tangent::{Response, Tangent, Workspace, advance, set_sums};
use crate::sensitivity::variational::LinearisedStep;

/// Derivatives in `V::LANES` directions.
pub(crate) struct TangentBlock<V: Lanes, const N: usize> {
    pub(crate) tangent: Tangent<V, N>,
    pub(crate) forcing: Forcing<V, N>,
    /// 1 in directions of the joint's settling time, else 0.
    settling: [V; N],
}

impl<V: Lanes, const N: usize> TangentBlock<V, N> {
    pub(crate) fn new<A: Arm<N>>(
        config: &Config<A, N>,
        (directions, first, variant): (&[Source], usize, usize),
        tangent: Tangent<V, N>,
    ) -> Self {
        let roles = config.roles();
        let mut settling = [V::splat(0.0); N];
        for (lane, direction) in directions.iter().skip(first).take(V::LANES).enumerate() {
            if let &Source::Parameter(k) = direction
                && let (Role::Settling, joint) = roles[k]
            {
                settling[joint].set_lane(lane, 1.0);
            }
        }
        Self {
            tangent,
            forcing: Forcing::new(config, directions, (first, variant)),
            settling,
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
        let begin = x.motor;
        let middle = torque.map(|torque| &torque.middle);
        let end = torque.map(|torque| &torque.end);
        at.become_stage(&step.plant.arm, x, time, x, first);
        settle_held_motors(step, at, [&begin, &begin], &self.settling, (part, 0));
        self.forcing
            .respond::<_, _, _, WHOLE>(step, 1, at, middle, second);
        next.become_stage(&step.plant.arm, x, time, at, second);
        settle_held_motors(step, next, [&begin, &at.motor], &self.settling, (part, 0));
        self.forcing
            .respond::<_, _, _, WHOLE>(step, 2, next, middle, third);
        at.become_stage(&step.plant.arm, x, twice, next, third);
        settle_held_motors(
            step,
            at,
            [&begin, &next.motor],
            &self.settling,
            (2.0 * part, 1),
        );
        // before the fourth stage, because the sums need fewer registers than their terms
        set_sums(sums, [first, second, third]);
        self.forcing
            .respond::<_, _, _, WHOLE>(step, 3, at, end, fourth);
        let (third_part, square) = (c(part / 3.0), c(part * part / 1.5));
        let (arm, [positions, velocities]) = (&step.plant.arm, sums);
        let x = &mut self.tangent;
        for i in 0..arm.joints() {
            let (rate, twist) = (
                torsion_of(arm, i, &begin, &x.link),
                torsion_of(arm, i, &positions.motor, &positions.link),
            );
            x.torsion[i] = square.mul_add(twist, advance(x.torsion[i], rate, twice));
            x.angle[i] = square.mul_add(positions.link[i], advance(x.angle[i], x.link[i], twice));
            x.motor[i] = third_part.mul_add(velocities.motor[i] + fourth.motor[i], x.motor[i]);
            x.link[i] = third_part.mul_add(velocities.link[i] + fourth.link[i], x.link[i]);
        }
        settle_held_motors(step, x, [&begin, &begin], &self.settling, (0.0, 1));
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
        self.forcing
            .respond::<_, _, _, false>(step, 1, &second, Some(middle), &mut a2);
        third.push(half, &a2);
        self.forcing
            .respond::<_, _, _, false>(step, 2, &third, Some(middle), &mut a3);
        fourth.shift(&step.plant.arm, c(0.5 * time * time), &a2);
        fourth.push(c(time), &a3);
        self.forcing
            .respond::<_, _, _, false>(step, 3, &fourth, Some(end), &mut a4);
        let mut to = by.end;
        for a in [&a2, &a3] {
            to.shift(&step.plant.arm, c(time * sixth), a);
            to.push(c(2.0 * sixth), a);
        }
        to.push(c(sixth), &a4);
        to
    }
}

impl<V: Lanes, const N: usize> Forcing<V, N> {
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
        let (c, arm) = (V::splat, &step.plant.arm);
        let [gear, motor, link] = self.at(k);
        let mut load = self.of_links(&step.link_forcing, k);
        for i in 0..arm.joints() {
            load[i] = load[i] + link[i];
        }
        // column by column, because a sum of one row would wait for each of its products
        for j in 0..arm.joints() {
            for i in 0..arm.joints() {
                if A::DEPENDS_ON_ANGLE[j] {
                    load[i] = c(step.by_angle[i][j][k]).mul_add(x.angle[j], load[i]);
                }
                load[i] = c(step.by_velocity[i][j][k]).mul_add(x.link[j], load[i]);
            }
        }
        let (mut gears, mut motors) = ([c(0.0); N], [c(0.0); N]);
        for i in 0..arm.joints() {
            let rate = torsion_of(arm, i, &x.motor, &x.link);
            let damped = c(step.damping[i]).mul_add(rate, gear[i]);
            gears[i] = c(step.stiffness[i][k]).mul_add(x.torsion[i], damped);
            motors[i] = c(step.motor[1][i]).mul_add(x.motor[i], motor[i]);
            if let Some(torque) = torque {
                motors[i] = c(step.motor[2][i]).mul_add(torque[i], motors[i]);
            }
            load[i] = gears[i] - load[i];
        }
        for i in 0..arm.joints() {
            response.motor[i] = motor_of(arm, i, c(step.motor[0][i]), &gears, motors[i]);
        }
        if k == 0 {
            response.gear = gears;
        }
        let mut link = [c(0.0); N];
        for j in 0..arm.joints() {
            for i in 0..arm.joints() {
                link[i] = c(step.inverse[i][j][k]).mul_add(load[j], link[i]);
            }
        }
        response.link = link;
    }
}

/// Applies settling motors to a later stage, after half a step (`end` = 0) or a whole one
/// (`end` = 1). The stage was advanced over `elapsed` half steps with the second of the motors'
/// velocities; the first are those at the start of the step. `by_time` is 1 in directions of the
/// joint's settling time, else 0.
#[inline(always)]
fn settle_held_motors<A: Arm<N>, L: Lanes, V: Lanes, G: Gears, const N: usize>(
    step: &LinearisedStep<A, L, G, N>,
    stage: &mut Tangent<V, N>,
    [begin, before]: [&[V; N]; 2],
    by_time: &[V; N],
    (elapsed, end): (f64, usize),
) {
    let (c, arm) = (V::splat, &step.plant.arm);
    for i in 0..arm.joints() {
        let Some(settling) = &step.settling[i] else {
            continue;
        };
        let [angle_by_time, velocity_by_time] = settling.by_time.map(|parts| c(parts[end]));
        let difference = begin[i] - before[i];
        for j in 0..arm.joints() {
            if j != i && arm.transmission().is_none() {
                continue;
            }
            let share = c(share(arm, j, i));
            let torsion = &mut stage.torsion[j];
            *torsion = (share * elapsed).mul_add(difference, *torsion);
            *torsion = (share * settling.angle[end]).mul_add(begin[i], *torsion);
            *torsion = (share * angle_by_time).mul_add(by_time[i], *torsion);
        }
        stage.motor[i] = c(settling.velocity[end]).mul_add(begin[i], stage.motor[i]);
        stage.motor[i] = velocity_by_time.mul_add(by_time[i], stage.motor[i]);
    }
}

works! {
    ['b, A: Arm<N>, L: Lanes, V: Lanes, G: Gears, const N: usize] ['b, A, L, V, G, N]
    /// [`Forcing::compute_response`].
    ResponseWork(0: &'b Forcing<V, N>, 1: &'b LinearisedStep<A, L, G, N>, 2: usize,
        3: &'b Tangent<V, N>, 4: Option<&'b [V; N]>, 5: &'b mut Response<V, N>) -> ()
        = Forcing::compute_response;
}
