//! Sensors: encoders, low-passes, IMUs, and decimation of samples.

pub mod decimation;
pub mod encoder;
pub(crate) mod imu;
pub mod low_pass;
