//! What a motor's encoder reads.

use crate::scalar::Real;

/// Encoder reading [rad] of a motor angle: whole counts, or the angle itself without an encoder.
///
/// A derivative that the angle carries is the reading's too: that of the staircase, zero but for
/// its jumps, would say that the encoder sees no motion.
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
