//! Numerics that are independent of arms and models.
//!
//! [`products`] adds products of tall matrices, tile by tile in registers. [`triangular`] computes
//! the triangular factor of a tall matrix, [`cholesky`] that of a symmetric one, [`singular`] the
//! singular values of a square one, and [`eigenvalues`] the eigenvalues of many small ones.
//! [`elimination`] eliminates local unknowns from least-squares problems; [`reduction`] does so for
//! weighted equations and factorises the rest, [`solution`] solves them, and [`blocks`] leaves out
//! block by block of their rows. [`symmetric_filter`] filters at selected samples. [`open_loops`]
//! opens one of several control loops at a time, and [`margins`] has the stability margins of each.
//! Matrices are row-major slices; samples are rows.

pub mod blocks;
pub mod cholesky;
pub mod eigenvalues;
pub mod elimination;
pub mod margins;
pub mod open_loops;
pub mod products;
pub mod reduction;
pub mod singular;
pub mod solution;
pub mod symmetric_filter;
pub mod triangular;
