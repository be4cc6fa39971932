//! From commands to motor torques: current loops and the servo.

pub mod current_loop;
pub mod servo;
