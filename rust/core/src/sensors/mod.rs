//! Sensors: encoders, sensors on links, low-passes, and decimation of samples.

pub mod decimation;
pub mod encoder;
pub(crate) mod link_sensors;
pub mod low_pass;
