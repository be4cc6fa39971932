//! Recursions along a chain, each link in its own frame: Newton and Euler's for torques, and joint
//! twists for quantities that are linear in them.

use super::placement::{JointPosture, Placement};
use super::vector::{Matrix, Vector, cross, dot, plus, scaled, splat, times, times_transposed};
use super::{LINK_PARAMETER_COUNT, Posture, SerialChain};
use crate::scalar::Real;

/// Motion of a link in its own frame.
#[derive(Clone, Copy)]
pub(super) struct LinkMotion<R> {
    /// Angular velocity [rad/s].
    pub(super) rate: Vector<R>,
    /// Angular acceleration [rad/s^2].
    pub(super) turning: Vector<R>,
    /// Specific force [m/s^2] at its origin: acceleration minus gravity.
    pub(super) force: Vector<R>,
}

impl<R: Real> LinkMotion<R> {
    /// The base at rest, under an acceleration of gravity [m/s^2].
    #[inline(always)]
    pub(super) fn of_base(gravity: &Vector<f64>) -> Self {
        let zero = [R::splat(0.0); 3];
        Self {
            rate: zero,
            turning: zero,
            force: scaled(R::splat(-1.0), &splat(gravity), &zero),
        }
    }

    /// Motion of the link behind the next joint.
    #[inline(always)]
    pub(super) fn of_next(&self, joint: &Placement, at: &JointPosture<R>, dq: R, ddq: R) -> Self {
        let (turn, axis, origin) = (&at.rotation, splat(&joint.axis), joint.origin(at));
        let carried = plus(
            &cross(&self.turning, &origin),
            &cross(&self.rate, &cross(&self.rate, &origin)),
        );
        let force = times_transposed(turn, &plus(&self.force, &carried));
        let rate = times_transposed(turn, &self.rate);
        let turning = times_transposed(turn, &self.turning);
        // of the joint's own velocity: omega x a dq, once or twice
        let whirl = cross(&rate, &axis);
        if joint.is_revolute() {
            Self {
                rate: scaled(dq, &axis, &rate),
                turning: scaled(ddq, &axis, &scaled(dq, &whirl, &turning)),
                force,
            }
        } else {
            Self {
                rate,
                turning,
                force: scaled(ddq, &axis, &scaled(dq + dq, &whirl, &force)),
            }
        }
    }
}

/// Angular and linear velocity per velocity of a joint.
#[derive(Clone, Copy)]
struct Twist<R> {
    turning: Vector<R>,
    moving: Vector<R>,
}

/// m, m c and I about the link's origin.
struct Inertia<R> {
    mass: R,
    first_moment: Vector<R>,
    second_moment: Matrix<R>,
}

impl<R: Real> Inertia<R> {
    #[inline(always)]
    fn of(base: &[R; LINK_PARAMETER_COUNT]) -> Self {
        let [mass, x, y, z, xx, xy, yy, xz, yz, zz] = *base;
        Self {
            mass,
            first_moment: [x, y, z],
            second_moment: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
        }
    }

    /// Force and moment about the origin for given accelerations: f = m s + alpha x h, n = I alpha
    /// + h x s.
    #[inline(always)]
    fn accelerated(&self, turning: &Vector<R>, force: &Vector<R>) -> [Vector<R>; 2] {
        let h = &self.first_moment;
        [
            scaled(self.mass, force, &cross(turning, h)),
            plus(&times(&self.second_moment, turning), &cross(h, force)),
        ]
    }

