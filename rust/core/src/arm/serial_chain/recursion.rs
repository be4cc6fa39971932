//! Recursions along a chain, each link in its own frame: the motion of the links, and joint twists
//! for quantities that are linear in them.

use super::placement::{JointPosture, Placement};
use super::posture::Posture;
use super::vector::{Vector, cross, dot, plus, scaled, splat, times_transposed};
use super::{LINK_PARAMETER_COUNT, SerialChain};
use crate::arm::Arm;
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
        let (turn, axis, origin) = (&at.rotation, splat(&joint.axis), at.origin);
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

impl<const N: usize, const KNOWN: bool> SerialChain<N, KNOWN> {
    /// Outward recursion: motion of the links.
    #[inline(always)]
    pub(super) fn motions<R: Real>(
        &self,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> [LinkMotion<R>; N] {
        let mut motion = LinkMotion::of_base(&self.gravity);
        let mut all = [motion; N];
        for i in 0..self.joints() {
            motion = motion.of_next(&self.joints[i], &self.joint_at(at, i), dq[i], ddq[i]);
            all[i] = motion;
        }
        all
    }

    /// Transforms the twists of the preceding joints to the frame of link `i` and adds its own
    /// joint's.
    #[inline(always)]
    fn extend<R: Real>(&self, at: &Posture<R>, i: usize, twists: &mut [Twist<R>; N]) {
        let JointPosture { rotation, origin } = self.joint_at(at, i);
        for twist in &mut twists[..i] {
            let moving = plus(&twist.moving, &cross(&twist.turning, &origin));
            twist.moving = times_transposed(&rotation, &moving);
            twist.turning = times_transposed(&rotation, &twist.turning);
        }
        let (axis, zero) = (splat(&self.joints[i].axis), [R::splat(0.0); 3]);
        let (turning, moving) = if self.joints[i].is_revolute() {
            (axis, zero)
        } else {
            (zero, axis)
        };
        twists[i] = Twist { turning, moving };
    }

    /// Sets the torques per inertial parameter of each link: the joint's twist of the link times the
    /// wrench per parameter. Those of joints behind the link remain zero.
    #[inline(always)]
    pub(super) fn set_torques_per_parameter<R: Real>(
        &self,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
        torques: &mut [[[R; N]; LINK_PARAMETER_COUNT]; N],
    ) {
        let motions = self.motions(at, dq, ddq);
        let zero = [R::splat(0.0); 3];
        let (turning, moving) = (zero, zero);
        let mut twists = [Twist { turning, moving }; N];
        for k in 0..self.joints() {
            self.extend(at, k, &mut twists);
            for j in 0..=k {
                let by = per_parameter(&twists[j], &motions[k]);
                for p in 0..LINK_PARAMETER_COUNT {
                    torques[k][p][j] = by[p];
                }
            }
        }
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
    // no closures, each of which would be a call
    let mut second = [[u[0]; 3]; 3];
    for i in 0..3 {
        second[i][i] = w[i].mul_add(turning[i], u[i] * rate[i]);
        for j in 0..i {
            let by_rate = u[i].mul_add(rate[j], u[j] * rate[i]);
            second[i][j] = w[i].mul_add(turning[j], w[j].mul_add(turning[i], by_rate));
        }
    }
    let [[xx, _, _], [xy, yy, _], [xz, yz, zz]] = second;
    [dot(v, force), h[0], h[1], h[2], xx, xy, yy, xz, yz, zz]
}
