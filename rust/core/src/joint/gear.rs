//! The gear as a spring and damper.

use crate::scalar::Real;

/// Half width [rad] over which a knee of the three-slope spring is rounded.
///
/// A corner that is rounded over +-w by a parabola departs from the sharp one by at most
/// `(K2 - K1) w / 4`: 0.01 N m for the stiffest knee of a size 20 gear and this width, a four
/// hundredth of its first knee's torque.
pub const CORNER: f64 = 5e-6;

/// The elastic law T(delta) of one gear, Fig. 2: slope K1 up to the torque T1, K2 up to T2, K3
/// beyond, odd in delta.
#[derive(Clone, Copy, Debug)]
pub struct Spring<R> {
    k1: R,
    knees: [Knee<R>; 2],
}

/// Where the slope changes, and by how much.
#[derive(Clone, Copy, Debug)]
struct Knee<R> {
    shift: R,        // w - d: moves the beginning of the rounded corner to zero
    width: R,        // 2 w
    half_rise: R,    // (slope change) / (4 w)
    slope_change: R, // K_{j+1} - K_j
    per_width: R,    // 1 / (4 w)
}

/// 1/K1 and 1/K2, and how fast the knees come in as K1 and K2 rise.
#[derive(Clone, Copy, Debug)]
pub struct PerSlope<R> {
    k1: R,
    k2: R,
    first_knee_by_k1: R,
    second_knee_by_k2: R,
}

impl<R: Real> Spring<R> {
    /// T = K delta: three slopes that are one, exactly, since its knees change nothing.
    #[inline(always)]
    pub fn linear(stiffness: R) -> Self {
        let one = R::splat(1.0);
        Self::three_slope([stiffness; 3], [one, one + one], CORNER)
    }

    /// Three slopes and the torques at which they change.
    #[inline(always)]
    pub fn three_slope(slopes: [R; 3], knee_torques: [R; 2], corner: f64) -> Self {
        let first = knee_torques[0] / slopes[0];
        let second = first + (knee_torques[1] - knee_torques[0]) / slopes[1];
        let knee = |at: R, change: R| Knee {
            shift: R::splat(corner) - at,
            width: R::splat(2.0 * corner),
            half_rise: change * R::splat(0.25 / corner),
            slope_change: change,
            per_width: R::splat(0.25 / corner),
        };
        Self {
            k1: slopes[0],
            knees: [
                knee(first, slopes[1] - slopes[0]),
                knee(second, slopes[2] - slopes[1]),
            ],
        }
    }

    /// Elastic torque at a twist `delta` [rad], in N m at the link.
    #[inline(always)]
    pub fn torque(&self, delta: R) -> R {
        let twist = delta.abs();
        let mut torque = self.k1 * twist;
        for knee in &self.knees {
            torque = knee.add_to(torque, twist);
        }
        torque.copysign(delta)
    }

    /// Potential energy stored at a twist `delta` [rad], in J.
    #[inline(always)]
    pub fn energy(&self, delta: R) -> R {
        let twist = delta.abs();
        let mut energy = R::splat(0.5) * self.k1 * twist * twist;
        for knee in &self.knees {
            energy = energy + knee.energy(twist);
        }
        energy
    }

    /// Slope of the torque at a twist `delta` [rad], in N m/rad.
    #[inline(always)]
    pub fn stiffness(&self, delta: R) -> R {
        let twist = delta.abs();
        let mut slope = self.k1;
        for knee in &self.knees {
            slope = slope + knee.slope(twist);
        }
        slope
    }

    /// How the torque at a twist depends on K1, K2, K3, T1 and T2.
    #[inline(always)]
    pub fn by_parameters(&self, delta: R, per: &PerSlope<R>) -> [R; 5] {
        let one = R::splat(1.0).copysign(delta);
        let twist = delta.abs();
        let (first, second) = (self.knees[0].ramp(twist), self.knees[1].ramp(twist));
        // How the torque falls where a knee moves out.
        let two_out = one * self.knees[1].slope(twist);
        let both_out = one.mul_add(self.knees[0].slope(twist), two_out);
        let k1 = one.mul_add(twist - first, both_out * per.first_knee_by_k1);
        let k2 = one.mul_add(first - second, two_out * per.second_knee_by_k2);
        let t1 = two_out.mul_add(per.k2, -(both_out * per.k1));
        [k1, k2, one * second, t1, -(two_out * per.k2)]
    }

    /// What [`Spring::by_parameters`] needs: divisions that every twist shares.
    pub fn per_slope(&self) -> PerSlope<R> {
        let one = R::splat(1.0);
        let k2 = one / (self.k1 + self.knees[0].slope_change);
        let at = |knee: &Knee<R>| R::splat(0.5) * knee.width - knee.shift;
        let (first, second) = (at(&self.knees[0]), at(&self.knees[1]));
        PerSlope {
            k1: one / self.k1,
            k2,
            first_knee_by_k1: first / self.k1,
            second_knee_by_k2: (second - first) * k2,
        }
    }

