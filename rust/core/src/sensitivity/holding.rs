//! State of a joint at a friction event.

use crate::arm::Arm;
use crate::joint::gear::{Gears, Spring};
use crate::plant::Plant;
use crate::plant::friction::Motion;
use crate::scalar::Real;

/// Motor and gear of a joint that friction holds, or is about to hold.
pub(crate) struct Holding<S> {
    pub(crate) joint: usize,
    pub(crate) ratio: f64,
    pub(crate) inertia: f64,
    pub(crate) torsion: S,
    pub(crate) rate: f64,
    pub(crate) motor_angle: f64,
    /// dtheta_M [rad/s].
    pub(crate) speed: f64,
    /// 1/tau; zero for an instant stop.
    pub(crate) settling: f64,
    /// Torque [N m] of the gear.
    pub(crate) transmitted: f64,
    /// Torque [N m] that holds the motor.
    pub(crate) torque: f64,
    pub(crate) stiffness: f64,
    pub(crate) damping: f64,
    /// Derivatives of the holding torque with respect to the torsion, n dtheta_M and dtheta_L.
    pub(crate) by_torsion: f64,
    pub(crate) by_motor: f64,
    pub(crate) by_link: f64,
}

impl<S: Real> Holding<S> {
    #[inline(always)]
    pub(crate) fn new<A: Arm<N>, G: Gears, const N: usize>(
        plant: &Plant<A, S, G, N>,
        end: &Motion<S, N>,
        i: usize,
    ) -> Self {
        let (drive, x) = (&plant.joints[i], &end.state);
        let plain = |number: S| number.lane(0);
        let gear = plant.gear(x, i);
        let (ratio, inertia) = (plain(drive.ratio), plain(drive.motor_inertia));
        let stiffness = plain(drive.spring.stiffness(gear.torsion.angle));
        let damping = plain(drive.gear_damping);
        let (mut settling, mut brake) = (0.0, 0.0);
        if plain(drive.settling_time) > 0.0 {
            settling = plain(drive.settling_rate);
            brake = inertia * settling - plain(drive.motor_viscous);
        }
        let holding = plant.holding_torques(x, &end.torque, &end.modes);
        Self {
            joint: i,
            ratio,
            inertia,
            torsion: gear.torsion.angle,
            rate: plain(gear.torsion.rate),
            motor_angle: plain(x.motor_angle[i]),
            speed: plain(x.motor_velocity[i]),
            settling,
            transmitted: plain(plant.transmitted(x, i, &gear.torsion)),
            torque: plain(holding[i]),
            stiffness,
            damping,
            by_torsion: -ratio * stiffness,
            by_motor: brake / ratio - ratio * damping,
            by_link: ratio * damping,
        }
    }
}
