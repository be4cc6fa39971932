//! Numerics that are independent of arms and models.
//!
//! [`products`] adds products of tall matrices, tile by tile in registers. [`triangular`] computes
//! the triangular factor of a tall matrix, [`cholesky`] that of a symmetric one, and [`singular`] the
//! singular values of a square one. [`elimination`] eliminates local unknowns from least-squares
//! problems. Matrices are row-major slices; samples are rows.

pub mod cholesky;
pub mod elimination;
pub mod products;
pub mod singular;
pub mod triangular;
