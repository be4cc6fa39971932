//! Derivatives of the motion in some directions, and of the accelerations that follow from it.

use crate::arm::Arm;
use crate::scalar::Real;

/// Derivatives of twists and link angles, and of the motors' and links' velocities.
///
/// Time runs in half steps of the integrator here, and motors turn as the links do that they would
/// drive without gears that give way: a velocity times half a step is an angle, so that a stage is
/// mostly the sum of the last one and its rates.
#[derive(Clone, Copy)]
pub(crate) struct Tangent<V, const N: usize> {
    pub(crate) twist: [V; N],
    pub(crate) angle: [V; N],
    /// n dtheta_M' times half a step.
    pub(crate) motor: [V; N],
    /// dtheta_L' times half a step.
    pub(crate) link: [V; N],
}

/// Derivatives of what the state brings about at once.
#[derive(Clone, Copy)]
pub(crate) struct Response<V, const N: usize> {
    /// Gear torques [N m].
    pub(crate) gear: [V; N],
    /// Twist rates times half a step.
    pub(crate) rate: [V; N],
    /// n ddtheta_M' times half a step squared.
    pub(crate) motor: [V; N],
    /// ddtheta_L' times half a step squared.
    pub(crate) link: [V; N],
}

impl<V: Real, const N: usize> Tangent<V, N> {
    /// Nothing moves.
    pub(crate) fn still() -> Self {
        let zero = [V::splat(0.0); N];
        Self {
            twist: zero,
            angle: zero,
            motor: zero,
            link: zero,
        }
    }

    /// Accelerated for a time.
    #[inline(always)]
    pub(crate) fn push(&mut self, time: V, a: &Response<V, N>) {
        for i in 0..N {
            self.motor[i] = time.mul_add(a.motor[i], self.motor[i]);
            self.link[i] = time.mul_add(a.link[i], self.link[i]);
        }
    }

    /// Moved by what acceleration makes of positions, `square` the half of a time's square or so.
    #[inline(always)]
    pub(crate) fn shift(&mut self, square: V, a: &Response<V, N>) {
        for i in 0..N {
            self.twist[i] = square.mul_add(a.motor[i] - a.link[i], self.twist[i]);
            self.angle[i] = square.mul_add(a.link[i], self.angle[i]);
        }
    }

    /// Moves on by `time` at the given rates.
    #[inline(always)]
    pub(crate) fn add<S: Real>(&mut self, rates: &Tangent<S, N>, time: V) {
        let c = |rate: S| V::splat(rate.lane(0));
        for i in 0..N {
            self.twist[i] = c(rates.twist[i]).mul_add(time, self.twist[i]);
            self.angle[i] = c(rates.angle[i]).mul_add(time, self.angle[i]);
            self.motor[i] = c(rates.motor[i]).mul_add(time, self.motor[i]);
            self.link[i] = c(rates.link[i]).mul_add(time, self.link[i]);
        }
    }

    /// A later stage: `on` at the velocities of the stage `at` and its accelerations. Of the link
    /// angles those that are felt.
    #[inline(always)]
    pub(crate) fn moved<A: Arm<N>>(
        &self,
        on: impl Fn(V, V) -> V,
        at: &Tangent<V, N>,
        a: &Response<V, N>,
    ) -> Self {
        let mut next = *self;
        for i in 0..N {
            next.twist[i] = on(self.twist[i], a.rate[i]);
            next.motor[i] = on(self.motor[i], a.motor[i]);
            next.link[i] = on(self.link[i], a.link[i]);
            if A::FELT[i] {
                next.angle[i] = on(self.angle[i], at.link[i]);
            }
        }
        next
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
    fn plus(mut self, motor: &[V; N], link: &[V; N]) -> Self {
        for i in 0..N {
            self.motor[i] = self.motor[i] + motor[i];
            self.link[i] = self.link[i] + link[i];
        }
        self
    }
}

impl<V: Real, const N: usize> Response<V, N> {
    /// a1 + a2 + a3, by which places move, and with a2 + a3 once more, which velocities add a4 to.
    #[inline(always)]
    pub(crate) fn sums(&self, second: &Self, third: &Self) -> [Sum<V, N>; 2] {
        let Self { motor, link, .. } = *second;
        let inner = Sum { motor, link }.plus(&third.motor, &third.link);
        let places = inner.plus(&self.motor, &self.link);
        [places, places.plus(&inner.motor, &inner.link)]
    }
}
