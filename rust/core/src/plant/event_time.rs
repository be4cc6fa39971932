//! Times of friction events: roots of a margin as a function of the part of a span.
//!
//! Each evaluation is a step of the integrator, so few of them matter more than their bookkeeping.

/// Place at which the initial slope of a function is evaluated.
const SLOPE_PROBE: f64 = 1e-4;

/// A known part of a function: `size exp(-rate x)`.
#[derive(Clone, Copy, Default)]
pub(super) struct Decay {
    pub(super) size: f64,
    pub(super) rate: f64,
}

impl Decay {
    /// Value and slope.
    fn at(&self, x: f64) -> [f64; 2] {
        if self.size == 0.0 {
            return [0.0; 2];
        }
        let value = self.size * (-self.rate * x).exp();
        [value, -self.rate * value]
    }
}

/// The root on [0, 1] of a function that is negative at the end.
///
/// Each estimate is the root of the sum of a known part and the polynomial through all values so far,
/// and the `slope` at 0 if it is given. The value at the root is at most 1e-12 of those at the ends, or
/// its rounding error.
pub(super) fn root(
    mut f: impl FnMut(f64) -> f64,
    [begin, end]: [f64; 2],
    slope: Option<f64>,
    known: Decay,
) -> f64 {
    let tiny = 1e-12 * (begin.abs() + end.abs());
    let mut through = Polynomial::new((0.0, begin), known);
    if let Some(slope) = slope {
        through.add_slope(slope);
    }
    through.add(1.0, end);
    let (mut positive, mut negative) = ((0.0, begin), (1.0, end));
    if begin <= tiny {
        // The function begins at zero, or below where a torque jumps. If it increases from that
        // point, the root is beyond the maximum, which may be before half of the parabola's span.
        let slope = slope.unwrap_or_else(|| {
            let value = f(SLOPE_PROBE);
            through.add(SLOPE_PROBE, value);
            (value - begin) / SLOPE_PROBE
        });
        let bend = end - begin - slope;
        if slope <= 0.0 || begin < -1e3 * tiny || bend >= 0.0 {
            return 0.0;
        }
        let mut part = -0.5 * slope / bend;
        let mut value = f(part);
        while value <= tiny {
            negative = (part, value);
            part *= 0.25;
            if part < 1e-12 {
                return 0.0;
            }
            value = f(part);
        }
        positive = (part, value);
        through.add(part, value);
    }
    let mut last = (f64::INFINITY, f64::INFINITY);
    for _ in 0..60 {
        let next = through.root_between(positive, negative);
        let value = f(next);
        let change = (value / last.1).abs();
        let is_rounding =
            (next - last.0).abs() < NEGLIGIBLE_CHANGE * next && !(SLOW_PROGRESS.contains(&change));
        if value.abs() <= tiny || is_rounding {
            return next;
        }
        last = (next, value);
        if value > 0.0 {
            positive = (next, value);
        } else {
            negative = (next, value);
        }
        if !through.add(next, value) {
            through = Polynomial::new(positive, known);
            through.add(negative.0, negative.1);
            last = (f64::INFINITY, f64::INFINITY); // the next estimate is a coarse one again
        }
    }
    positive.0
}

/// Relative change of the estimate of a root after which only rounding may remain.
const NEGLIGIBLE_CHANGE: f64 = 1e-9;
/// Ratios of the last two values between which more than rounding remains: below, the next value would
/// be rounding; above, this one is.
const SLOW_PROGRESS: std::ops::Range<f64> = 1e-3..0.5;

/// Most steps to the root of a [`Polynomial`].
const MAX_NEWTON_STEPS: usize = 20;
/// Most nodes of a [`Polynomial`].
const MAX_NODES: usize = 8;

/// A known part and a polynomial, in Newton's form, through the values at some nodes.
struct Polynomial {
    known: Decay,
    coefficients: [f64; MAX_NODES],
    nodes: [f64; MAX_NODES],
    count: usize,
}

impl Polynomial {
    /// Through one value.
    fn new((node, value): (f64, f64), known: Decay) -> Self {
        let value = value - known.at(node)[0];
        Self {
            known,
            coefficients: [value; MAX_NODES],
            nodes: [node; MAX_NODES],
            count: 1,
        }
    }

    /// Adds the slope at the first node, as the second value.
    fn add_slope(&mut self, slope: f64) {
        self.coefficients[1] = slope - self.known.at(self.nodes[0])[1];
        self.count = 2;
    }

    /// Adds the value at another node; returns whether there was room.
    fn add(&mut self, node: f64, value: f64) -> bool {
        if self.count == MAX_NODES {
            return false;
        }
        let distances = self.nodes[..self.count].iter().map(|other| node - other);
        self.coefficients[self.count] = (value - self.at(node)[0]) / distances.product::<f64>();
        self.nodes[self.count] = node;
        self.count += 1;
        true
    }

    /// Value and slope.
    fn at(&self, x: f64) -> [f64; 2] {
        let [mut value, mut slope] = [0.0; 2];
        for k in (0..self.count).rev() {
            let distance = x - self.nodes[k];
            slope = slope * distance + value;
            value = value * distance + self.coefficients[k];
        }
        let known = self.known.at(x);
        [value + known[0], slope + known[1]]
    }

    /// A root between places with a positive and a negative value, by Newton's method from the root
    /// of the chord, and bisection where that leaves the bracket.
    fn root_between(&self, positive: (f64, f64), negative: (f64, f64)) -> f64 {
        let (mut low, mut high) = (positive.0, negative.0);
        let mut x = low + (high - low) * positive.1 / (positive.1 - negative.1);
        for _ in 0..MAX_NEWTON_STEPS {
            let [value, slope] = self.at(x);
            if value > 0.0 {
                low = x;
            } else {
                high = x;
            }
            let next = x - value / slope;
            if (next - x).abs() <= f64::EPSILON * x {
                break;
            }
            x = if next > low && next < high {
                next
            } else {
                0.5 * (low + high)
            };
        }
        x
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn few_evaluations_find_a_root(
            begin in 0.01..1.0f64, end in -1.0..-0.01f64, bend in -1.0..1.0f64,
            size in -2.0..2.0f64, rate in 0.0..8.0f64, is_known in any::<bool>(),
        ) {
            // the exponential less its chord, which leaves the values at the ends
            let exponential = |x: f64| (-rate * x).exp() - (1.0 - x) - x * (-rate).exp();
            let f = |x: f64| begin + (end - begin) * x + bend * x * (1.0 - x) + size * exponential(x);
            let known = if is_known { Decay { size, rate } } else { Decay::default() };
            let mut count = 0;
            let at = root(|x| { count += 1; f(x) }, [begin, end], None, known);
            prop_assert!((0.0..=1.0).contains(&at));
            prop_assert!(f(at).abs() < 1e-11, "{:e}", f(at));
            prop_assert!(count <= if is_known { 8 } else { 15 }, "{count}");
        }

        #[test]
        fn the_root_beyond_a_maximum_is_found(slope in 0.1..2.0f64, bend in 0.1..2.0f64) {
            // zero at 0 and at slope / (slope + bend)
            let f = |x: f64| slope * x - (slope + bend) * x * x;
            let at = root(f, [0.0, f(1.0)], None, Decay::default());
            prop_assert!((at - slope / (slope + bend)).abs() < 1e-9);
        }

        #[test]
        fn a_falling_function_that_begins_at_zero_has_its_root_there(slope in -2.0..-0.1f64) {
            let at = root(|x| slope * x, [0.0, slope], Some(slope), Decay::default());
            prop_assert_eq!(at, 0.0);
        }
    }
}
