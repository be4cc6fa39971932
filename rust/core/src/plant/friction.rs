//! Set-valued Coulomb friction: sliding, sticking, and the events between.
//!
//! The friction torque on a motor is `f_M Sgn(dtheta_M)` with `Sgn(0) = [-1, 1]`; with effects,
//! `f_M` is [`Plant::dry_friction`]. Between events every motor either slides in one direction or
//! sticks, so the equations are smooth and the integrator keeps its order. A step is cut
//!
//! - where the velocity of a sliding motor reaches zero: the motor sticks if the torque that holds
//!   it is within `f_M`, otherwise it slides in the other direction;
//! - where the torque that holds a sticking motor is outside `[-f_M, f_M]`: the motor starts to slide.
//!
//! With a settling time tau, friction does not stop a motor instantly but as fast as `ddtheta_M =
//! -dtheta_M / tau`, as long as this requires at most `f_M`. The torque is `clamp(H + m_M
//! dtheta_M / tau, -f_M, f_M)`, with the torque H that keeps the motor at rest: one backward Euler
//! step of length tau of the set-valued law (its Yosida regularisation). In contrast to a steep
//! function of the velocity there is no creep: under any load below `f_M` the motor comes to rest.
//! The friction torque changes sign about tau before the velocity does. For tau = 0 the law is the
//! set-valued one, with the same two events.
//!
//! The times of events are roots of the integrator's own step as a function of its length, to
//! rounding. The cut therefore keeps the order, and the result is a smooth function of all
//! parameters as long as the sequence of events does not change. Over dual numbers, the times have
//! derivatives by the implicit function theorem for that step.

use crate::actuation::current_loop::CurrentLoop;
use crate::arm::Arm;
use crate::arm::transmission::{coupled, link_of};
use crate::joint::gear::Gears;
use crate::plant::event_time::{Decay, root};
use crate::plant::outlined::{BeginWork, HoldingWork};
use crate::plant::{Instant, Modes, Plant, State, Watch};
use crate::scalar::{Real, in_lane, run_out_of_line, works};

/// Largest number of events within one step. After that, motors at rest are held until the step
/// ends.
///
/// More events require a torque that changes sign many times within a step, which the step cannot
/// resolve.
const MAX_STEP_EVENTS: usize = 12;

/// Motion of one arm: state, motor torques and friction modes.
#[derive(Clone, Copy, Debug)]
pub struct Motion<R, const N: usize> {
    /// Angles and velocities.
    pub state: State<R, N>,
    /// Motor torques [N m].
    pub torque: [R; N],
    /// Friction modes.
    pub modes: Modes<R, N>,
}

/// Margins of the friction modes; negative if a mode has ended.
#[derive(Clone, Copy, Debug)]
pub struct Margins<R, const N: usize> {
    /// Of a sliding motor its velocity in its direction, or with a settling time `dtheta_M + tau
    /// ddtheta_M`; of a held motor the remaining friction.
    pub margin: [R; N],
    /// [`Plant::holding_torques`], unless all motors slide and stop instantly.
    holding: [R; N],
    /// Friction limits in that case.
    limit: [R; N],
}

impl<R: Real, const N: usize> Margins<R, N> {
    /// In one lane.
    pub(crate) fn lane<S: Real>(&self, lane: usize) -> Margins<S, N> {
        Margins {
            margin: in_lane(&self.margin, lane),
            holding: in_lane(&self.holding, lane),
            limit: in_lane(&self.limit, lane),
        }
    }

    /// The smallest margin.
    #[inline(always)]
    pub(crate) fn smallest(&self) -> R {
        let mut smallest = self.margin[0];
        for margin in &self.margin[1..] {
            smallest = smallest.min(*margin);
        }
        smallest
    }
}

impl<R: Real, const N: usize> Motion<R, N> {
    /// At rest with all angles and torques zero.
    pub(crate) fn zero() -> Self {
        let zero = [R::splat(0.0); N];
        let modes = Modes {
            direction: zero,
            free: zero,
        };
        Self {
            state: State::zero(),
            torque: zero,
            modes,
        }
    }

