//! Linear state-space models in innovations form, and their fit to data.
//!
//! Pure numerics: no files, no printing, no Python. The model is
//!
//! ```text
//! x[k+1] = A x[k] + B u[k] + K e[k]
//! y[k]   = C x[k] + D u[k] +   e[k]
//! ```
//!
//! [`model`] defines models and records. [`predictor`] computes innovations e from data,
//! [`sensitivity`] their exact derivatives with respect to every entry of every matrix. [`tangent`]
//! parametrises models without the similarity transformations. [`fit`] is the prediction-error
//! method. [`linear`] estimates the entries in which the innovations are linear. [`hankel`] computes the
//! triangular factors that the methods of [`subspace`] use, [`steady_state`] Gramians and the gain of a
//! predictor.
//!
//! Matrices are row-major slices; samples are rows.

pub mod fit;
pub mod hankel;
mod linalg;
pub mod linear;
pub mod model;
pub mod predictor;
pub mod sensitivity;
pub mod stability;
pub mod steady_state;
pub mod subspace;
mod tangent;
