//! Linear state-space models in innovations form, and their fit to data.
//!
//! Pure numerics: no files, no printing, no Python. The model is
//!
//! ```text
//! x[k+1] = A x[k] + B u[k] + K e[k]
//! y[k]   = C x[k] + D u[k] +   e[k]
//! ```
//!
//! [`model`] holds the nouns, [`predictor`] turns data into innovations e, [`sensitivity`] gives
//! their exact derivatives with respect to every entry of every matrix, [`tangent`] the directions
//! in which those entries change anything but the state's coordinates, and [`fit`] puts them
//! together. [`hankel`] correlates data with its own past, for subspace methods.
//!
//! Matrices are row-major slices; samples are rows.

pub mod fit;
pub mod hankel;
mod linalg;
pub mod model;
pub mod predictor;
pub mod sensitivity;
pub mod stability;
mod tangent;