    /// The motion in one lane, without effects.
    pub(crate) fn lane<S: Real>(&self, lane: usize) -> Motion<S, N> {
        let (state, modes) = (&self.state, &self.modes);
        Motion {
            state: State {
                motor_angle: in_lane(&state.motor_angle, lane),
                motor_velocity: in_lane(&state.motor_velocity, lane),
                link_angle: in_lane(&state.link_angle, lane),
                link_velocity: in_lane(&state.link_velocity, lane),
                ..State::zero()
            },
            torque: in_lane(&self.torque, lane),
            modes: Modes {
                direction: in_lane(&modes.direction, lane),
                free: in_lane(&modes.free, lane),
            },
        }
    }

    /// Sets the motion in one lane, without effects.
    pub(crate) fn set_lane<S: Real>(&mut self, lane: usize, one: &Motion<S, N>) {
        let set = |numbers: &mut [R; N], to: &[S; N]| {
            for i in 0..N {
                numbers[i].set_lane(lane, to[i].lane(0));
            }
        };
        set(&mut self.state.motor_angle, &one.state.motor_angle);
        set(&mut self.state.motor_velocity, &one.state.motor_velocity);
        set(&mut self.state.link_angle, &one.state.link_angle);
        set(&mut self.state.link_velocity, &one.state.link_velocity);
        set(&mut self.torque, &one.torque);
        set(&mut self.modes.direction, &one.modes.direction);
        set(&mut self.modes.free, &one.modes.free);
    }
}

impl<A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> Plant<A, R, G, N, EFFECTS> {
    /// Modes that agree with a state: moving motors slide; resting ones stick if friction can hold
    /// them.
    pub fn modes_at(&self, x: &State<R, N>, torque: &[R; N]) -> Modes<R, N> {
        const { assert!(R::LANES == 1) };
        let mut modes = Modes {
            direction: x.motor_velocity.map(|v| sign(v.lane(0))),
            free: [R::splat(1.0); N],
        };
        for i in 0..self.arm.joints() {
            if self.dry_friction_at_rest(i) == 0.0 {
                modes.direction[i] = R::splat(0.0);
            } else if x.motor_velocity[i].lane(0) == 0.0 {
                modes.free[i] = R::splat(0.0);
            }
        }
        self.release(x, torque, &mut modes);
        modes
    }

    /// Friction limit of an unloaded motor at rest [N m].
    fn dry_friction_at_rest(&self, i: usize) -> f64 {
        self.dry_friction(R::splat(0.0), R::splat(0.0), i).lane(0)
    }

    /// Releases the sticking motors that friction cannot hold; returns whether there were any.
    pub fn release(&self, x: &State<R, N>, torque: &[R; N], modes: &mut Modes<R, N>) -> bool {
        let mut known = None;
        let mut any = false;
        for i in 0..self.arm.joints() {
            if modes.free[i].lane(0) == 0.0 {
                let [holding, limit] = *known.get_or_insert_with(|| {
                    run_out_of_line::<R, _>(HoldingWork(self, x, torque, modes))
                });
                let holding = holding[i].lane(0);
                if holding.abs() > limit[i].lane(0) {
                    modes.direction[i] = sign(holding);
                    modes.free[i] = R::splat(1.0);
                    (known, any) = (None, true);
                }
            }
        }
        any
    }

