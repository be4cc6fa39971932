//! Derivatives of the motion, and of the accelerations.

use crate::arm::Arm;
use crate::arm::transmission::torsion_of;
use crate::scalar::Real;

/// Derivatives of torsions and link angles, and of the velocities of motors and links.
///
/// Time is in half steps of the integrator, and motor angles are link-side: a velocity times half a
/// step is an angle, so most of a stage is a sum of the last one and its rates.
#[derive(Clone, Copy)]
pub(crate) struct Tangent<V, const N: usize> {
    pub(crate) torsion: [V; N],
    pub(crate) angle: [V; N],
    /// n dtheta_M' of each motor times half a step.
    pub(crate) motor: [V; N],
    /// dtheta_L' times half a step.
    pub(crate) link: [V; N],
}

/// Derivatives of torques and accelerations.
#[derive(Clone, Copy)]
pub(crate) struct Response<V, const N: usize> {
    /// Gear torques [N m], of the first stage only.
    pub(crate) gear: [V; N],
    /// n ddtheta_M' times half a step squared.
    pub(crate) motor: [V; N],
    /// ddtheta_L' times half a step squared.
    pub(crate) link: [V; N],
}

impl<V: Real, const N: usize> Tangent<V, N> {
    /// Zero derivatives.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        let zero = [V::splat(0.0); N];
        Self {
            torsion: zero,
            angle: zero,
            motor: zero,
            link: zero,
        }
    }

    /// Adds accelerations over a time.
    #[inline(always)]
    pub(crate) fn push(&mut self, time: V, a: &Response<V, N>) {
        for i in 0..N {
            self.motor[i] = time.mul_add(a.motor[i], self.motor[i]);
            self.link[i] = time.mul_add(a.link[i], self.link[i]);
        }
    }

    /// Adds the displacement of accelerations; `square` is half of the square of a time.
    #[inline(always)]
    pub(crate) fn shift<A: Arm<N>>(&mut self, arm: &A, square: V, a: &Response<V, N>) {
        for i in 0..N {
            let twist = torsion_of(arm, i, &a.motor, &a.link);
            self.torsion[i] = square.mul_add(twist, self.torsion[i]);
            self.angle[i] = square.mul_add(a.link[i], self.angle[i]);
        }
    }

    /// Advances by `time` at given rates.
    #[inline(always)]
    pub(crate) fn add<S: Real>(&mut self, rates: &Tangent<S, N>, time: V) {
        let c = |rate: S| V::splat(rate.lane(0));
        for i in 0..N {
            self.torsion[i] = c(rates.torsion[i]).mul_add(time, self.torsion[i]);
            self.angle[i] = c(rates.angle[i]).mul_add(time, self.angle[i]);
            self.motor[i] = c(rates.motor[i]).mul_add(time, self.motor[i]);
            self.link[i] = c(rates.link[i]).mul_add(time, self.link[i]);
        }
    }

    /// Becomes a later stage of a step from `begin`, after a time at the velocities of the stage `at`
    /// and the accelerations; without a time, after one half step. Advances only link angles on
    /// which the equations depend.
    #[inline(always)]
    pub(crate) fn become_stage<A: Arm<N>>(
        &mut self,
        arm: &A,
        begin: &Self,
        time: Option<V>,
        at: &Self,
        a: &Response<V, N>,
    ) {
        for i in 0..N {
            let rate = torsion_of(arm, i, &at.motor, &at.link);
            self.torsion[i] = advance(begin.torsion[i], rate, time);
            self.motor[i] = advance(begin.motor[i], a.motor[i], time);
            self.link[i] = advance(begin.link[i], a.link[i], time);
            self.angle[i] = match A::DEPENDS_ON_ANGLE[i] {
                true => advance(begin.angle[i], at.link[i], time),
                false => begin.angle[i],
            };
        }
    }
}

/// `x + time * rate`, or `x + rate` without a time. No closure, which might become a call.
#[inline(always)]
pub(crate) fn advance<V: Real>(x: V, rate: V, time: Option<V>) -> V {
    match time {
        Some(time) => time.mul_add(rate, x),
        None => x + rate,
    }
}

impl<V: Real, const N: usize> Response<V, N> {
    /// Zero derivatives.
    #[inline(always)]
    pub(crate) fn zero() -> Self {
        let zero = [V::splat(0.0); N];
        Self {
            gear: zero,
            motor: zero,
            link: zero,
        }
    }
}

/// Memory for the later stages of a step. It serves all blocks, because clearing and copying it for each
/// would take as long as the arithmetic.
pub(crate) struct Workspace<V, const N: usize> {
    pub(crate) stages: [Tangent<V, N>; 2],
    pub(crate) responses: [Response<V, N>; 3],
    pub(crate) sums: [Sum<V, N>; 2],
}

impl<V: Real, const N: usize> Workspace<V, N> {
    #[inline(always)]
    pub(crate) fn new() -> Self {
        Self {
            stages: [Tangent::zero(); 2],
            responses: [Response::zero(); 3],
            sums: [Sum::zero(); 2],
        }
    }
}

/// Sums of accelerations.
#[derive(Clone, Copy)]
pub(crate) struct Sum<V, const N: usize> {
    pub(crate) motor: [V; N],
    pub(crate) link: [V; N],
}

impl<V: Real, const N: usize> Sum<V, N> {
    #[inline(always)]
    fn zero() -> Self {
        let zero = [V::splat(0.0); N];
        Self {
            motor: zero,
            link: zero,
        }
    }
}

/// Sets a1 + a2 + a3, which displace positions, and a1 + 2 a2 + 2 a3, which with a4 change
/// velocities.
#[inline(always)]
pub(crate) fn set_sums<V: Real, const N: usize>(
    [positions, velocities]: &mut [Sum<V, N>; 2],
    [first, second, third]: [&Response<V, N>; 3],
) {
    for i in 0..N {
        let inner = second.motor[i] + third.motor[i];
        positions.motor[i] = inner + first.motor[i];
        velocities.motor[i] = positions.motor[i] + inner;
        let inner = second.link[i] + third.link[i];
        positions.link[i] = inner + first.link[i];
        velocities.link[i] = positions.link[i] + inner;
    }
}
