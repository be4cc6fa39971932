//! Directions of derivatives side by side, and what a step does to them.

use crate::arm::Arm;
use crate::config::{Config, SETTLING};
use crate::experiment::Source;
use crate::lengthening::Lengthening;
use crate::plant::StepTorque;
use crate::real::{MOST_LANES, Real};
use crate::variation::{Linearised, Row, places};

/// Derivatives of twists, twist rates, link angles and link velocities.
#[derive(Clone, Copy)]
pub(crate) struct Tangent<V, const N: usize> {
    pub(crate) twist: [V; N],
    pub(crate) rate: [V; N],
    pub(crate) angle: [V; N],
    pub(crate) velocity: [V; N],
}

/// Derivatives of what the state brings about at once.
#[derive(Clone, Copy)]
pub(crate) struct Response<V, const N: usize> {
    /// Gear torques.
    pub(crate) gear: [V; N],
    /// Second derivatives of the twists.
    twist: [V; N],
    /// Link accelerations.
    pub(crate) link: [V; N],
}

/// `V::LANES` directions.
pub(crate) struct Column<V, const N: usize> {
    pub(crate) tangent: Tangent<V, N>,
    /// What this column's parameters add to the gears', motors' and links' rows at each stage.
    forcing: [[[V; 4]; N]; 3],
    /// The rows of these that are not zero always, and whose entries they hold.
    plan: Vec<(Row, usize, [usize; MOST_LANES])>,
    /// One where a direction is the joint's settling time.
    settling: [V; N],
}

impl<V: Real, const N: usize> Column<V, N> {
    pub(crate) fn new<A: Arm<N>>(
        config: &Config<A, N>,
        directions: &[Source],
        tangent: Tangent<V, N>,
    ) -> Self {
        let places = places(config);
        let mut plan: Vec<(Row, usize, [usize; MOST_LANES])> = Vec::new();
        let mut settling = [V::splat(0.0); N];
        let names = config.parameter_names();
        for (lane, direction) in directions.iter().take(V::LANES).enumerate() {
            let &Source::Parameter(k) = direction else {
                continue;
            };
            if names[k].0 == SETTLING {
                settling[places[k][0].joint].set_lane(lane, 1.0);
            }
            for place in &places[k] {
                let known = plan
                    .iter()
                    .position(|known| (known.0, known.1) == (place.row, place.joint));
                let at = known.unwrap_or_else(|| {
                    plan.push((place.row, place.joint, [0; MOST_LANES]));
                    plan.len() - 1
                });
                plan[at].2[lane] = place.entry;
            }
        }
        Self {
            tangent,
            forcing: [[[V::splat(0.0); 4]; N]; 3],
            plan,
            settling,
        }
    }

    /// Takes the parameters' own part of a step's equations.
    #[inline(always)]
    pub(crate) fn force<A: Arm<N>, L: Real>(&mut self, step: &Linearised<A, L, N>) {
        for (row, joint, pick) in &self.plan {
            self.forcing[*row as usize][*joint] = V::transposed(&step.entries, pick);
        }
    }

    /// The equations of stage `k`.
    #[inline(always)]
    pub(crate) fn respond<A: Arm<N>, L: Real>(
        &self,
        step: &Linearised<A, L, N>,
        k: usize,
        x: &Tangent<V, N>,
        torque: Option<&[V; N]>,
    ) -> Response<V, N> {
        let c = V::splat;
        let zero = [c(0.0); N];
        let mut response = Response {
            gear: zero,
            twist: zero,
            link: zero,
        };
        for i in 0..N {
            let gear = self.forcing[Row::Gear as usize][i][k];
            let damped = c(step.damping[i]).mul_add(x.rate[i], gear);
            response.gear[i] = c(step.stiffness[i][k]).mul_add(x.twist[i], damped);
            let mut motor = self.forcing[Row::Motor as usize][i][k];
            if let Some(torque) = torque {
                motor = c(step.motor[2][i]).mul_add(torque[i], motor);
            }
            let dragged = c(step.motor[1][i]).mul_add(x.rate[i] + x.velocity[i], motor);
            response.twist[i] = c(step.motor[0][i]).mul_add(response.gear[i], dragged);
        }
        for i in 0..N {
            let mut link = self.forcing[Row::Links as usize][i][k];
            for j in 0..N {
                if A::FELT[j] {
                    link = c(step.by_angle[i][j][k]).mul_add(x.angle[j], link);
                }
                link = c(step.by_velocity[i][j][k]).mul_add(x.velocity[j], link);
            }
            // what takes longest to know comes last
            for j in 0..N {
                link = c(step.inverse[i][j][k]).mul_add(response.gear[j], link);
            }
            response.link[i] = link;
            response.twist[i] = response.twist[i] - link;
        }
        response
    }