    /// The smallest friction that remains at a held motor; negative in lanes that release one.
    pub(crate) fn smallest_reserve(
        &self,
        x: &State<R, N>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> R {
        R::scope(ReserveWork(self, x, torque, modes))
    }

    #[inline(always)]
    fn compute_smallest_reserve(&self, x: &State<R, N>, torque: &[R; N], modes: &Modes<R, N>) -> R {
        let [holding, limit] = self.holding_torques_and_limits(x, torque, modes);
        let mut smallest = R::splat(0.0);
        for i in 0..self.arm.joints() {
            let held = -modes.free[i] + 1.0;
            smallest = smallest.min(held * (limit[i] - holding[i].abs()));
        }
        smallest
    }

    /// Holding torques and friction limits of all motors.
    #[inline(always)]
    pub(super) fn holding_torques_and_limits(
        &self,
        x: &State<R, N>,
        torque: &[R; N],
        modes: &Modes<R, N>,
    ) -> [[R; N]; 2] {
        [
            self.holding_torques(x, torque, modes),
            self.friction_limits(x),
        ]
    }

    /// Margins of the friction modes at the end of a step. `has_held_motors` states whether any motor
    /// is held; otherwise the holding torques need not be computed.
    #[inline(always)]
    pub fn margins(
        &self,
        x: &State<R, N>,
        torque: &[R; N],
        modes: &Modes<R, N>,
        has_held_motors: bool,
    ) -> Margins<R, N> {
        let mut margin = x.motor_velocity;
        for i in 0..self.arm.joints() {
            margin[i] = margin[i] * modes.direction[i];
        }
        let [mut holding, mut limit] = [[R::splat(0.0); N]; 2];
        if has_held_motors || self.settles {
            [holding, limit] = self.holding_torques_and_limits(x, torque, modes);
            for i in 0..self.arm.joints() {
                let (joint, limit) = (&self.joints[i], limit[i]);
                let reserve = limit - holding[i].abs();
                let held = (-modes.free[i] + 1.0) * reserve;
                // 1 for an instant stop, 0 with a settling time
                let is_instant = -joint.settling_time * joint.settling_rate + 1.0;
                let beyond = modes.direction[i] * holding[i] - limit;
                let velocity_per_torque =
                    joint.settling_time * joint.motor_mobility * modes.free[i];
                margin[i] =
                    is_instant.mul_add(margin[i], velocity_per_torque.mul_add(beyond, held));
            }
        }
        Margins {
            margin,
            holding,
            limit,
        }
    }

    /// Advances the motion by `h` [s] through all events, if the modes have given margins after
    /// a step without events; `spans` receives the spans between them.
    pub fn advance(
        &self,
        motion: &Motion<R, N>,
        margins: &Margins<R, N>,
        target: &[R; N],
        current: &CurrentLoop<R, N>,
        h: f64,
        spans: &mut Vec<Span<R, N>>,
    ) -> Motion<R, N> {
        let mut now = *motion;
        let mut remaining = R::splat(h);
        let mut margins = *margins;
        for count in 0..MAX_STEP_EVENTS {
            let integrator = SpanIntegrator::new(self, &now, target, current, remaining);
            let mut end = now;
            if count > 0 {
                (end, margins) = integrator.end(R::splat(1.0));
            }
            let event = integrator.first_event(&margins);
            spans.push(Span::new(&now, remaining, event.map(|(event, _)| event)));
            let Some(((part, joint), mut at_event)) = event else {
                return end;
            };
            // a mode that does not fit from the beginning ends at a fixed time
            let mut length = R::splat(part);
            if R::HAS_DERIVATIVE && part > 0.0 {
                length = R::root(part, |part| integrator.end(part).1.margin[joint]);
                at_event = integrator.end(length).0;
            }
            now = at_event;
            self.change_mode(&mut now, joint);
            remaining = remaining * (-length + 1.0);
            if remaining.lane(0) <= 1e-15 * h {
                return now;
            }
        }
        self.hold_resting_motors(&mut now);
        spans.push(Span::new(&now, remaining, None));
        SpanIntegrator::new(self, &now, target, current, remaining)
            .end(R::splat(1.0))
            .0
    }

    /// Repeats a span with an observer. Returns the motion after a part of the length.
    #[inline(always)]
    pub(crate) fn retrace(
        &self,
        from: &Motion<R, N>,
        target: &[R; N],
        current: &CurrentLoop<R, N>,
        (length, part): (R, R),
        watch: &mut impl Watch<R, N>,
    ) -> Motion<R, N> {
        SpanIntegrator::new(self, from, target, current, length)
            .integrate(part, watch)
            .0
    }

    /// Changes the mode of a joint at its event.
    fn change_mode(&self, motion: &mut Motion<R, N>, joint: usize) {
        if motion.modes.free[joint].lane(0) != 0.0 {
            motion.modes.direction[joint] = R::splat(0.0);
            motion.modes.free[joint] = R::splat(0.0);
            if self.joints[joint].settling_time.lane(0) > 0.0 {
                return;
            }
            motion.state.motor_velocity[joint] = R::splat(0.0);
            if self.is_rigid(joint) {
                for i in coupled(&self.arm, joint) {
                    let velocity = &motion.state.motor_velocity;
                    let zero = R::splat(0.0);
                    motion.state.link_velocity[i] =
                        link_of(&self.arm, i, &self.ratios(), velocity, zero);
                }
            }
            self.release(&motion.state, &motion.torque, &mut motion.modes);
        } else {
            let Motion {
                state,
                torque,
                modes,
            } = &motion;
            let [holding, _] = run_out_of_line::<R, _>(HoldingWork(self, state, torque, modes));
            motion.modes.direction[joint] = sign(holding[joint].lane(0));
            motion.modes.free[joint] = R::splat(1.0);
        }
    }

    /// Ends chattering: motors at rest stick until the end of the step.
    fn hold_resting_motors(&self, motion: &mut Motion<R, N>) {
        for i in 0..self.arm.joints() {
            let is_at_rest = motion.state.motor_velocity[i].lane(0).abs() < 1e-9;
            if is_at_rest && self.dry_friction_at_rest(i) > 0.0 {
                motion.state.motor_velocity[i] = R::splat(0.0);
                motion.modes.direction[i] = R::splat(0.0);
                motion.modes.free[i] = R::splat(0.0);
            }
        }
    }
}

/// An event: part of the span since the last event, and joint.
pub type Event = (f64, usize);

/// The span between two events of a step.
#[derive(Clone, Copy, Debug)]
pub struct Span<R, const N: usize> {
    /// Motion at its beginning.
    pub from: Motion<R, N>,
    /// Remaining length of the step [s].
    pub length: f64,
    /// The event at its end; `None` at the end of the step.
    pub event: Option<Event>,
}

impl<R: Real, const N: usize> Span<R, N> {
    fn new(from: &Motion<R, N>, length: R, event: Option<Event>) -> Self {
        Self {
            from: *from,
            length: length.lane(0),
            event,
        }
    }
}

/// A span of time with fixed modes, and the integrator's step over any part of it.
struct SpanIntegrator<'a, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool> {
    plant: &'a Plant<A, R, G, N, EFFECTS>,
    from: &'a Motion<R, N>,
    target: &'a [R; N],
    current: &'a CurrentLoop<R, N>,
    length: R,
    begin: Instant<A, R, N>,
    has_held_motors: bool,
}

