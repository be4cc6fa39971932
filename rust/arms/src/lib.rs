//! Arms of every kind behind one interface, [`CompiledArm`].
//!
//! Each program takes seconds to compile. Programs are in separate crates under
//! `rust/programs`, which cargo compiles in parallel.

pub mod load_stream;

use strainwave_baseline as baseline;
use strainwave_core::arm::{
    Arm, ChainJoint, MAX_CHAIN_JOINTS, OneLink, SerialChain, Transmission, TwoLink,
};
use strainwave_core::compiled::{CompiledArm, compiled};
use strainwave_core::plant::config::{Config, JointConfig};
use strainwave_core::program::{Programs, Width};

/// Joints of an arm, from the base.
#[derive(Clone, Copy, Debug)]
pub struct Drives<'a> {
    /// Known constants of each joint.
    pub joints: &'a [JointConfig],
    /// Half width [rad] of the rounded knees of three-slope gears; positive.
    pub corner: f64,
}

/// Links of an arm, and the transmission between motors and joints.
#[derive(Clone, Copy, Debug)]
pub struct Links<'a> {
    /// Joints from the base.
    pub joints: &'a [ChainJoint],
    /// Acceleration of gravity [m/s^2] in the base frame.
    pub gravity: [f64; 3],
    /// Rows of C; empty: the identity.
    pub transmission: &'a [Vec<f64>],
}

/// Error in the description of an arm.
#[derive(Clone, Debug, PartialEq)]
pub enum ArmError {
    /// No arm has programs of this name.
    Program(String),
    /// The programs of planar arms have no transmission.
    PlanarTransmission,
    /// The number of joints does not match the arm.
    Joints {
        /// Number of joints of the arm.
        expected: usize,
        /// Number of joints with constants.
        got: usize,
    },
    /// The number of joints of a chain is zero or exceeds [`MAX_CHAIN_JOINTS`].
    ChainLength(usize),
    /// The axis of a joint, numbered from 0, has length zero.
    Axis(usize),
    /// The transmission matrix is singular, or not square with a row for each joint.
    Transmission,
    /// The transmission couples two joints, numbered from 0, of which one has a rigid gear.
    RigidCoupling([usize; 2]),
    /// The gear ratio of a joint, numbered from 0, is zero or not finite.
    Ratio(usize),
    /// The half width of the rounded knees is not positive.
    Corner(f64),
}

impl std::fmt::Display for ArmError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Program(name) => write!(f, "unknown arm kind {name:?}"),
            Self::PlanarTransmission => write!(f, "only serial chains have a transmission"),
            Self::Joints { expected, got } => write!(f, "expected {expected} joints, got {got}"),
            Self::ChainLength(got) => {
                write!(f, "a chain has 1 to {MAX_CHAIN_JOINTS} joints, got {got}")
            }
            Self::Axis(joint) => write!(f, "the axis of joint {} has no direction", joint + 1),
            Self::Transmission => {
                let must = "must be square, with a row for each joint, and not singular";
                write!(f, "the transmission matrix {must}")
            }
            Self::RigidCoupling([first, second]) => write!(
                f,
                "the transmission couples joints {} and {}, of which one has a rigid gear: expected \
                 rigid or elastic gears in both",
                first + 1,
                second + 1
            ),
            Self::Ratio(joint) => write!(f, "the gear ratio of joint {} is zero", joint + 1),
            Self::Corner(_) => write!(f, "gear_corner must be positive"),
        }
    }
}

impl std::error::Error for ArmError {}

impl Drives<'_> {
    fn with<A: Arm<N>, const N: usize>(&self, arm: A) -> Result<Config<A, N>, ArmError> {
        if self.corner <= 0.0 || self.corner.is_nan() {
            return Err(ArmError::Corner(self.corner));
        }
        let is_possible = |joint: &JointConfig| joint.ratio != 0.0 && joint.ratio.is_finite();
        if let Some(joint) = self.joints.iter().position(|joint| !is_possible(joint)) {
            return Err(ArmError::Ratio(joint));
        }
        let (expected, got) = (arm.joints(), self.joints.len());
        if got != expected {
            return Err(ArmError::Joints { expected, got });
        }
        let mut joints = [self.joints[0]; N];
        joints[..got].copy_from_slice(self.joints);
        Ok(Config {
            arm,
            corner: self.corner,
            joints,
        })
    }
}

/// An arm with compiled programs.
pub trait WithPrograms<const N: usize>: Arm<N> {
    /// Programs of the arm.
    fn programs(&self) -> Programs<Self, N>;
}

