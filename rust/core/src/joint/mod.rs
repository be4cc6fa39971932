//! Joints: gears, effects of gears and motors, and both in one drive train.

pub mod effects;
pub mod gear;
pub(crate) mod transmission;

pub(crate) use transmission::DriveTrains;
pub use transmission::Joint;
