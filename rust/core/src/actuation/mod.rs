//! From commands to motor torques: current loops and controllers.

pub mod controller;
pub mod current_loop;
pub mod linear_servo;
pub mod pi_position;
pub mod pi_velocity;

pub use controller::{Controller, Servo};
pub use linear_servo::{JointLaw, LawState, LinearServo, MAX_LAW_STATES};
pub use pi_position::PiPosition;
pub use pi_velocity::PiVelocity;