    /// The twist [rad] at which the spring gives a torque [N m]: the inverse of [`Spring::torque`].
    ///
    /// Newton's iteration inside a bracket that is halved wherever a step leaves it or does not
    /// halve the excess: between a steep slope and a flat one the bare iteration can go round for
    /// ever.
    pub fn twist(&self, torque: R) -> R {
        const { assert!(R::LANES == 1) };
        let second = self.k1 + self.knees[0].slope_change;
        let least = self.k1.min(second).min(second + self.knees[1].slope_change);
        let wanted = torque.abs();
        let (mut low, mut high) = (R::splat(0.0), wanted / least);
        let mut twist = high;
        let mut excess = self.torque(twist) - wanted;
        for _ in 0..200 {
            if excess.any_negative() {
                low = twist;
            } else {
                high = twist;
            }
            let mut next = twist - excess / self.stiffness(twist);
            if (next - twist).lane(0).abs() <= 1e-15 * next.lane(0) {
                break;
            }
            let mut left = self.torque(next) - wanted;
            let outside = (next - low).any_negative() || (high - next).any_negative();
            if outside || left.lane(0).abs() > 0.5 * excess.lane(0).abs() {
                next = R::splat(0.5) * (low + high);
                left = self.torque(next) - wanted;
            }
            (twist, excess) = (next, left);
        }
        let twist = R::root(twist.lane(0), |twist| self.torque(twist) - wanted);
        twist.copysign(torque)
    }
}

impl<R: Real> Knee<R> {
    /// Adds `change * ramp(twist - d)`: zero before the corner, a parabola in it, straight beyond.
    #[inline(always)]
    fn add_to(&self, torque: R, twist: R) -> R {
        let into = (twist + self.shift).max(R::splat(0.0));
        let inside = into.min(self.width);
        let torque = (self.half_rise * inside).mul_add(inside, torque);
        self.slope_change.mul_add(into - inside, torque)
    }

    /// What `add_to` adds per change of slope.
    #[inline(always)]
    fn ramp(&self, twist: R) -> R {
        let into = (twist + self.shift).max(R::splat(0.0));
        let inside = into.min(self.width);
        (self.per_width * inside).mul_add(inside, into - inside)
    }

    /// Slope of what `add_to` adds.
    #[inline(always)]
    fn slope(&self, twist: R) -> R {
        let inside = (twist + self.shift).max(R::splat(0.0)).min(self.width);
        R::splat(2.0) * self.half_rise * inside
    }

    /// Integral of what `add_to` adds, from no twist.
    #[inline(always)]
    fn energy(&self, twist: R) -> R {
        let into = (twist + self.shift).max(R::splat(0.0));
        let inside = into.min(self.width);
        let beyond = into - inside;
        let corner = self.half_rise * inside * inside;
        let third = R::splat(1.0 / 3.0);
        let half = R::splat(0.5);
        corner * inside * third + beyond * (corner + half * self.slope_change * beyond)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sharp(k: [f64; 3], t: [f64; 2], delta: f64) -> f64 {
        let d1 = t[0] / k[0];
        let d2 = d1 + (t[1] - t[0]) / k[1];
        let x = delta.abs();
        let torque = if x < d1 {
            k[0] * x
        } else if x < d2 {
            t[0] + k[1] * (x - d1)
        } else {
            t[1] + k[2] * (x - d2)
        };
        torque.copysign(delta)
    }

    proptest! {
        #[test]
        fn follows_the_sharp_law_but_for_its_corners(
            k1 in 1e3..3e4, ratio2 in 0.7..2.0, ratio3 in 0.7..2.0,
            t1 in 1.0..20.0, more in 1.0..30.0, delta in -5e-3..5e-3,
        ) {
            let k = [k1, k1 * ratio2, k1 * ratio2 * ratio3];
            let t = [t1, t1 + more];
            let spring = Spring::three_slope(k, t, CORNER);
            let bound = 0.25 * CORNER * (f64::abs(k[1] - k[0]) + f64::abs(k[2] - k[1]));
            prop_assert!((spring.torque(delta) - sharp(k, t, delta)).abs() <= bound + 1e-10);
            prop_assert_eq!(spring.torque(-delta), -spring.torque(delta));
        }

        #[test]
        fn torque_is_the_slope_of_its_energy(delta in -3e-3..3e-3) {
            let spring = Spring::three_slope([16e3, 25e3, 29e3], [7.0, 25.0], CORNER);
            let h = 1e-7;
            let slope = (spring.energy(delta + h) - spring.energy(delta - h)) / (2.0 * h);
            // A central difference of a parabola of curvature (K2 - K1) / (2 w) is off by h^2 / 6 of it.
            prop_assert!((slope - spring.torque(delta)).abs() < 3e-6);
        }

        #[test]
        fn the_twist_is_where_the_torque_is(
            k1 in 1e3..3e4, ratio2 in 0.1..10.0, ratio3 in 0.1..10.0,
            t1 in 1.0..20.0, more in 1.0..30.0, torque in -80.0..80.0,
        ) {
            let k = [k1, k1 * ratio2, k1 * ratio2 * ratio3];
            let spring = Spring::three_slope(k, [t1, t1 + more], CORNER);
            let twist: f64 = spring.twist(torque);
            prop_assert!((spring.torque(twist) - torque).abs() < 1e-12 * (1.0 + torque.abs()));
        }
    }

    #[test]
    fn the_twist_is_found_where_the_bare_iteration_goes_round() {
        let spring = Spring::three_slope([1e3, 8.1e3, 0.81e3], [10.5, 32.9], CORNER);
        let twist: f64 = spring.twist(23.2);
        assert!((spring.torque(twist) - 23.2).abs() < 1e-12);
    }
}
