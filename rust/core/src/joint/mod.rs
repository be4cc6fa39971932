//! One joint: its gear, what gears and motors have beyond springs and dry friction, and both together.

pub mod effects;
pub mod gear;
pub(crate) mod transmission;

pub(crate) use transmission::Gear;
pub use transmission::Joint;
