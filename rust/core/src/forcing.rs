//! Where parameters enter the variational equations, and how columns of directions take them in.
//!
//! What each parameter adds to its row is worked out once for all columns, by four parameters of a
//! row at a time; a column then picks its own.

use std::collections::BTreeMap;

use crate::arm::{Arm, MOST_BASE};
use crate::config::{Config, GearKind, SETTLING};
use crate::experiment::Source;
use crate::real::{Lanes, MOST_LANES};

/// The row of the equations that a parameter enters.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Row {
    /// The gear's torque.
    Gear,
    /// The motor's acceleration.
    Motor,
    /// The torque that a link takes.
    Link,
}

/// What four parameters of a row add to it at each of the four stages; a stage's are side by side.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Quad(pub(crate) [[f64; 4]; 4]);

/// By motor inertia, viscous and Coulomb friction, offset.
pub(crate) const MOTOR: usize = 0;
/// By the stiffnesses and knees of the spring, then by the damping: two quads.
pub(crate) const GEAR: usize = 1;
/// By the link's viscous friction, then by the arm's base parameters: two quads.
pub(crate) const LINK: usize = 3;
/// By the sizes of Stribeck's friction and, at [`KINEMATIC`], the kinematic error.
pub(crate) const MOTOR_EFFECTS: usize = 5;
/// By the sizes of hysteresis and, at [`KINEMATIC`], the kinematic error.
pub(crate) const GEAR_EFFECTS: usize = 6;
/// The kinematic error's first size, among the effects.
pub(crate) const KINEMATIC: usize = 1;

const _: () = assert!(MOST_BASE < 8, "two quads for a link");

/// One joint's quads.
pub(crate) type Quads = [Quad; 7];

/// Nothing at all.
pub(crate) const NOTHING: Quads = [Quad([[0.0; 4]; 4]); 7];

/// Where a parameter enters: row and quad among those of all joints, and its slot of the quad.
#[derive(Clone, Copy)]
struct Place {
    row: usize,
    quad: usize,
    slot: usize,
}

impl Place {
    /// The `slot`-th of a joint's parameters in some row, from a quad on.
    fn new<const N: usize>(joint: usize, quad: usize, slot: usize) -> Self {
        let row = match quad {
            MOTOR | MOTOR_EFFECTS => Row::Motor,
            LINK => Row::Link,
            _ => Row::Gear,
        };
        Self {
            row: row as usize * N + joint,
            quad: joint * NOTHING.len() + quad + slot / 4,
            slot: slot % 4,
        }
    }
}

/// The places of each of a configuration's parameters.
fn places<A: Arm<N>, const N: usize>(config: &Config<A, N>) -> Vec<Vec<Place>> {
    let at = Place::new::<N>;
    let place = |(k, (name, joint)): (usize, (&str, Option<usize>))| {
        let i = joint.unwrap_or(1) - 1;
        match name {
            "motor_inertia" => vec![at(i, MOTOR, 0)],
            "motor_viscous_friction" => vec![at(i, MOTOR, 1)],
            "motor_coulomb_friction" => vec![at(i, MOTOR, 2)],
            "friction_offset" => vec![at(i, MOTOR, 3)],
            "link_viscous_friction" => vec![at(i, LINK, 0)],
            "gear_stiffness" | "gear_stiffness_k1" => vec![at(i, GEAR, 0)],
            "gear_stiffness_k2" => vec![at(i, GEAR, 1)],
            "gear_stiffness_k3" => vec![at(i, GEAR, 2)],
            "gear_knee_t1" => vec![at(i, GEAR, 3)],
            "gear_knee_t2" => vec![at(i, GEAR, 4)],
            "gear_damping" => vec![at(i, GEAR, damping_slot(config.joints[i].gear))],
            "stribeck_friction" => vec![at(i, MOTOR_EFFECTS, 0)],
            "hysteresis_torque" => vec![at(i, GEAR_EFFECTS, 0)],
            "kinematic_error_cos" | "kinematic_error_sin" => {
                let slot = KINEMATIC + usize::from(name.ends_with("sin"));
                vec![at(i, GEAR_EFFECTS, slot), at(i, MOTOR_EFFECTS, slot)]
            }
            // the first acts on held motors alone, the others not at all where the effect itself
            // is nothing
            SETTLING | "stribeck_velocity" | "hysteresis_twist" => Vec::new(),
            _ => (0..N).map(|j| at(j, LINK, 1 + k)).collect(),
        }
    };
    let names = config.parameter_names();
    names.into_iter().enumerate().map(place).collect()
}

/// Where the damping stands behind the spring's own parameters.
fn damping_slot(gear: GearKind) -> usize {
    if gear == GearKind::ThreeSlope { 5 } else { 1 }
}

/// What a column's parameters add to the gears', motors' and links' rows at each stage.
pub(crate) struct Forcing<V: Lanes, const N: usize> {
    rows: [[[V; 4]; N]; 3],
    picks: Vec<Picked<V::Pick>>,
}

/// What a column takes from one quad for one row.
struct Picked<P> {
    row: usize,
    quad: usize,
    pick: P,
    /// Whether nothing of this row comes before it.
    first: bool,
}

impl<V: Lanes, const N: usize> Forcing<V, N> {
    /// By the first `V::LANES` directions.
    pub(crate) fn new<A: Arm<N>>(config: &Config<A, N>, directions: &[Source]) -> Self {
        let places = places(config);
        let mut wanted: BTreeMap<(usize, usize), [Option<usize>; MOST_LANES]> = BTreeMap::new();
        for (lane, direction) in directions.iter().take(V::LANES).enumerate() {
            if let &Source::Parameter(k) = direction {
                for place in &places[k] {
                    let slots = wanted.entry((place.row, place.quad)).or_default();
                    slots[lane] = Some(place.slot);
                }
            }
        }
        let mut before = None;
        let picks = wanted.into_iter().map(|((row, quad), slots)| Picked {
            row,
            quad,
            pick: V::pick(slots),
            first: before.replace(row) != Some(row),
        });
        Self {
            picks: picks.collect(),
            rows: [[[V::splat(0.0); 4]; N]; 3],
        }
    }

    /// Takes a step's quads, joint by joint.
    #[inline(always)]
    pub(crate) fn take(&mut self, quads: &[Quads; N]) {
        let (rows, quads) = (self.rows.as_flattened_mut(), quads.as_flattened());
        let nothing = [V::splat(0.0); 4];
        let mut row = nothing;
        for own in &self.picks {
            if own.first {
                row = nothing;
            }
            let from = &quads[own.quad].0;
            for k in 0..4 {
                row[k] = row[k].picked(&own.pick, &from[k]);
            }
            // whole, even where more of the row will come: a part of a register that is stored
            // keeps those waiting who need the whole
            rows[own.row] = row;
        }
    }

    /// What is added to a joint's row at a stage.
    #[inline(always)]
    pub(crate) fn of(&self, row: Row, joint: usize, stage: usize) -> V {
        self.rows[row as usize][joint][stage]
    }
}