impl WithPrograms<2> for TwoLink<true> {
    fn programs(&self) -> Programs<Self, 2> {
        Programs {
            fast: match self.gravity {
                0.0 => strainwave_two_link_level::FAST,
                _ => strainwave_two_link::FAST,
            },
            general: strainwave_two_link::GENERAL,
            baseline: baseline::TWO_LINK,
        }
    }
}

impl WithPrograms<1> for OneLink {
    fn programs(&self) -> Programs<Self, 1> {
        Programs {
            fast: strainwave_one_link::FAST,
            general: strainwave_one_link::GENERAL,
            baseline: baseline::ONE_LINK,
        }
    }
}

/// An arm behind the common interface, with the programs of a name: `serial` for a chain of rigid
/// links with joints placed anywhere in space, `planar-two-link` and `single-joint` for planar arms,
/// which are described as chains too.
///
/// # Errors
/// See [`ArmError`].
///
/// # Panics
/// The processor has no registers of that width.
pub fn compiled_arm(
    program: &str,
    links: &Links<'_>,
    drives: &Drives<'_>,
    width: Width,
) -> Result<Box<dyn CompiledArm>, ArmError> {
    let Links {
        joints, gravity, ..
    } = *links;
    if program == "serial" {
        let chain = serial_chain(links)?;
        return with_drives(coupled(chain, links.transmission, drives)?, drives, width);
    }
    if !links.transmission.is_empty() {
        return Err(ArmError::PlanarTransmission);
    }
    let gravity = gravity.into_iter().fold(0.0, f64::hypot);
    let wrong_number = |expected| ArmError::Joints {
        expected,
        got: joints.len(),
    };
    match program {
        "planar-two-link" => {
            let joints: &[_; 2] = joints.try_into().map_err(|_| wrong_number(2))?;
            let arm = TwoLink {
                link_length: joints[1].position[0],
                gravity,
                accelerometer_distance: joints.map(|joint| joint.accelerometer_distance),
            };
            with_drives(arm, drives, width)
        }
        "single-joint" => {
            let [joint] = joints.try_into().map_err(|_| wrong_number(1))?;
            let arm = OneLink {
                joint_type: joint.joint_type,
                gravity,
                accelerometer_distance: joint.accelerometer_distance,
            };
            with_drives(arm, drives, width)
        }
        unknown => Err(ArmError::Program(unknown.to_owned())),
    }
}

impl WithPrograms<MAX_CHAIN_JOINTS> for SerialChain<MAX_CHAIN_JOINTS> {
    fn programs(&self) -> Programs<Self, MAX_CHAIN_JOINTS> {
        Programs {
            fast: strainwave_chain::FAST,
            general: strainwave_chain::GENERAL,
            baseline: baseline::CHAIN,
        }
    }
}

/// A chain of rigid links.
fn serial_chain(links: &Links<'_>) -> Result<SerialChain<MAX_CHAIN_JOINTS>, ArmError> {
    match links.joints.len() {
        1..=MAX_CHAIN_JOINTS => {
            SerialChain::new(links.joints, links.gravity).map_err(ArmError::Axis)
        }
        got => Err(ArmError::ChainLength(got)),
    }
}

/// A chain with a transmission, unless that is empty.
fn coupled<const N: usize>(
    arm: SerialChain<N>,
    transmission: &[Vec<f64>],
    drives: &Drives<'_>,
) -> Result<SerialChain<N>, ArmError> {
    if transmission.is_empty() {
        return Ok(arm);
    }
    let n = arm.joints();
    if transmission.len() != n || transmission.iter().any(|row| row.len() != n) {
        return Err(ArmError::Transmission);
    }
    let entry = |i: usize, j: usize| match (transmission.get(i), i == j) {
        (Some(row), _) if j < n => row[j],
        (_, is_diagonal) => f64::from(is_diagonal),
    };
    let matrix = std::array::from_fn(|i| std::array::from_fn(|j| entry(i, j)));
    let is_elastic = |i: usize| drives.joints.get(i).is_none_or(|joint| joint.gear.elastic);
    for i in 0..n {
        for j in 0..n {
            if entry(i, j) != 0.0 && is_elastic(i) != is_elastic(j) {
                return Err(ArmError::RigidCoupling([i, j]));
            }
        }
    }
    let transmission = Transmission::new(&matrix).ok_or(ArmError::Transmission)?;
    Ok(arm.with_transmission(transmission))
}

/// An arm with its drives.
fn with_drives<A: WithPrograms<N>, const N: usize>(
    arm: A,
    drives: &Drives<'_>,
    width: Width,
) -> Result<Box<dyn CompiledArm>, ArmError> {
    Ok(compiled(drives.with(arm)?, arm.programs(), width))
}
