//! What sensors make of the motion: encoders, low-passes, IMUs, and the decimation of samples.

pub mod decimation;
pub mod encoder;
pub(crate) mod imu;
pub mod low_pass;