    /// The rest of the step, of length `h`, after its first stage.
    #[inline(always)]
    pub(crate) fn advance<A: Arm<N>, L: Real>(
        &mut self,
        step: &Linearised<A, L, N>,
        first: &Response<V, N>,
        torque: Option<&StepTorque<V, N>>,
        h: f64,
    ) {
        let c = V::splat;
        let half = 0.5 * h;
        let x = self.tangent;
        let middle = torque.map(|torque| &torque.middle);
        let end = torque.map(|torque| &torque.end);
        let at = self.held(step, x.drifted::<A>(half, first), 0);
        let second = self.respond(step, 1, &at, middle);
        let at = self.held(step, x.moved::<A>(half, half * half, first, &second), 0);
        let third = self.respond(step, 2, &at, middle);
        let at = self.held(step, x.moved::<A>(h, h * half, &second, &third), 1);
        let fourth = self.respond(step, 3, &at, end);
        let sixth = h / 6.0;
        let (for_angle, for_velocity) = first.sums(&second, &third, &fourth);
        let mut to = x;
        for i in 0..N {
            to.twist[i] = c(h).mul_add(x.rate[i], x.twist[i]);
            to.twist[i] = c(h * sixth).mul_add(for_angle[0][i], to.twist[i]);
            to.angle[i] = c(h).mul_add(x.velocity[i], x.angle[i]);
            to.angle[i] = c(h * sixth).mul_add(for_angle[1][i], to.angle[i]);
            to.rate[i] = c(sixth).mul_add(for_velocity[0][i], x.rate[i]);
            to.velocity[i] = c(sixth).mul_add(for_velocity[1][i], x.velocity[i]);
        }
        self.tangent = self.held(step, to, 1);
    }

    /// How fast the end of a step of length `h` moves as it gets longer; for a column that no
    /// parameter forces.
    #[inline(always)]
    pub(crate) fn lengthened<A: Arm<N>, L: Real>(
        &self,
        step: &Linearised<A, L, N>,
        by: &Lengthening<V, N>,
        h: f64,
    ) -> Tangent<V, N> {
        let c = V::splat;
        let [second, mut third, mut fourth] = by.stages;
        let (half, sixth) = (c(0.5 * h), h / 6.0);
        let [middle, end] = &by.torque;
        let a2 = self.respond(step, 1, &second, Some(middle));
        third.push(half, &a2);
        let a3 = self.respond(step, 2, &third, Some(middle));
        fourth.shift(c(0.5 * h * h), &a2);
        fourth.push(c(h), &a3);
        let a4 = self.respond(step, 3, &fourth, Some(end));
        let mut to = by.end;
        for a in [&a2, &a3] {
            to.shift(c(h * sixth), a);
            to.push(c(2.0 * sixth), a);
        }
        to.push(c(sixth), &a4);
        to
    }

    /// A later stage, half a step or a whole one on, in which held motors have settled.
    #[inline(always)]
    fn held<A: Arm<N>, L: Real>(
        &self,
        step: &Linearised<A, L, N>,
        mut stage: Tangent<V, N>,
        part: usize,
    ) -> Tangent<V, N> {
        let c = V::splat;
        for i in 0..N {
            let Some(settling) = &step.settling[i] else {
                continue;
            };
            // n dtheta_M' at the beginning of the step
            let motor = self.tangent.rate[i] + self.tangent.velocity[i];
            let [by_time, velocity_by_time] = settling.by_time.map(|parts| c(parts[part]));
            stage.twist[i] = c(settling.angle[part]).mul_add(motor, stage.twist[i]);
            stage.twist[i] = by_time.mul_add(self.settling[i], stage.twist[i]);
            stage.rate[i] = c(settling.velocity[part]).mul_add(motor, stage.rate[i]);
            stage.rate[i] = velocity_by_time.mul_add(self.settling[i], stage.rate[i]);
        }
        stage
    }
}

