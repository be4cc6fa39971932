//! Derivatives of the equations with respect to parameters.
//!
//! They are computed once for all blocks. Base parameters change the rows of all links up to their
//! own: these rows are stored by direction ([`LinkForcing`]), and a block loads its vector. Other
//! parameters change few rows: they are stored four at a time ([`Quad`]), and a block selects the
//! quads of its directions.

use std::collections::BTreeMap;

use crate::arm::Arm;
use crate::arm::transmission::share;
use crate::experiment::Source;
use crate::joint::effects::{AffectedTerms, EFFECT_SIZE_COUNT, Size};
use crate::joint::transmission::DRIVE;
use crate::plant::config::{Config, Role};
use crate::plant::first_bearing;
use crate::scalar::{Aligned, Lanes, MAX_LANES};

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
/// Quad of the link's viscous friction.
pub(crate) const LINK_VISCOUS_QUAD: usize = GEAR_EFFECTS + EFFECT_QUADS;
/// First quad of the sizes of effects, in the link's row.
pub(crate) const LINK_EFFECTS: usize = LINK_VISCOUS_QUAD + 1;
/// First quad of the sizes of effects that move the outputs of coupled gears, in the rows of the
/// gears; see [`coupled_slot`].
const COUPLED_GEAR: usize = LINK_EFFECTS + EFFECT_QUADS;
/// Number of quads for the sizes of effects.
const EFFECT_QUADS: usize = EFFECT_SIZE_COUNT.div_ceil(4);
/// Number of quads of a joint.
const QUADS: usize = COUPLED_GEAR + 4;
/// Quads of each joint.
pub(crate) type Quads<const N: usize> = [[Quad; QUADS]; N];

/// Zero derivatives.
pub(crate) fn zero_quads<const N: usize>() -> Quads<N> {
    [[Quad([[0.0; 4]; 4]); QUADS]; N]
}

fn row(quad: usize) -> Row {
    match quad {
        MOTOR | MOTOR_EFFECTS..GEAR_EFFECTS => Row::Motor,
        GEAR..MOTOR_EFFECTS | GEAR_EFFECTS..LINK_VISCOUS_QUAD | COUPLED_GEAR.. => Row::Gear,
        _ => Row::Link,
    }
}

