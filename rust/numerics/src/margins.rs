//! Stability margins of the responses of open loops.

use std::f64::consts::{PI, TAU};

/// Margins of one loop; frequencies are not numbers without a crossing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margins {
    /// Smallest change of the gain [dB], up or down, to the stability limit; infinite without one.
    pub gain_db: f64,
    /// Its frequency.
    pub gain_hz: f64,
    /// Smallest change of the phase [degrees] to the stability limit; infinite without one.
    pub phase_deg: f64,
    /// Its frequency.
    pub phase_hz: f64,
    /// Smallest distance from -1.
    pub modulus: f64,
    /// Its frequency.
    pub modulus_hz: f64,
    /// Highest frequency at which the gain is one; zero without one.
    pub bandwidth_hz: f64,
    /// Encirclements of -1, clockwise, over both signs of the frequency.
    pub encirclements: i64,
}

/// Margins of a loop (n_omega,), pairs of real and imaginary part, at frequencies [Hz].
///
/// Crossings are interpolated between neighbouring frequencies. The loop closes at its first
/// frequency through the lower half plane, as one with an integrator, and at the last one directly.
pub fn margins(response: &[[f64; 2]], hz: &[f64]) -> Margins {
    assert!(!hz.is_empty() && response.len() == hz.len());
    let mut margins = Margins {
        gain_db: f64::INFINITY,
        gain_hz: f64::NAN,
        phase_deg: f64::INFINITY,
        phase_hz: f64::NAN,
        modulus: f64::INFINITY,
        modulus_hz: f64::NAN,
        bandwidth_hz: 0.0,
        encirclements: 0,
    };
    let (first, last) = (response[0], response[response.len() - 1]);
    if first[1] > 0.0 {
        margins.encirclements += 2;
    }
    if last[0] < -1.0 {
        margins.encirclements -= sign(last[1]);
    }
    for (k, &[re, im]) in response.iter().enumerate() {
        let distance = (1.0 + re) * (1.0 + re) + im * im; // its square, up to the end
        if distance < margins.modulus {
            (margins.modulus, margins.modulus_hz) = (distance, hz[k]);
        }
    }
    margins.modulus = margins.modulus.sqrt();
    for (pair, hz) in response.windows(2).zip(hz.windows(2)) {
        let [begin, end] = [pair[0], pair[1]];
        if begin[1] * end[1] <= 0.0 {
            margins.cross_axis(begin, end, hz);
        }
        let beyond = |[re, im]: [f64; 2]| re * re + im * im - 1.0;
        if beyond(begin) * beyond(end) <= 0.0 {
            margins.cross_circle(begin, end, hz);
        }
    }
    margins
}

impl Margins {
    /// Distance of the gain from one where the loop crosses the negative real axis.
    fn cross_axis(&mut self, begin: [f64; 2], end: [f64; 2], hz: &[f64]) {
        let share = share_of_zero(begin[1], end[1]);
        let at_axis = begin[0] + share * (end[0] - begin[0]);
        if at_axis < -1.0 {
            self.encirclements += sign(end[1]) - sign(begin[1]);
        }
        let db = (20.0 * at_axis.abs().max(1e-300).log10()).abs();
        if at_axis < 0.0 && db < self.gain_db {
            (self.gain_db, self.gain_hz) = (db, hz[0] + share * (hz[1] - hz[0]));
        }
    }

    /// Distance of the phase from -180 degrees where the gain is one.
    fn cross_circle(&mut self, begin: [f64; 2], end: [f64; 2], hz: &[f64]) {
        let [before, after] = [begin, end].map(|[re, im]| re.hypot(im).max(1e-300).ln());
        let share = share_of_zero(before, after);
        let [re, im] = begin;
        let mut turn = (end[1] * re - end[0] * im).atan2(end[0] * re + end[1] * im);
        if begin == [0.0; 2] {
            turn = end[1].atan2(end[0]);
        }
        let phase = (-im).atan2(-re) + share * turn + PI;
        let degrees = (phase.rem_euclid(TAU) - PI).to_degrees().abs();
        self.bandwidth_hz = hz[0] + share * (hz[1] - hz[0]);
        if degrees < self.phase_deg {
            (self.phase_deg, self.phase_hz) = (degrees, self.bandwidth_hz);
        }
    }
}

/// Where in its interval a linear function is zero.
fn share_of_zero(begin: f64, end: f64) -> f64 {
    if end == begin {
        0.0
    } else {
        -begin / (end - begin)
    }
}

/// Minus one, zero or one.
fn sign(value: f64) -> i64 {
    i64::from(value > 0.0) - i64::from(value < 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// a / s e^(-s d) has its gain margin where the phase of the delay is 90 degrees, and its
        /// phase margin at the frequency a; coarse interpolation has an error of the grid's square.
        #[test]
        fn an_integrator_with_delay_has_closed_forms(a in 0.5..20.0f64, delay in 0.005..0.02f64) {
            let step: f64 = 1.001;
            let omega: Vec<f64> = (0..9000).map(|k| 0.1 * step.powi(k)).collect();
            let response = |omega: &f64| {
                let (sine, cosine) = (omega * delay).sin_cos();
                [-a / omega * sine, -a / omega * cosine]
            };
            let responses: Vec<[f64; 2]> = omega.iter().map(response).collect();
            let hz: Vec<f64> = omega.iter().map(|omega| omega / TAU).collect();
            let margins = margins(&responses, &hz);
            let axis = PI / 2.0 / delay;
            prop_assert!((margins.gain_db - 20.0 * (axis / a).log10()).abs() < 1e-3);
            prop_assert!((margins.gain_hz * TAU / axis - 1.0).abs() < 1e-5);
            prop_assert!((margins.phase_deg - (90.0 - (a * delay).to_degrees())).abs() < 1e-3);
            prop_assert!((margins.phase_hz * TAU / a - 1.0).abs() < 1e-5);
            prop_assert_eq!(margins.phase_hz, margins.bandwidth_hz);
            prop_assert_eq!(margins.encirclements, 0);
        }
    }

    #[test]
    fn a_small_loop_has_no_limits() {
        let margins = margins(&[[0.1, -0.2], [0.1, -0.1]], &[1.0, 2.0]);
        assert_eq!(margins.gain_db, f64::INFINITY);
        assert_eq!(margins.phase_deg, f64::INFINITY);
        assert_eq!(margins.bandwidth_hz, 0.0);
        assert!(margins.gain_hz.is_nan() && margins.phase_hz.is_nan());
    }
}
