//! Encoders of the motors.

use crate::scalar::Real;

/// Encoder reading [rad] of a motor angle: whole counts, or the angle without an encoder.
///
/// The derivative of the reading is that of the angle. The derivative of the staircase, zero except
/// for its jumps, would hide the motion.
#[inline(always)]
pub fn encoder_angle<R: Real>(angle: R, counts_per_turn: Option<f64>) -> R {
    let mut reading = angle;
    if let Some(counts) = counts_per_turn {
        let count = std::f64::consts::TAU / counts;
        for lane in 0..R::LANES {
            reading.set_lane(lane, (angle.lane(lane) / count).round() * count);
        }
    }
    reading
}
