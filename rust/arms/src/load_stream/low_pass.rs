//! Low-pass of four equal poles, whose stages give the derivatives of its output.

/// Frequency at which the power has fallen to one half, over that of the poles.
pub const BANDWIDTH_OF_POLES: f64 = 0.434_979_2; // sqrt(2^(1/4) - 1)
const STAGES: usize = 4;

/// Low-pass of many signals by the bilinear transform.
///
/// A stage (1 + s / w) y = x has s y = w (x - y), for the bilinear s as well: differences of stages
/// are exact derivatives of the output.
#[derive(Clone, Debug)]
pub struct LowPass {
    pole: f64,
    keep: f64,
    take: f64,
    /// Last input and the outputs of all stages.
    stages: Vec<Vec<f64>>,
    derivatives: [Vec<f64>; 3],
    is_new: bool,
}

impl LowPass {
    /// A low-pass with poles at a frequency [Hz].
    #[must_use]
    pub fn new(poles: f64, sample_time: f64, signals: usize) -> Self {
        let pole = std::f64::consts::TAU * poles;
        let x = 0.5 * pole * sample_time;
        Self {
            pole,
            keep: (1.0 - x) / (1.0 + x),
            take: x / (1.0 + x),
            stages: vec![vec![0.0; signals]; STAGES + 1],
            derivatives: std::array::from_fn(|_| vec![0.0; signals]),
            is_new: true,
        }
    }

    /// Adds a sample. At the first one the signals have been constant.
    pub fn pass(&mut self, input: &[f64]) {
        if self.is_new {
            self.is_new = false;
            self.stages
                .iter_mut()
                .for_each(|stage| stage.copy_from_slice(input));
        }
        let mut fresh = input.to_vec();
        for k in 0..STAGES {
            let [before, after] = &mut self.stages[k..k + 2] else {
                unreachable!("a slice of two")
            };
            let outputs = after.iter();
            for ((x, last), y) in fresh.iter_mut().zip(before.iter_mut()).zip(outputs) {
                let output = self.keep * y + self.take * (*x + *last);
                *last = *x;
                *x = output;
            }
        }
        self.stages[STAGES].copy_from_slice(&fresh);
    }

    /// The output.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.stages[STAGES]
    }

    /// The output and its first two derivatives.
    pub fn derivatives(&mut self) -> [&[f64]; 3] {
        let [.., second, third, last] = &self.stages[..] else {
            unreachable!("there are five")
        };
        let w = self.pole;
        for j in 0..last.len() {
            let slope = w * (third[j] - last[j]);
            self.derivatives[0][j] = last[j];
            self.derivatives[1][j] = slope;
            self.derivatives[2][j] = w * (w * (second[j] - third[j]) - slope);
        }
        self.derivatives.each_ref().map(Vec::as_slice)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A slow sine comes out late by four time constants of a stage, with its derivatives.
    #[test]
    fn derivatives_of_a_sine_are_those_of_the_output() {
        let (sample_time, poles, w) = (1e-3, 50.0, std::f64::consts::TAU);
        let mut filter = LowPass::new(poles, sample_time, 1);
        for k in 0..2000 {
            filter.pass(&[(w * sample_time * f64::from(k)).sin()]);
        }
        let lag = 4.0 * (1.0 / poles).atan();
        let gain = (1.0 + poles.powi(-2)).powi(-2);
        let phase = w * sample_time * 1999.0 - lag;
        let [value, slope, curvature] = filter.derivatives();
        // the bilinear transform changes the frequency by (w T)^2 / 12 = 3e-6
        assert!((value[0] - gain * phase.sin()).abs() < 1e-5);
        assert!((slope[0] - gain * w * phase.cos()).abs() < 1e-4);
        assert!((curvature[0] + gain * w * w * phase.sin()).abs() < 1e-3);
    }

    #[test]
    fn half_of_the_power_passes_at_the_bandwidth() {
        let power = (1.0 + BANDWIDTH_OF_POLES.powi(2)).powi(-4);
        assert!((power - 0.5).abs() < 1e-6);
    }
}