/// Whether a quad is that of sizes of effects.
fn is_of_effect_quad(quad: usize) -> bool {
    (MOTOR_EFFECTS..LINK_VISCOUS_QUAD).contains(&quad) || quad >= LINK_EFFECTS
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
    let location = |(role, i): (Role, usize)| match role {
        Role::Base(_) => Vec::new(), // see `LinkForcing`
        Role::Drive(LINK_VISCOUS) => vec![at(i, LINK_VISCOUS_QUAD, 0)],
        Role::Drive(k) => vec![at(i, MOTOR, k)],
        Role::Damping => vec![at(i, GEAR, 0)],
        Role::Gear(k) => vec![at(i, GEAR, 1 + k)],
        // it acts on held motors only
        Role::Settling => Vec::new(),
        // other parameters of an effect have no influence at size zero
        Role::Effect(k) => match config.joints[i].effects.parameters()[k].size {
            Some(size) => {
                let moves_others = moves_coupled(&config.arm, i, size);
                let mut all: Vec<_> = effect_rows(size)
                    .filter(|&quad| !(moves_others && quad == GEAR_EFFECTS))
                    .map(|quad| at(i, quad, size.index))
                    .collect();
                if moves_others {
                    let moved =
                        (0..config.arm.joints()).filter(|&k| share(&config.arm, k, i) != 0.0);
                    let (quad, slot) = coupled_slot(i, size);
                    all.extend(moved.map(|k| at(k, quad, slot)));
                }
                if size.affects.weight {
                    let weight_location = at(i, LINK_EFFECTS, size.index);
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

/// Whether a size of an effect of a joint moves the output of a gear that is coupled with others.
#[inline(always)]
pub(crate) fn moves_coupled<A: Arm<N>, const N: usize>(arm: &A, joint: usize, size: Size) -> bool {
    size.affects.output && arm.transmission().is_some_and(|one| one.couples(joint))
}

/// Quad and slot, in the row of each gear, of a size that moves the output of a motor's gear.
#[inline(always)]
pub(crate) fn coupled_slot(motor: usize, size: Size) -> (usize, usize) {
    let slot = 2 * motor + size.index % 2;
    (COUPLED_GEAR + slot / 4, slot % 4)
}

/// First quads of the rows of its joint that an effect changes.
fn effect_rows(size: Size) -> impl Iterator<Item = usize> {
    let AffectedTerms {
        friction,
        motor,
        gear,
        output: _, // included in `gear` and `motor`
        link,
        weight: _, // it affects the rows of other joints as well
        drive: _,  // the motor's torque has separate derivatives
    } = size.affects;
    let rows = [
        (friction || motor, MOTOR_EFFECTS),
        (gear, GEAR_EFFECTS),
        (link, LINK_EFFECTS),
    ];
    rows.into_iter()
        .filter(|(affects, _)| *affects)
        .map(|(_, quad)| quad)
}

/// Index of the link's viscous friction in a joint's drive; those before it act on the motor.
const LINK_VISCOUS: usize = DRIVE.len() - 1;

/// A quad that changes a row of a joint, and the lanes that receive its numbers.
struct Entry<P> {
    /// Index among the rows of all joints.
    row: usize,
    /// Whether it is the first of its row.
    is_first: bool,
    /// Index among the quads of all variants and joints.
    quad: usize,
    selection: P,
}

/// Derivatives of the equations for the directions of a block.
pub(crate) struct Forcing<V: Lanes, const N: usize> {
    /// Row by row; few, because most parameters change one row of one joint.
    entries: Vec<Entry<V::Selection>>,
    /// Rows of gears, motors and links at each stage; zeros where there is no entry.
    rows: [[[V; N]; 3]; 4],
    /// The first direction.
    first: usize,
}

impl<V: Lanes, const N: usize> Forcing<V, N> {
    /// Forcing for `V::LANES` of the directions, from the `first`; sizes of effects are those of a
    /// `variant`.
    pub(crate) fn new<A: Arm<N>>(
        config: &Config<A, N>,
        directions: &[Source],
        (first, variant): (usize, usize),
    ) -> Self {
        let locations = locations(config);
        let mut slots_by_quad: BTreeMap<_, [Option<usize>; MAX_LANES]> = BTreeMap::new();
        for (lane, direction) in directions.iter().skip(first).take(V::LANES).enumerate() {
            if let &Source::Parameter(k) = direction {
                for location in &locations[k] {
                    let row = row(location.quad) as usize * N + location.joint;
                    let of_variant = usize::from(is_of_effect_quad(location.quad)) * variant;
                    let joint = N * of_variant + location.quad_joint;
                    let quad = joint * QUADS + location.quad;
                    let slots = slots_by_quad.entry((row, quad)).or_default();
                    slots[lane] = Some(location.slot);
                }
            }
        }
        let mut entries: Vec<Entry<V::Selection>> = Vec::with_capacity(slots_by_quad.len());
        for ((row, quad), slots) in slots_by_quad {
            entries.push(Entry {
                row,
                is_first: entries.last().is_none_or(|last| last.row != row),
                quad,
                selection: V::selection(slots),
            });
        }
        Self {
            entries,
            rows: [[[V::splat(0.0); N]; 3]; 4],
            first,
        }
    }

    /// Sets [`Self::rows`] for a step.
    #[inline(always)]
    pub(crate) fn update(&mut self, quads: &[Quads<N>]) {
        let zero = V::splat(0.0);
        let (mut sums, quads) = ([zero; 4], quads.as_flattened().as_flattened());
        for entry in &self.entries {
            let quad = &quads[entry.quad];
            for stage in 0..4 {
                // not of the number in the row, which would be stored by a slow masked instruction
                let sum = if entry.is_first { zero } else { sums[stage] };
                sums[stage] = sum.replace_selected(&entry.selection, &quad.0[stage]);
                self.rows[stage].as_flattened_mut()[entry.row] = sums[stage];
            }
        }
    }

    /// Derivatives of the rows of gears, motors and links at a stage.
    #[inline(always)]
    pub(crate) fn at(&self, stage: usize) -> &[[V; N]; 3] {
        &self.rows[stage]
    }

    /// Derivatives of the links' rows at a stage, without those in [`Self::at`].
    #[inline(always)]
    pub(crate) fn of_links(&self, all: &LinkForcing, stage: usize) -> [V; N] {
        let mut rows = [V::splat(0.0); N];
        let numbers = &all.numbers[4 * N * self.first..][..4 * N * V::LANES];
        for i in 0..N {
            rows[i] = V::load(&numbers[(stage * N + i) * V::LANES..]);
        }
        rows
    }
}

/// Up to four directions in succession in one block, of which some are base parameters.
struct Group {
    /// Index of the first direction in the first row of the block.
    first: usize,
    parameters: [Option<usize>; 4],
    last_parameter: usize,
}

/// Derivatives of the links' rows with respect to base parameters, block by block, stage by stage and
/// joint by joint, one per direction.
pub(crate) struct LinkForcing {
    /// Those with such parameters.
    groups: Vec<Group>,
    /// Directions per block.
    lanes: usize,
    /// Behind those of the directions, zeros for a block without directions.
    numbers: Aligned,
}

impl LinkForcing {
    pub(crate) fn new<A: Arm<N>, const N: usize>(
        config: &Config<A, N>,
        directions: &[Source],
        lanes: usize,
    ) -> Self {
        let roles = config.roles();
        let parameter = |direction: &Source| match direction {
            Source::Parameter(k) => match roles[*k] {
                (Role::Base(k), _) => Some(k),
                _ => None,
            },
            _ => None,
        };
        let per_group = lanes.min(4);
        let group = |(k, four): (usize, &[Source])| {
            let mut parameters = [None; 4];
            for (to, direction) in parameters.iter_mut().zip(four) {
                *to = parameter(direction);
            }
            let in_block = k * per_group % lanes;
            Some(Group {
                first: 4 * N * (k * per_group - in_block) + in_block,
                parameters,
                last_parameter: parameters.into_iter().flatten().max()?,
            })
        };
        let blocks = directions.len().div_ceil(lanes) + 1;
        Self {
            groups: directions
                .chunks(per_group)
                .enumerate()
                .filter_map(group)
                .collect(),
            lanes,
            numbers: Aligned::zeros(4 * N * blocks * lanes),
        }
    }

    /// Sets the derivatives at the stages from the `first` to the torques of the joints per base
    /// parameter.
    #[inline(always)]
    pub(crate) fn set<A: Arm<N>, L: Lanes, const N: usize>(
        &mut self,
        arm: &A,
        by: &[[L; N]],
        first: usize,
    ) {
        for group in &self.groups {
            for i in 0..arm.joints() {
                if group.last_parameter < arm.first_parameter(i) {
                    break; // zeros, as for the joints behind
                }
                let mut four = [L::splat(0.0); 4];
                for slot in 0..4 {
                    if let Some(k) = group.parameters[slot] {
                        four[slot] = by[k][i];
                    }
                }
                let mut rows = [[0.0; 4]; 4];
                L::store_rows(&four, &mut rows);
                for lane in 0..L::LANES {
                    let begin = group.first + ((first + lane) * N + i) * self.lanes;
                    let to = &mut self.numbers[begin..];
                    match self.lanes {
                        0..4 => to[..self.lanes].copy_from_slice(&rows[lane][..self.lanes]),
                        _ => to[..4].copy_from_slice(&rows[lane]), // of constant length
                    }
                }
            }
        }
    }
}
