//! State of a plant, its derivative, and the modes of its motors.

use crate::scalar::Real;

/// State: angles [rad] and velocities [rad/s] of motors and links, and the states of effects.
#[derive(Clone, Copy, Debug)]
pub struct State<R, const N: usize> {
    /// theta_M.
    pub motor_angle: [R; N],
    /// dtheta_M.
    pub motor_velocity: [R; N],
    /// theta_L.
    pub link_angle: [R; N],
    /// dtheta_L.
    pub link_velocity: [R; N],
    /// z, hysteresis torque relative to its largest, within [-1, 1]; zero without hysteresis.
    pub hysteresis: [R; N],
    /// Angles of flexible parts in space; unused without them.
    pub part_angle: [R; N],
    /// Velocities of flexible parts in space.
    pub part_velocity: [R; N],
    /// s [N m] of the springs under the bases; unused for rigid bases.
    pub base_torque: [R; N],
    /// ds [N m/s].
    pub base_torque_rate: [R; N],
}

/// Accelerations [rad/s^2].
#[derive(Clone, Copy, Debug)]
pub struct Acceleration<R, const N: usize> {
    /// ddtheta_M.
    pub motor: [R; N],
    /// ddtheta_L.
    pub link: [R; N],
    /// Accelerations of the flexible parts, in space.
    pub part: [R; N],
    /// dds [N m/s^2] of the springs under the bases.
    pub base: [R; N],
}

/// Friction mode of each motor during a step.
///
/// `direction` is +1 or -1 while the motor slides in that direction against the Coulomb torque, and
/// 0 while it is held; `free` is 1 while it slides and 0 while it is held: it sticks, or settles at
/// the rate `-dtheta_M / tau`. A joint without Coulomb friction is always free, with direction 0.
#[derive(Clone, Copy, Debug)]
pub struct Modes<R, const N: usize> {
    /// Sign that Coulomb friction opposes.
    pub direction: [R; N],
    /// 1 sliding, 0 held.
    pub free: [R; N],
}

impl<R: Real, const N: usize> Modes<R, N> {
    /// Whether a motor slides in every lane.
    #[inline(always)]
    pub(super) fn all_free(&self, joint: usize) -> bool {
        !(self.free[joint] - 1.0).any_negative()
    }
}

impl<R: Real, const N: usize> State<R, N> {
    /// All angles, velocities and states zero.
    pub(crate) fn zero() -> Self {
        let zero = [R::splat(0.0); N];
        Self {
            motor_angle: zero,
            motor_velocity: zero,
            link_angle: zero,
            link_velocity: zero,
            hysteresis: zero,
            part_angle: zero,
            part_velocity: zero,
            base_torque: zero,
            base_torque_rate: zero,
        }
    }

    /// Copies what a step changes.
    #[inline(always)]
    pub(crate) fn copy_from<const EFFECTS: bool>(&mut self, other: &Self) {
        if EFFECTS {
            *self = *other;
            return;
        }
        self.motor_angle = other.motor_angle;
        self.motor_velocity = other.motor_velocity;
        self.link_angle = other.link_angle;
        self.link_velocity = other.link_velocity;
    }

    /// Sets q + t q', q' + t a, the second stage of a step, and returns the rotations of the links.
    #[inline(always)]
    pub(super) fn set_second<const EFFECTS: bool>(
        &mut self,
        begin: &Self,
        t: R,
        a: &Acceleration<R, N>,
    ) -> [R; N] {
        let mut rotation = begin.link_velocity;
        for i in 0..N {
            rotation[i] = t * begin.link_velocity[i];
            self.motor_angle[i] = t.mul_add(begin.motor_velocity[i], begin.motor_angle[i]);
            self.link_angle[i] = begin.link_angle[i] + rotation[i];
            self.motor_velocity[i] = t.mul_add(a.motor[i], begin.motor_velocity[i]);
            self.link_velocity[i] = t.mul_add(a.link[i], begin.link_velocity[i]);
            if EFFECTS {
                self.part_angle[i] = t.mul_add(begin.part_velocity[i], begin.part_angle[i]);
                self.part_velocity[i] = t.mul_add(a.part[i], begin.part_velocity[i]);
                self.base_torque[i] = t.mul_add(begin.base_torque_rate[i], begin.base_torque[i]);
                self.base_torque_rate[i] = t.mul_add(a.base[i], begin.base_torque_rate[i]);
            }
        }
        rotation
    }

    /// Sets q + t q' + s a, q' + r b, a later stage of a step or its end, and returns the rotations of
    /// the links.
    #[inline(always)]
    pub(super) fn set_later<const EFFECTS: bool>(
        &mut self,
        begin: &Self,
        t: R,
        s: R,
        a: &Acceleration<R, N>,
        r: R,
        b: &Acceleration<R, N>,
    ) -> [R; N] {
        let mut rotation = begin.link_velocity;
        for i in 0..N {
            rotation[i] = s.mul_add(a.link[i], t * begin.link_velocity[i]);
            self.motor_angle[i] = s.mul_add(
                a.motor[i],
                t.mul_add(begin.motor_velocity[i], begin.motor_angle[i]),
            );
            self.link_angle[i] = begin.link_angle[i] + rotation[i];
            self.motor_velocity[i] = r.mul_add(b.motor[i], begin.motor_velocity[i]);
            self.link_velocity[i] = r.mul_add(b.link[i], begin.link_velocity[i]);
            if EFFECTS {
                self.part_angle[i] = s.mul_add(
                    a.part[i],
                    t.mul_add(begin.part_velocity[i], begin.part_angle[i]),
                );
                self.part_velocity[i] = r.mul_add(b.part[i], begin.part_velocity[i]);
                self.base_torque[i] = s.mul_add(
                    a.base[i],
                    t.mul_add(begin.base_torque_rate[i], begin.base_torque[i]),
                );
                self.base_torque_rate[i] = r.mul_add(b.base[i], begin.base_torque_rate[i]);
            }
        }
        rotation
    }
}

impl<R: Real, const N: usize> Acceleration<R, N> {
    #[inline(always)]
    pub(super) fn plus<const EFFECTS: bool>(&self, other: &Self) -> Self {
        let mut total = *self;
        for i in 0..N {
            total.motor[i] = total.motor[i] + other.motor[i];
            total.link[i] = total.link[i] + other.link[i];
            if EFFECTS {
                total.part[i] = total.part[i] + other.part[i];
                total.base[i] = total.base[i] + other.base[i];
            }
        }
        total
    }
}