works! {
    ['p, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool]
    ['p, A, R, G, N, EFFECTS]
    /// [`Plant::smallest_reserve`].
    ReserveWork(0: &'p Plant<A, R, G, N, EFFECTS>, 1: &'p State<R, N>, 2: &'p [R; N],
        3: &'p Modes<R, N>) -> R = Plant::compute_smallest_reserve;
}

works! {
    ['l, 'a, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool]
    ['l, 'a, A, R, G, N, EFFECTS]
    /// [`SpanIntegrator::margins_at_begin`].
    BeginMarginWork(0: &'l SpanIntegrator<'a, A, R, G, N, EFFECTS>) -> Margins<R, N>
        = SpanIntegrator::margins_at_begin;
    /// [`SpanIntegrator::integrate`].
    EndWork(0: &'l SpanIntegrator<'a, A, R, G, N, EFFECTS>, 1: R, 2: &'l mut ())
        -> (Motion<R, N>, Margins<R, N>) = SpanIntegrator::integrate;
}

impl<'a, A: Arm<N>, R: Real, G: Gears, const N: usize, const EFFECTS: bool>
    SpanIntegrator<'a, A, R, G, N, EFFECTS>
{
    fn new(
        plant: &'a Plant<A, R, G, N, EFFECTS>,
        from: &'a Motion<R, N>,
        target: &'a [R; N],
        current: &'a CurrentLoop<R, N>,
        length: R,
    ) -> Self {
        Self {
            plant,
            from,
            target,
            current,
            length,
            begin: R::scope(BeginWork(plant, &from.state, &from.torque, &from.modes)),
            has_held_motors: from.modes.free.iter().any(|free| free.lane(0) == 0.0),
        }
    }

    /// Motion and margins after a part of the length.
    fn end(&self, part: R) -> (Motion<R, N>, Margins<R, N>) {
        R::scope(EndWork(self, part, &mut ()))
    }

    #[inline(always)]
    fn margins_at_begin(&self) -> Margins<R, N> {
        let Motion {
            state,
            torque,
            modes,
        } = self.from;
        self.plant
            .margins(state, torque, modes, self.has_held_motors)
    }

    #[inline(always)]
    fn integrate(&self, part: R, watch: &mut impl Watch<R, N>) -> (Motion<R, N>, Margins<R, N>) {
        let t = part * self.length;
        let torque = self.current.over(&self.from.torque, self.target, t);
        let modes = &self.from.modes;
        let state = self
            .plant
            .runge_kutta(&self.from.state, &self.begin, &torque, modes, t, watch);
        let margins = self
            .plant
            .margins(&state, &torque.end, modes, self.has_held_motors);
        let motion = Motion {
            state,
            torque: torque.end,
            modes: *modes,
        };
        (motion, margins)
    }

    /// The first event of the span, if there is one, with the motion at that event.
    fn first_event(&self, at_end: &Margins<R, N>) -> Option<(Event, Motion<R, N>)> {
        let at_begin = R::scope(BeginMarginWork(self));
        let mut first: Option<(Event, Motion<R, N>)> = None;
        let mut at_end = *at_end;
        for i in 0..self.plant.arm.joints() {
            // before the first event found so far
            let whole = first.map_or(1.0, |(event, _)| event.0);
            if at_end.margin[i].lane(0) >= 0.0 || whole == 0.0 {
                continue;
            }
            let joint = &self.plant.joints[i];
            let length = self.length.lane(0) * whole;
            let is_held = self.from.modes.free[i].lane(0) == 0.0;
            let stops_instantly = joint.settling_time.lane(0) == 0.0;
            let (mut slope, mut decay) = (None, Decay::default());
            // the side on which the torque exceeds friction: without it the margin has a kink
            let side = at_end.holding[i].lane(0).signum();
            let margin = |margins: &Margins<R, N>| match is_held {
                true => margins.limit[i].lane(0) - side * margins.holding[i].lane(0),
                false => margins.margin[i].lane(0),
            };
            if is_held && !stops_instantly {
                let velocity = self.from.state.motor_velocity[i];
                let brake = joint.motor_inertia * joint.settling_rate - joint.motor_viscous;
                decay = Decay {
                    size: -side * (brake * velocity).lane(0),
                    rate: length * joint.settling_rate.lane(0),
                };
            } else if !is_held && stops_instantly {
                let speed = self.begin.acceleration.motor[i] * self.from.modes.direction[i];
                slope = Some(speed.lane(0) * length);
            }
            let mut last = None;
            let after = |part: f64| {
                let (motion, margins) = self.end(R::splat(part * whole));
                last = Some((part, motion, margins));
                margin(&margins)
            };
            let part = root(after, [margin(&at_begin), margin(&at_end)], slope, decay);
            let (motion, margins) = match last {
                Some((at, motion, margins)) if at == part => (motion, margins),
                _ => self.end(R::splat(part * whole)),
            };
            first = Some(((part * whole, i), motion));
            at_end = margins;
        }
        first
    }
}

/// +1, -1 or 0.
pub(crate) fn sign<R: Real>(value: f64) -> R {
    R::splat(if value > 0.0 {
        1.0
    } else if value < 0.0 {
        -1.0
    } else {
        0.0
    })
}
