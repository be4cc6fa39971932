//! Derivatives of the equations with respect to parameters.
//!
//! They are computed once for all blocks, four parameters of a row at a time ([`Quad`]); each block
//! selects the quads of its directions.

use std::collections::BTreeMap;

use crate::arm::Arm;
use crate::experiment::Source;
use crate::joint::effects::{AffectedTerms, EFFECT_SIZE_COUNT, Size};
use crate::joint::transmission::DRIVE;
use crate::plant::config::{Config, Role};
use crate::plant::first_bearing;
use crate::scalar::{Lanes, MAX_LANES};

/// Row of the equations.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Row {
    /// Torque of the gear.
    Gear,
    /// Acceleration of the motor.
    Motor,
    /// Load torque of the link.
    Link,
}

/// Derivatives with respect to four parameters at each of the four stages; those of one stage are
/// adjacent.
#[derive(Clone, Copy)]
#[repr(align(64))]
pub(crate) struct Quad(pub(crate) [[f64; 4]; 4]);

/// Quad of motor inertia, viscous friction, Coulomb friction and offset.
pub(crate) const MOTOR: usize = 0;
/// First of two quads of damping and of the parameters of the gear's law.
pub(crate) const GEAR: usize = 1;
/// First quad of the sizes of effects, in the motor's row.
pub(crate) const MOTOR_EFFECTS: usize = 3;
/// First quad of the sizes of effects, in the gear's row.
pub(crate) const GEAR_EFFECTS: usize = MOTOR_EFFECTS + EFFECT_QUADS;
/// Number of quads for the sizes of effects.
const EFFECT_QUADS: usize = EFFECT_SIZE_COUNT.div_ceil(4);
/// Number of quads of a joint's motor and gear.
const DRIVE_TRAIN_QUADS: usize = GEAR_EFFECTS + EFFECT_QUADS;
/// Quads of the link's viscous friction, the arm's base parameters and the sizes of effects, in
/// this order.
const LINK: usize = DRIVE_TRAIN_QUADS;

/// Quads of all joints.
pub(crate) struct Quads<const N: usize> {
    pub(crate) drive_train: [[Quad; DRIVE_TRAIN_QUADS]; N],
    /// Quads of the links' rows, joint by joint.
    pub(crate) link: Vec<Quad>,
}

/// Number of quads of a link's row for base parameters.
#[inline(always)]
pub(crate) fn link_quads(bases: usize) -> usize {
    (1 + bases).div_ceil(4)
}

/// Number of quads of a link's row.
#[inline(always)]
pub(crate) fn all_link_quads(bases: usize) -> usize {
    link_quads(bases) + EFFECT_QUADS
}

impl<const N: usize> Quads<N> {
    /// Zero derivatives.
    pub(crate) fn zeros(bases: usize) -> Self {
        let zero = Quad([[0.0; 4]; 4]);
        Self {
            drive_train: [[zero; DRIVE_TRAIN_QUADS]; N],
            link: vec![zero; N * all_link_quads(bases)],
        }
    }

    /// A quad of the sizes of effects in a link's row.
    #[inline(always)]
    pub(crate) fn of_link(&mut self, joint: usize, quad: usize) -> &mut Quad {
        let per_link = self.link.len() / N;
        &mut self.link[(joint + 1) * per_link - EFFECT_QUADS + quad]
    }
}

fn row(quad: usize) -> Row {
    match quad {
        MOTOR | MOTOR_EFFECTS..GEAR_EFFECTS => Row::Motor,
        GEAR..MOTOR_EFFECTS | GEAR_EFFECTS..DRIVE_TRAIN_QUADS => Row::Gear,
        _ => Row::Link,
    }
}

/// Location of a derivative: the row of a joint, and the quad and the slot.
#[derive(Clone, Copy)]
struct Location {
    joint: usize,
    /// The joint of the quad.
    quad_joint: usize,
    quad: usize,
    slot: usize,
}

