//! The arm with elastic joints: its equations, their integration, its servo and sensors.
//!
//! Pure numerics: no files, no printing, no Python. Equation numbers are those of Oaki and Adachi
//! (IFAC SYSID 2009); symbols and units are in docs/notation.md.
//!
//! Each module imports only from those above it:
//!
//! | module | holds |
//! |---|---|
//! | [`scalar`] | what the equations are written over: a number, lanes of numbers, numbers with derivatives |
//! | [`arm`] | the links' equations of motion, one file per arm |
//! | [`parameter`] | what describes a parameter |
//! | [`joint`] | springs, dampers and effects of a gear, and a joint's drive train |
//! | [`actuation`] | current loops and the servo |
//! | [`plant`] | arm and joints together, the Runge-Kutta step, Coulomb friction's events, known constants |
//! | [`sensors`] | encoders, low-passes, IMUs, decimation |
//! | [`experiment`] | whole experiments over any [`scalar::Real`] |
//! | [`sensitivity`] | their derivatives |
//! | [`program`] | the functions to be compiled, and the scalars they run on |
//! | [`compiled`] | arms of any number of joints behind one interface |

pub mod actuation;
pub mod arm;
pub mod compiled;
pub mod experiment;
pub mod joint;
pub mod parameter;
pub mod plant;
pub mod program;
pub mod scalar;
pub mod sensitivity;
pub mod sensors;