impl<V: Real, const N: usize> Tangent<V, N> {
    /// Nothing moves.
    pub(crate) fn still() -> Self {
        let zero = [V::splat(0.0); N];
        Self {
            twist: zero,
            rate: zero,
            angle: zero,
            velocity: zero,
        }
    }

    /// Accelerated for a time.
    #[inline(always)]
    fn push(&mut self, time: V, a: &Response<V, N>) {
        for i in 0..N {
            self.rate[i] = time.mul_add(a.twist[i], self.rate[i]);
            self.velocity[i] = time.mul_add(a.link[i], self.velocity[i]);
        }
    }

    /// Moved by what acceleration makes of positions, `square` the half of a time's square or so.
    #[inline(always)]
    fn shift(&mut self, square: V, a: &Response<V, N>) {
        for i in 0..N {
            self.twist[i] = square.mul_add(a.twist[i], self.twist[i]);
            self.angle[i] = square.mul_add(a.link[i], self.angle[i]);
        }
    }

    /// Moves on by `time` at the given rates.
    #[inline(always)]
    pub(crate) fn add<S: Real>(&mut self, rates: &Tangent<S, N>, time: V) {
        let c = |rate: S| V::splat(rate.lane(0));
        for i in 0..N {
            self.twist[i] = c(rates.twist[i]).mul_add(time, self.twist[i]);
            self.rate[i] = c(rates.rate[i]).mul_add(time, self.rate[i]);
            self.angle[i] = c(rates.angle[i]).mul_add(time, self.angle[i]);
            self.velocity[i] = c(rates.velocity[i]).mul_add(time, self.velocity[i]);
        }
    }

    /// As the `State`'s of the same name, for the link angles that are felt.
    #[inline(always)]
    fn drifted<A: Arm<N>>(&self, t: f64, a: &Response<V, N>) -> Self {
        let t = V::splat(t);
        let mut next = *self;
        for i in 0..N {
            next.twist[i] = t.mul_add(self.rate[i], self.twist[i]);
            next.rate[i] = t.mul_add(a.twist[i], self.rate[i]);
            next.velocity[i] = t.mul_add(a.link[i], self.velocity[i]);
            if A::FELT[i] {
                next.angle[i] = t.mul_add(self.velocity[i], self.angle[i]);
            }
        }
        next
    }

    /// The same, with what the accelerations `a` of an earlier stage add to the positions.
    #[inline(always)]
    fn moved<A: Arm<N>>(&self, t: f64, s: f64, a: &Response<V, N>, b: &Response<V, N>) -> Self {
        let mut next = self.drifted::<A>(t, b);
        let s = V::splat(s);
        for i in 0..N {
            next.twist[i] = s.mul_add(a.twist[i], next.twist[i]);
            if A::FELT[i] {
                next.angle[i] = s.mul_add(a.link[i], next.angle[i]);
            }
        }
        next
    }
}

impl<V: Real, const N: usize> Response<V, N> {
    /// a1 + a2 + a3 and a1 + 2 a2 + 2 a3 + a4, of twists and links.
    #[inline(always)]
    fn sums(&self, second: &Self, third: &Self, fourth: &Self) -> ([[V; N]; 2], [[V; N]; 2]) {
        let zero = [V::splat(0.0); N];
        let mut sums = ([zero; 2], [zero; 2]);
        for i in 0..N {
            let inner = second.twist[i] + third.twist[i];
            sums.0[0][i] = self.twist[i] + inner;
            sums.1[0][i] = sums.0[0][i] + inner + fourth.twist[i];
            let inner = second.link[i] + third.link[i];
            sums.0[1][i] = self.link[i] + inner;
            sums.1[1][i] = sums.0[1][i] + inner + fourth.link[i];
        }
        sums
    }
}
