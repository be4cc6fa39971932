//! Arms with elastic joints: equations, integration, servo and sensors.
//!
//! Pure numerics: no files, no printing, no Python. Equation numbers are those of Oaki and Adachi
//! (IFAC SYSID 2009); symbols and units are in docs/notation.md.
//!
//! Each module imports only from those above it:
//!
//! | module | contents |
//! |---|---|
//! | [`scalar`] | scalars of the equations: one number, lanes of numbers, dual numbers |
//! | [`arm`] | equations of motion of the links, one file per arm |
//! | [`parameter`] | description of a parameter |
//! | [`joint`] | springs, dampers and effects of a gear; the drive train of a joint |
//! | [`actuation`] | current loops and controllers |
//! | [`plant`] | arm and joints together, Runge-Kutta step, events of Coulomb friction, known constants |
//! | [`sensors`] | encoders, low-passes, IMUs, decimation |
//! | [`experiment`] | whole experiments over any [`scalar::Real`] |
//! | [`sensitivity`] | derivatives of experiments |
//! | [`program`] | functions to be compiled, and their scalars |
//! | [`compiled`] | arms of any number of joints behind one interface |
//! | [`channels`] | channels of a log from recorded quantities |

pub mod actuation;
pub mod arm;
pub mod channels;
pub mod compiled;
pub mod experiment;
pub mod joint;
pub mod parameter;
pub mod plant;
pub mod program;
pub mod scalar;
pub mod sensitivity;
pub mod sensors;