    /// The same body in the frame of the preceding link: R I R' with the rotation R, moved by r, with
    /// 2 r w E - r w' - w r', w = R h + m r / 2.
    #[inline(always)]
    fn seen_from(&self, turn: &Matrix<R>, r: &Vector<R>) -> Self {
        let h = times(turn, &self.first_moment);
        let half = self.mass * R::splat(0.5);
        let (w, moved) = (scaled(half, r, &h), scaled(self.mass, r, &h));
        let columns = turn.map(|row| times(&self.second_moment, &row));
        let products = [r[0] * w[0], r[1] * w[1], r[2] * w[2]].map(|one| one + one);
        let mut second_moment = self.second_moment;
        for i in 0..3 {
            for j in i..3 {
                let rotated = dot(&turn[i], &columns[j]);
                second_moment[i][j] = if i == j {
                    rotated + (products[(i + 1) % 3] + products[(i + 2) % 3])
                } else {
                    rotated - r[i].mul_add(w[j], r[j] * w[i])
                };
                second_moment[j][i] = second_moment[i][j];
            }
        }
        Self {
            mass: self.mass,
            first_moment: moved,
            second_moment,
        }
    }

    /// Adds another body in the same frame.
    #[inline(always)]
    fn add(&mut self, other: &Self) {
        self.mass = self.mass + other.mass;
        self.first_moment = plus(&self.first_moment, &other.first_moment);
        for i in 0..3 {
            self.second_moment[i] = plus(&self.second_moment[i], &other.second_moment[i]);
        }
    }

    /// Force and moment of a motion, with the terms of the velocity: f += omega x (omega x h), n +=
    /// omega x I omega.
    #[inline(always)]
    fn wrench(&self, motion: &LinkMotion<R>) -> [Vector<R>; 2] {
        let [force, moment] = self.accelerated(&motion.turning, &motion.force);
        let (h, omega) = (&self.first_moment, &motion.rate);
        let spin = times(&self.second_moment, omega);
        [
            plus(&force, &cross(omega, &cross(omega, h))),
            plus(&moment, &cross(omega, &spin)),
        ]
    }
}

