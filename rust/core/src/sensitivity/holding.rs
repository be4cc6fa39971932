//! State of a motor at a friction event.

use std::ops::Range;

use crate::arm::Arm;
use crate::arm::transmission::{coupled, motor_of, share};
use crate::joint::effects::Torsion;
use crate::joint::gear::{Gears, Spring};
use crate::plant::Plant;
use crate::plant::friction::Motion;
use crate::scalar::Real;

/// A motor that friction holds, or is about to hold, and the gears that load it.
pub(crate) struct Holding<S, const N: usize> {
    pub(crate) joint: usize,
    /// Joints whose gears load the motor.
    pub(crate) coupled: Range<usize>,
    pub(crate) ratio: f64,
    pub(crate) inertia: f64,
    /// dtheta_M [rad/s].
    pub(crate) speed: f64,
    /// 1/tau; zero for an instant stop.
    pub(crate) settling: f64,
    /// Torque [N m] that holds the motor.
    pub(crate) torque: f64,
    /// Torsions of the gears.
    pub(crate) torsion: [Torsion<S>; N],
    /// Torque of the gears on the motor [N m], before the gear's ratio.
    pub(crate) transmitted: f64,
    /// Stiffness and damping of the gears.
    pub(crate) stiffness: [f64; N],
    pub(crate) damping: [f64; N],
    /// Derivatives of the holding torque with respect to the torques of the gears.
    pub(crate) by_gear: [f64; N],
    /// Derivatives of the holding torque with respect to torsions, n dtheta_M and dtheta_L.
    pub(crate) by_torsion: [f64; N],
    pub(crate) by_motor: [f64; N],
    pub(crate) by_link: [f64; N],
}

impl<S: Real, const N: usize> Holding<S, N> {
    #[inline(always)]
    pub(crate) fn new<A: Arm<N>, G: Gears>(
        plant: &Plant<A, S, G, N>,
        end: &Motion<S, N>,
        joint: usize,
    ) -> Self {
        let (drive, x, arm) = (&plant.joints[joint], &end.state, &plant.arm);
        let plain = |number: S| number.lane(0);
        let (ratio, inertia) = (plain(drive.ratio), plain(drive.motor_inertia));
        let (mut settling, mut brake) = (0.0, 0.0);
        if plain(drive.settling_time) > 0.0 {
            settling = plain(drive.settling_rate);
            brake = inertia * settling - plain(drive.motor_viscous);
        }
        let trains = plant.drive_trains(x);
        let (mut stiffness, mut damping) = ([0.0; N], [0.0; N]);
        let mut by = [[0.0; N]; 4];
        by[2][joint] = brake / ratio;
        for i in coupled(arm, joint) {
            let at_motor = share(arm, i, joint) * ratio;
            let gear = &plant.joints[i];
            stiffness[i] = plain(gear.spring.stiffness(trains.torsion[i].angle));
            damping[i] = plain(gear.gear_damping);
            by[0][i] = -at_motor;
            by[1][i] = -at_motor * stiffness[i];
            by[3][i] = at_motor * damping[i];
            for k in coupled(arm, i) {
                by[2][k] -= at_motor * damping[i] * share(arm, i, k);
            }
        }
        let [by_gear, by_torsion, by_motor, by_link] = by;
        Self {
            joint,
            coupled: coupled(arm, joint),
            ratio,
            inertia,
            speed: plain(x.motor_velocity[joint]),
            settling,
            torque: plain(plant.holding_torques(x, &end.torque, &end.modes)[joint]),
            stiffness,
            damping,
            transmitted: plain(motor_of(
                arm,
                joint,
                S::splat(1.0),
                &trains.torque,
                S::splat(0.0),
            )),
            torsion: trains.torsion,
            by_gear,
            by_torsion,
            by_motor,
            by_link,
        }
    }
}
