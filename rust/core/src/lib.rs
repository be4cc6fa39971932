//! The arm with elastic joints: its equations, their integration, its servo and sensors.
//!
//! Pure numerics: no files, no printing, no Python. Equation numbers are those of Oaki and Adachi
//! (IFAC SYSID 2009); symbols and units are in docs/notation.md.
//!
//! [`arm`], [`gear`] and [`effects`] hold the physics, [`plant`] puts them together, [`friction`] cuts time where
//! Coulomb friction changes its mode, [`simulate`] runs whole experiments ([`experiment`]) over any [`real::Real`],
//! and [`dispatch`] chooses which. Over [`dual`] numbers the same chain gives its derivatives,
//! [`sensitivity`].

mod aligned;
pub mod arm;
pub mod basis;
mod collected;
mod column;
pub mod config;
pub mod dispatch;
pub mod drive;
pub mod dual;
pub mod effects;
pub mod experiment;
mod follow;
mod follower;
mod forcing;
pub mod friction;
pub mod gear;
#[cfg(target_arch = "x86_64")]
mod lanes;
mod lengthening;
mod margin;
mod mounted;
mod onset;
pub mod plant;
pub mod real;
pub mod rigid;
mod sensing;
pub mod sensitivity;
pub mod sensors;
pub mod simulate;
mod start;
pub mod thinning;
mod transmission;
mod variation;