impl<const N: usize> SerialChain<N> {
    /// Outward recursion: motion of the links.
    #[inline(always)]
    pub(super) fn motions<R: Real>(
        &self,
        at: &Posture<R, N>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [LinkMotion<R>; N] {
        let mut motion = LinkMotion::of_base(&self.gravity);
        let mut all = [motion; N];
        for i in 0..self.count {
            motion = motion.of_next(&self.joints[i], &at[i], dq[i], ddq[i]);
            all[i] = motion;
        }
        all
    }

    /// Inward recursion: joint torques of a motion.
    #[inline(always)]
    pub(super) fn newton_euler<R: Real>(
        &self,
        base: &[[R; LINK_PARAMETER_COUNT]; N],
        at: &Posture<R, N>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [R; N] {
        let motions = self.motions(at, dq, ddq);
        let zero = [R::splat(0.0); 3];
        let (mut force, mut moment) = (zero, zero);
        let mut torque = [R::splat(0.0); N];
        for i in (0..self.count).rev() {
            let [own_force, own_moment] = Inertia::of(&base[i]).wrench(&motions[i]);
            (force, moment) = (plus(&force, &own_force), plus(&moment, &own_moment));
            torque[i] = self.along_axis(i, &force, &moment);
            let (turn, origin) = (&at[i].rotation, self.joints[i].origin(&at[i]));
            force = times(turn, &force);
            moment = plus(&times(turn, &moment), &cross(&origin, &force));
        }
        torque
    }

    /// Transforms the twists of the preceding joints to the frame of link `i` and adds its own
    /// joint's.
    #[inline(always)]
    fn extend<R: Real>(&self, at: &Posture<R, N>, i: usize, twists: &mut [Twist<R>; N]) {
        let (turn, origin) = (&at[i].rotation, self.joints[i].origin(&at[i]));
        for twist in &mut twists[..i] {
            let moving = plus(&twist.moving, &cross(&twist.turning, &origin));
            twist.moving = times_transposed(turn, &moving);
            twist.turning = times_transposed(turn, &twist.turning);
        }
        let (axis, zero) = (splat(&self.joints[i].axis), [R::splat(0.0); 3]);
        let (turning, moving) = if self.joints[i].is_revolute() {
            (axis, zero)
        } else {
            (zero, axis)
        };
        twists[i] = Twist { turning, moving };
    }

    /// Inertia matrix by composite rigid bodies (Featherstone, Rigid Body Dynamics Algorithms, 2008,
    /// section 6.2): the links behind a joint as one body, accelerated by that joint.
    #[inline(always)]
    pub(super) fn mass_matrix<R: Real>(
        &self,
        base: &[[R; LINK_PARAMETER_COUNT]; N],
        at: &Posture<R, N>,
    ) -> [[R; N]; N] {
        let zero = [R::splat(0.0); 3];
        let mut all = [[R::splat(0.0); N]; N];
        let mut body = Inertia::of(&base[self.count - 1]);
        for i in (0..self.count).rev() {
            let axis = splat(&self.joints[i].axis);
            let (turning, moving) = if self.joints[i].is_revolute() {
                (axis, zero)
            } else {
                (zero, axis)
            };
            let [mut force, mut moment] = body.accelerated(&turning, &moving);
            all[i][i] = self.along_axis(i, &force, &moment);
            for j in (0..i).rev() {
                let (turn, origin) = (&at[j + 1].rotation, self.joints[j + 1].origin(&at[j + 1]));
                force = times(turn, &force);
                moment = plus(&times(turn, &moment), &cross(&origin, &force));
                all[j][i] = self.along_axis(j, &force, &moment);
                all[i][j] = all[j][i];
            }
            if i > 0 {
                let origin = self.joints[i].origin(&at[i]);
                body = body.seen_from(&at[i].rotation, &origin);
                body.add(&Inertia::of(&base[i - 1]));
            }
        }
        all
    }

    /// Part of a force and a moment that acts on a joint.
    #[inline(always)]
    fn along_axis<R: Real>(&self, i: usize, force: &Vector<R>, moment: &Vector<R>) -> R {
        let axis = splat(&self.joints[i].axis);
        if self.joints[i].is_revolute() {
            dot(&axis, moment)
        } else {
            dot(&axis, force)
        }
    }

    /// Torques per inertial parameter of each link: the joint's twist of the link times the wrench
    /// per parameter.
    #[inline(always)]
    pub(super) fn torques_per_parameter<R: Real>(
        &self,
        at: &Posture<R, N>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [[[R; N]; LINK_PARAMETER_COUNT]; N] {
        let motions = self.motions(at, dq, ddq);
        let zero = [R::splat(0.0); 3];
        let (turning, moving) = (zero, zero);
        let mut twists = [Twist { turning, moving }; N];
        let mut all = [[[R::splat(0.0); N]; LINK_PARAMETER_COUNT]; N];
        for k in 0..self.count {
            self.extend(at, k, &mut twists);
            for j in 0..=k {
                let by = per_parameter(&twists[j], &motions[k]);
                for p in 0..LINK_PARAMETER_COUNT {
                    all[k][p][j] = by[p];
                }
            }
        }
        all
    }
}

/// w n + v f per parameter of a link, with its force f and moment n.
#[inline(always)]
fn per_parameter<R: Real>(twist: &Twist<R>, motion: &LinkMotion<R>) -> [R; LINK_PARAMETER_COUNT] {
    let (w, v) = (&twist.turning, &twist.moving);
    let LinkMotion {
        rate,
        turning,
        force,
    } = motion;
    // v (alpha x h) = h (v x alpha); v (omega x (omega x h)) = h ((v x omega) x omega);
    // w (h x s) = h (s x w); w (omega x I omega) = (w x omega) I omega
    let part_accelerations = plus(&cross(v, turning), &cross(&cross(v, rate), rate));
    let h = plus(&part_accelerations, &cross(force, w));
    let u = cross(w, rate);
    let diagonal = |i: usize| w[i].mul_add(turning[i], u[i] * rate[i]);
    let off = |i: usize, j: usize| {
        let by_rate = u[i].mul_add(rate[j], u[j] * rate[i]);
        w[i].mul_add(turning[j], w[j].mul_add(turning[i], by_rate))
    };
    [
        dot(v, force),
        h[0],
        h[1],
        h[2],
        diagonal(0),
        off(0, 1),
        diagonal(1),
        off(0, 2),
        off(1, 2),
        diagonal(2),
    ]
}
