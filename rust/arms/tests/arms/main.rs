//! Compiled arms against closed forms, identities and differences.
//!
//! The tests are one binary, so that the programs are linked once.

mod analytic;
mod common;
mod controllers;
mod effects;
mod gear_law_from_outside;
mod gear_laws;
mod identities;
mod sensitivities;
