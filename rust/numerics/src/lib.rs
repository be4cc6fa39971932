//! Numerics that know neither arms nor models.
//!
//! [`products`] adds products of tall matrices to small ones, in registers; [`elimination`] takes unknowns of
//! short stretches out of a least-squares problem. Matrices are row-major slices; samples are rows.

pub mod elimination;
pub mod products;