/// Locations for each parameter.
fn locations<A: Arm<N>, const N: usize>(config: &Config<A, N>) -> Vec<Vec<Location>> {
    let at = |joint, quad, slot| Location {
        joint,
        quad_joint: joint,
        quad: quad + slot / 4,
        slot: slot % 4,
    };
    let bases = config.arm.names().len();
    let location = |(role, i): (Role, usize)| match role {
        Role::Base(k) => (0..config.arm.joints())
            .map(|j| at(j, LINK, 1 + k))
            .collect(),
        Role::Drive(LINK_VISCOUS) => vec![at(i, LINK, 0)],
        Role::Drive(k) => vec![at(i, MOTOR, k)],
        Role::Damping => vec![at(i, GEAR, 0)],
        Role::Gear(k) => vec![at(i, GEAR, 1 + k)],
        // it acts on held motors only
        Role::Settling => Vec::new(),
        // other parameters of an effect have no influence at size zero
        Role::Effect(k) => match config.joints[i].effects.parameters()[k].size {
            Some(size) => {
                let own_rows = effect_locations(size, bases);
                let mut all: Vec<_> = own_rows.map(|(quad, slot)| at(i, quad, slot)).collect();
                if size.affects.weight {
                    let weight_location = at(i, LINK + link_quads(bases), size.index);
                    let first = first_bearing::<A, N>(i);
                    all.extend((first..=i).map(|joint| Location {
                        joint,
                        ..weight_location
                    }));
                }
                all
            }
            None => Vec::new(),
        },
    };
    config.roles().into_iter().map(location).collect()
}

/// Quads and slots of the size of an effect in the rows of its joint.
fn effect_locations(size: Size, bases: usize) -> impl Iterator<Item = (usize, usize)> {
    let AffectedTerms {
        friction,
        motor,
        gear,
        link,
        weight: _, // it affects the rows of other joints as well
        drive: _,  // the motor's torque has separate derivatives
    } = size.affects;
    let rows = [
        (friction || motor, MOTOR_EFFECTS),
        (gear, GEAR_EFFECTS),
        (link, LINK + link_quads(bases)),
    ];
    let affected_rows = rows.into_iter().filter(|(affects, _)| *affects);
    affected_rows.map(move |(_, quad)| (quad, size.index))
}

/// Index of the link's viscous friction in a joint's drive; those before it act on the motor.
const LINK_VISCOUS: usize = DRIVE.len() - 1;

/// Largest number of quads per row: each lane uses at most one.
const MAX_ROW_QUADS: usize = MAX_LANES;

/// Quads of a row with the selection of their numbers.
type RowSelection<P> = [Option<(usize, P)>; MAX_ROW_QUADS];

/// Derivatives of the equations for the directions of a block.
pub(crate) struct Forcing<V: Lanes, const N: usize> {
    selections: [[RowSelection<V::Selection>; N]; 3],
}

impl<V: Lanes, const N: usize> Forcing<V, N> {
    /// Forcing for the first `V::LANES` directions.
    pub(crate) fn new<A: Arm<N>>(config: &Config<A, N>, directions: &[Source]) -> Self {
        let locations = locations(config);
        let per_link = all_link_quads(config.arm.names().len());
        let mut slots_by_quad: BTreeMap<_, [Option<usize>; MAX_LANES]> = BTreeMap::new();
        for (lane, direction) in directions.iter().take(V::LANES).enumerate() {
            if let &Source::Parameter(k) = direction {
                for location in &locations[k] {
                    let key = (location.joint, location.quad, location.quad_joint);
                    let slots = slots_by_quad.entry(key).or_default();
                    slots[lane] = Some(location.slot);
                }
            }
        }
        let mut selections = [[[None; MAX_ROW_QUADS]; N]; 3];
        for ((joint, quad, of), slots) in slots_by_quad {
            let selections: &mut RowSelection<V::Selection> =
                &mut selections[row(quad) as usize][joint];
            let next = selections.iter().position(Option::is_none);
            let quad = match quad.checked_sub(LINK) {
                Some(of_link) => of * per_link + of_link,
                None => quad,
            };
            selections[next.expect("at most one quad per lane")] =
                Some((quad, V::selection(slots)));
        }
        Self { selections }
    }

    /// Derivatives of a joint's row at a stage.
    #[inline(always)]
    pub(crate) fn of(&self, quads: &Quads<N>, row: Row, joint: usize, stage: usize) -> V {
        let from = match row {
            Row::Link => &quads.link[..],
            Row::Gear | Row::Motor => &quads.drive_train[joint][..],
        };
        let mut sum = V::splat(0.0);
        for selection in &self.selections[row as usize][joint] {
            let Some((quad, selection)) = selection else {
                break;
            };
            sum = sum.replace_selected(selection, &from[*quad].0[stage]);
        }
        sum
    }
}
