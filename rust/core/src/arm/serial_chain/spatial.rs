//! Equations of motion of a chain in the axes of the base, a register of links at a time.
//!
//! Motions and forces are spatial vectors about the origin of the first link (Featherstone, Rigid
//! Body Dynamics Algorithms, 2008, chapter 2): angular before linear, moment before force. Links
//! differ in the sums along the chain only, so all other arithmetic is the same for a register of
//! links.

use super::posture::{Posture, ROOM, Rows, load, load_constants, padded, store, zeros};
use super::vector::{Matrix, Vector, cross, dot, plus, scaled, splat, times, times_transposed};
use super::{LINK_PARAMETER_COUNT, SerialChain};

use crate::arm::{Arm, Slopes};
use crate::scalar::Real;

/// m, m c and I about the link's origin.
pub(super) struct Inertia<R> {
    mass: R,
    first_moment: Vector<R>,
    second_moment: Matrix<R>,
}

impl<R: Real> Inertia<R> {
    #[inline(always)]
    pub(super) fn of(base: &[R; LINK_PARAMETER_COUNT]) -> Self {
        let [mass, x, y, z, xx, xy, yy, xz, yz, zz] = *base;
        Self {
            mass,
            first_moment: [x, y, z],
            second_moment: [[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]],
        }
    }

    /// Force and moment about the origin for given accelerations: f = m s + alpha x h, n = I alpha
    /// + h x s.
    #[inline(always)]
    pub(super) fn accelerated(&self, turning: &Vector<R>, force: &Vector<R>) -> [Vector<R>; 2] {
        let h = &self.first_moment;
        [
            scaled(self.mass, force, &cross(turning, h)),
            plus(&times(&self.second_moment, turning), &cross(h, force)),
        ]
    }

    /// The same body in the frame of the preceding link: R I R' with the rotation R, moved by r, with
    /// 2 r w E - r w' - w r', w = R h + m r / 2.
    #[inline(always)]
    pub(super) fn seen_from(&self, turn: &Matrix<R>, r: &Vector<R>) -> Self {
        let h = times(turn, &self.first_moment);
        let half = self.mass * 0.5;
        let (w, moved) = (scaled(half, r, &h), scaled(self.mass, r, &h));
        let mut columns = *turn;
        let mut products = w;
        for i in 0..3 {
            columns[i] = times(&self.second_moment, &turn[i]);
            products[i] = (r[i] + r[i]) * w[i];
        }
        let mut second_moment = self.second_moment;
        for i in 0..3 {
            for j in i..3 {
                let rotated = dot(&turn[i], &columns[j]);
                second_moment[i][j] = if i == j {
                    rotated + (products[(i + 1) % 3] + products[(i + 2) % 3])
                } else {
                    rotated - r[i].mul_add(w[j], r[j] * w[i])
                };
                second_moment[j][i] = second_moment[i][j];
            }
        }
        Self {
            mass: self.mass,
            first_moment: moved,
            second_moment,
        }
    }

    /// The parameters in their order.
    #[inline(always)]
    fn parameters(&self) -> [R; LINK_PARAMETER_COUNT] {
        let ([x, y, z], i) = (self.first_moment, &self.second_moment);
        [
            self.mass, x, y, z, i[0][0], i[0][1], i[1][1], i[0][2], i[1][2], i[2][2],
        ]
    }
}

/// Angular and linear part of a spatial vector.
#[inline(always)]
fn parts<R: Real>(&[a, b, c, d, e, f]: &[R; 6]) -> [Vector<R>; 2] {
    [[a, b, c], [d, e, f]]
}

#[inline(always)]
fn join<R: Real>([angular, linear]: [Vector<R>; 2]) -> [R; 6] {
    let ([a, b, c], [d, e, f]) = (angular, linear);
    [a, b, c, d, e, f]
}

/// Cross product of two motions.
#[inline(always)]
fn motion_cross<R: Real>(a: &[R; 6], b: &[R; 6]) -> [R; 6] {
    let ([omega, v], [w, u]) = (parts(a), parts(b));
    join([cross(&omega, &w), plus(&cross(&omega, &u), &cross(&v, &w))])
}

/// Cross product of a motion and a force.
#[inline(always)]
fn force_cross<R: Real>(a: &[R; 6], f: &[R; 6]) -> [R; 6] {
    let ([omega, v], [moment, force]) = (parts(a), parts(f));
    join([
        plus(&cross(&omega, &moment), &cross(&v, &force)),
        cross(&omega, &force),
    ])
}

#[inline(always)]
fn sum<R: Real, const K: usize>(a: &[R; K], b: &[R; K]) -> [R; K] {
    let mut all = *a;
    for k in 0..K {
        all[k] = a[k] + b[k];
    }
    all
}

#[inline(always)]
fn times_number<R: Real>(a: &[R; 6], by: R) -> [R; 6] {
    let mut all = *a;
    for k in 0..6 {
        all[k] = a[k] * by;
    }
    all
}

impl<R: Real> Inertia<R> {
    /// Force of a motion.
    #[inline(always)]
    fn force(&self, motion: &[R; 6]) -> [R; 6] {
        let [angular, linear] = parts(motion);
        let [force, moment] = self.accelerated(&angular, &linear);
        join([moment, force])
    }
}

/// Adds to each link the sum of the preceding ones; `before` is the sum of the links before the
/// packs, and becomes that of the links before the next ones. If it `is_zero`, it is not added.
#[inline(always)]
fn sum_outwards<R: Real, const K: usize>(
    packs: &[R::Pack; K],
    before: &mut [R::Pack; K],
    is_zero: bool,
) -> [R::Pack; K] {
    let mut all = *packs;
    for k in 0..K {
        if R::PACKED > 1 {
            all[k] = all[k] + R::shift_up(all[k], false, 0.0);
        }
        if R::PACKED > 2 {
            all[k] = all[k] + R::shift_up(all[k], true, 0.0);
        }
        if !is_zero {
            all[k] = all[k] + before[k];
        }
        before[k] = R::spread_end(all[k], true);
    }
    all
}

/// Adds to each link the sum of those behind it, as [`sum_outwards`].
#[inline(always)]
fn sum_inwards<R: Real, const K: usize>(
    packs: &[R::Pack; K],
    behind: &mut [R::Pack; K],
    is_zero: bool,
) -> [R::Pack; K] {
    let mut all = *packs;
    for k in 0..K {
        if R::PACKED > 1 {
            all[k] = all[k] + R::shift_down(all[k], false);
        }
        if R::PACKED > 2 {
            all[k] = all[k] + R::shift_down(all[k], true);
        }
        if !is_zero {
            all[k] = all[k] + behind[k];
        }
        behind[k] = R::spread_end(all[k], false);
    }
    all
}

/// Products of the vectors of the first links with one vector.
#[inline(always)]
fn products<R: Real, const K: usize, const W: usize>(
    rows: &Rows<R, K, W>,
    vector: &[R; K],
    count: usize,
) -> [R; W] {
    let mut all = [R::splat(0.0); W];
    for first in (0..count).step_by(R::PACKED) {
        let mut sum = R::pack(&rows[0][first..]) * vector[0].spread();
        for k in 1..K {
            sum = R::pack(&rows[k][first..]).mul_add(vector[k].spread(), sum);
        }
        R::unpack(sum, &mut all[first..]);
    }
    all
}

/// The vector of one link.
#[inline(always)]
fn of_link<R: Real, const K: usize, const W: usize>(rows: &Rows<R, K, W>, i: usize) -> [R; K] {
    let mut all = [rows[0][i]; K];
    for k in 1..K {
        all[k] = rows[k][i];
    }
    all
}

/// Frames of links: rotations and origins.
#[derive(Clone, Copy)]
struct Frames<P> {
    turn: Matrix<P>,
    origin: Vector<P>,
}

impl<P: Real> Frames<P> {
    #[inline(always)]
    fn identity() -> Self {
        let (zero, one) = (P::splat(0.0), P::splat(1.0));
        Self {
            turn: [[one, zero, zero], [zero, one, zero], [zero, zero, one]],
            origin: [zero; 3],
        }
    }

    /// A frame that is given in this one.
    #[inline(always)]
    fn then(&self, next: &Self) -> Self {
        let mut all = *self;
        for a in 0..3 {
            let row = &self.turn[a];
            all.origin[a] = self.origin[a] + dot(row, &next.origin);
            for b in 0..3 {
                let two = row[1].mul_add(next.turn[1][b], row[2] * next.turn[2][b]);
                all.turn[a][b] = row[0].mul_add(next.turn[0][b], two);
            }
        }
        all
    }
}

/// Frames moved up by one or two places.
#[inline(always)]
fn shift_up<R: Real>(frames: &Frames<R::Pack>, two: bool) -> Frames<R::Pack> {
    let mut all = *frames;
    for a in 0..3 {
        all.origin[a] = R::shift_up(frames.origin[a], two, 0.0);
        for b in 0..3 {
            let fill = if a == b { 1.0 } else { 0.0 };
            all.turn[a][b] = R::shift_up(frames.turn[a][b], two, fill);
        }
    }
    all
}

/// Motions, inertias and forces of a pack of links, and the twists of their joints.
struct Links<P> {
    twist: [P; 6],
    velocity: [P; 6],
    /// Minus gravity.
    acceleration: [P; 6],
    inertia: Inertia<P>,
    force: [P; 6],
}

/// What the links before a pack add to it.
struct Before<P> {
    frame: Frames<P>,
    velocity: [P; 6],
    acceleration: [P; 6],
}

impl<const N: usize, const KNOWN: bool> SerialChain<N, KNOWN> {
    /// Frames of a pack of links.
    #[inline(always)]
    fn frames<R: Real>(
        &self,
        at: &Posture<R>,
        before: &mut Frames<R::Pack>,
        first: usize,
    ) -> Frames<R::Pack> {
        let placed = &self.placements;
        let turn = at.turn(first);
        let mut all = *before;
        for a in 0..3 {
            let cos = load_constants::<R, 3>(&placed.cos[a], first);
            let sin = load_constants::<R, 3>(&placed.sin[a], first);
            let fixed = load_constants::<R, 3>(&placed.fixed[a], first);
            all.turn[a] = scaled(turn.cos, &cos, &scaled(turn.sin, &sin, &fixed));
        }
        let slide = load_constants::<R, 3>(&placed.slide, first);
        let position = load_constants::<R, 3>(&placed.position, first);
        all.origin = scaled(R::pack(&at.shift[first..]), &slide, &position);
        if R::PACKED > 1 {
            all = shift_up::<R>(&all, false).then(&all);
        }
        if R::PACKED > 2 {
            all = shift_up::<R>(&all, true).then(&all);
        }
        if first > 0 {
            all = before.then(&all);
        }
        for a in 0..3 {
            before.origin[a] = R::spread_end(all.origin[a], true);
            for b in 0..3 {
                before.turn[a][b] = R::spread_end(all.turn[a][b], true);
            }
        }
        all
    }

    /// The base, before the first link.
    #[inline(always)]
    fn before_links<P: Real>(&self) -> Before<P> {
        let zero = [P::splat(0.0); 3];
        let gravity: Vector<P> = splat(&self.gravity);
        Before {
            frame: Frames::identity(),
            velocity: join([zero; 2]),
            acceleration: join([zero, [-gravity[0], -gravity[1], -gravity[2]]]),
        }
    }

    /// Motions and forces of a pack of links.
    #[inline(always)]
    fn links<R: Real>(
        &self,
        base: &Rows<R, LINK_PARAMETER_COUNT>,
        at: &Posture<R>,
        [dq, ddq]: &Rows<R, 2>,
        before: &mut Before<R::Pack>,
        first: usize,
    ) -> Links<R::Pack> {
        let Frames { turn, origin } = self.frames(at, &mut before.frame, first);
        let [dq, ddq] = [R::pack(&dq[first..]), R::pack(&ddq[first..])];
        let axis = load_constants::<R, 3>(&self.placements.axis, first);
        let [turning, moving] = load_constants::<R, 2>(&self.placements.types, first);
        let (direction, zero) = (times(&turn, &axis), [R::splat(0.0).spread(); 3]);
        let w = scaled(turning, &direction, &zero);
        let twist = join([w, scaled(moving, &direction, &cross(&origin, &w))]);
        let own = times_number(&twist, dq);
        let velocity = sum_outwards::<R, 6>(&own, &mut before.velocity, first == 0);
        let own = times_number(&motion_cross(&velocity, &twist), dq);
        let own = sum(&own, &times_number(&twist, ddq));
        let acceleration = sum_outwards::<R, 6>(&own, &mut before.acceleration, false);
        let body = Inertia::of(&load::<R, LINK_PARAMETER_COUNT, _>(base, first));
        let inertia = body.seen_from(&turn, &origin);
        let momentum = inertia.force(&velocity);
        let force = sum(
            &inertia.force(&acceleration),
            &force_cross(&velocity, &momentum),
        );
        Links {
            twist,
            velocity,
            acceleration,
            inertia,
            force,
        }
    }

    /// Inertia matrix up to the diagonal by composite rigid bodies, and torques by the recursion of
    /// Newton and Euler.
    #[inline(always)]
    pub(super) fn dynamics<R: Real>(
        &self,
        base: &Rows<R, LINK_PARAMETER_COUNT>,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> ([[R; N]; N], [R; N]) {
        let motion = [padded(dq), padded(ddq)];
        let mut before = self.before_links();
        let (mut twists, mut forces) = (zeros::<R, 6, ROOM>(), zeros::<R, 6, ROOM>());
        let mut inertias = zeros::<R, LINK_PARAMETER_COUNT, ROOM>();
        for first in (0..self.joints()).step_by(R::PACKED) {
            let links = self.links(base, at, &motion, &mut before, first);
            store::<R, 6, _>(&links.twist, &mut twists, first);
            store::<R, LINK_PARAMETER_COUNT, _>(&links.inertia.parameters(), &mut inertias, first);
            store::<R, 6, _>(&links.force, &mut forces, first);
        }
        let zero = R::splat(0.0).spread();
        let (mut force, mut inertia) = ([zero; 6], [zero; LINK_PARAMETER_COUNT]);
        let mut torques = zeros::<R, 1, ROOM>();
        for first in (0..self.joints()).step_by(R::PACKED).rev() {
            let is_last = first + R::PACKED >= self.joints();
            let twist = load::<R, 6, _>(&twists, first);
            let f = sum_inwards::<R, 6>(&load::<R, 6, _>(&forces, first), &mut force, is_last);
            let mut torque = twist[0] * f[0];
            for k in 1..6 {
                torque = twist[k].mul_add(f[k], torque);
            }
            R::unpack(torque, &mut torques[0][first..]);
            let own = load::<R, LINK_PARAMETER_COUNT, _>(&inertias, first);
            let body = Inertia::of(&sum_inwards::<R, LINK_PARAMETER_COUNT>(
                &own,
                &mut inertia,
                is_last,
            ));
            store::<R, 6, _>(&body.force(&twist), &mut forces, first);
        }
        let mut all = [[R::splat(0.0); N]; N];
        for j in 0..self.joints() {
            let row = products(&twists, &of_link(&forces, j), j + 1);
            all[j].copy_from_slice(&row[..N]);
        }
        let mut bias = [R::splat(0.0); N];
        bias.copy_from_slice(&torques[0][..N]);
        (all, bias)
    }

    /// Inertia matrix, and derivatives of the torques with respect to angles and velocities.
    ///
    /// A motion of joint j rotates and shifts all links behind it, except for what the links before
    /// it contribute to their motion (Singh, Russell and Wensing, IEEE RA-L 7(2), 2022). With psi =
    /// v x S, phi = a x S + v x psi, and the sums I, f and 2 B over the links from max(i, j):
    ///
    /// - by angles: S_i' (I phi_j + 2 B psi_j), plus S_i' (S_j x f) for i < j
    /// - by velocities: S_i' (2 I psi_j + 2 B S_j)
    #[inline(always)]
    pub(super) fn linearised<R: Real>(
        &self,
        base: &Rows<R, LINK_PARAMETER_COUNT>,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> ([[R; N]; N], Slopes<R, N>) {
        if R::PACKED == 1 {
            self.linearised_in::<R, N>(base, at, dq, ddq) // no room to clear beyond the joints
        } else {
            self.linearised_in::<R, ROOM>(base, at, dq, ddq)
        }
    }

    /// [`SerialChain::linearised`] with rows of `W` joints.
    #[inline(always)]
    fn linearised_in<R: Real, const W: usize>(
        &self,
        base: &Rows<R, LINK_PARAMETER_COUNT>,
        at: &Posture<R>,
        dq: &[R; N],
        ddq: &[R; N],
    ) -> ([[R; N]; N], Slopes<R, N>) {
        let motion = [padded(dq), padded(ddq)];
        let mut before = self.before_links();
        let [mut twists, mut forces, mut psis, mut phis] = [zeros::<R, 6, W>(); 4];
        let mut inertias = zeros::<R, LINK_PARAMETER_COUNT, W>();
        let mut couplings = zeros::<R, COUPLING_ENTRIES, W>();
        for first in (0..self.joints()).step_by(R::PACKED) {
            let links = self.links(base, at, &motion, &mut before, first);
            let psi = motion_cross(&links.velocity, &links.twist);
            let phi = sum(
                &motion_cross(&links.acceleration, &links.twist),
                &motion_cross(&links.velocity, &psi),
            );
            let coupling = Coupling::new(&links.inertia, &links.velocity);
            store::<R, 6, _>(&links.twist, &mut twists, first);
            store::<R, 6, _>(&psi, &mut psis, first);
            store::<R, 6, _>(&phi, &mut phis, first);
            store::<R, 6, _>(&links.force, &mut forces, first);
            store::<R, LINK_PARAMETER_COUNT, _>(&links.inertia.parameters(), &mut inertias, first);
            store::<R, COUPLING_ENTRIES, _>(&coupling.entries(), &mut couplings, first);
        }
        let zero = R::splat(0.0).spread();
        let (mut force, mut inertia) = ([zero; 6], [zero; LINK_PARAMETER_COUNT]);
        let mut coupling = [zero; COUPLING_ENTRIES];
        // per joint: I S, and the forces of its angle and of its velocity
        let [mut by_acceleration, mut by_angle, mut by_velocity] = [zeros::<R, 6, W>(); 3];
        let mut back = zeros::<R, 3, W>();
        for first in (0..self.joints()).step_by(R::PACKED).rev() {
            let is_last = first + R::PACKED >= self.joints();
            let f = sum_inwards::<R, 6>(&load::<R, 6, _>(&forces, first), &mut force, is_last);
            let own = load::<R, LINK_PARAMETER_COUNT, _>(&inertias, first);
            let body = Inertia::of(&sum_inwards::<R, LINK_PARAMETER_COUNT>(
                &own,
                &mut inertia,
                is_last,
            ));
            let own = load::<R, COUPLING_ENTRIES, _>(&couplings, first);
            let own = sum_inwards::<R, COUPLING_ENTRIES>(&own, &mut coupling, is_last);
            let coupling = Coupling::of(&own);
            let twist = load::<R, 6, _>(&twists, first);
            let (psi, phi) = (load::<R, 6, _>(&psis, first), load::<R, 6, _>(&phis, first));
            store::<R, 6, _>(&body.force(&twist), &mut by_acceleration, first);
            let moved = sum(&force_cross(&twist, &f), &coupling.force(&psi));
            store::<R, 6, _>(&sum(&body.force(&phi), &moved), &mut by_angle, first);
            let inertial = body.force(&psi);
            let turned = sum(&sum(&inertial, &inertial), &coupling.force(&twist));
            store::<R, 6, _>(&turned, &mut by_velocity, first);
            store::<R, 3, _>(&coupling.transposed(&twist), &mut back, first);
        }
        let mut all = [[R::splat(0.0); N]; N];
        let (angle, velocity) = (all, all);
        let mut slopes = Slopes { angle, velocity };
        for j in 0..self.joints() {
            let own = of_link(&by_acceleration, j);
            let row = products(&twists, &own, j + 1);
            let angle = products(&twists, &of_link(&by_angle, j), j + 1);
            let velocity = products(&twists, &of_link(&by_velocity, j), j + 1);
            for i in 0..=j {
                (all[j][i], all[i][j]) = (row[i], row[i]);
                (slopes.angle[i][j], slopes.velocity[i][j]) = (angle[i], velocity[i]);
            }
            // the torque of joint j by the motion of the joints before it
            let turning = of_link(&back, j);
            let angle = products(&phis, &own, j);
            let angle_by_rate = products(rotations(&psis), &turning, j);
            let velocity = products(&psis, &own, j);
            let velocity_by_rate = products(rotations(&twists), &turning, j);
            for i in 0..j {
                slopes.angle[j][i] = angle[i] + angle_by_rate[i];
                slopes.velocity[j][i] = velocity[i] + velocity[i] + velocity_by_rate[i];
            }
        }
        (all, slopes)
    }
}

/// The angular parts of vectors.
#[inline(always)]
fn rotations<R, const W: usize>(rows: &Rows<R, 6, W>) -> &Rows<R, 3, W> {
    rows.first_chunk().expect("six rows")
}

/// Entries of a [`Coupling`].
const COUPLING_ENTRIES: usize = 12;

/// The operator 2 B = v x I - I v x + (I v) x on motions (w, u): a moment -2 G w and a force 2 w x
/// p with the momentum p. G w = omega x (T w) + h x (v x w) with the second moment of mass T.
struct Coupling<P> {
    matrix: Matrix<P>,
    momentum: Vector<P>,
}

impl<P: Real> Coupling<P> {
    #[inline(always)]
    fn new(body: &Inertia<P>, velocity: &[P; 6]) -> Self {
        let [omega, v] = parts(velocity);
        let (h, i) = (&body.first_moment, &body.second_moment);
        let half = (i[0][0] + i[1][1] + i[2][2]) * 0.5;
        let along = dot(h, &v);
        let mut matrix = *i;
        for b in 0..3 {
            // column b of T
            let mut column = [-i[0][b], -i[1][b], -i[2][b]];
            column[b] = column[b] + half;
            let turned = cross(&omega, &column);
            for a in 0..3 {
                matrix[a][b] = v[a].mul_add(h[b], turned[a]);
            }
            matrix[b][b] = matrix[b][b] - along;
        }
        Self {
            matrix,
            momentum: scaled(body.mass, &v, &cross(&omega, h)),
        }
    }

    #[inline(always)]
    fn entries(&self) -> [P; COUPLING_ENTRIES] {
        let ([a, b, c], [x, y, z]) = (self.matrix, self.momentum);
        [
            a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2], x, y, z,
        ]
    }

    #[inline(always)]
    fn of(&[a, b, c, d, e, f, g, h, i, x, y, z]: &[P; COUPLING_ENTRIES]) -> Self {
        Self {
            matrix: [[a, b, c], [d, e, f], [g, h, i]],
            momentum: [x, y, z],
        }
    }

    /// Force for a motion.
    #[inline(always)]
    fn force(&self, motion: &[P; 6]) -> [P; 6] {
        let [w, _] = parts(motion);
        let (moment, force) = (times(&self.matrix, &w), cross(&w, &self.momentum));
        let zero = [P::splat(0.0); 3];
        join([
            scaled(P::splat(-2.0), &moment, &zero),
            scaled(P::splat(2.0), &force, &zero),
        ])
    }

    /// Angular part of the transposed operator, whose linear part is zero.
    #[inline(always)]
    fn transposed(&self, motion: &[P; 6]) -> Vector<P> {
        let [w, u] = parts(motion);
        let moment = times_transposed(&self.matrix, &w);
        let force = cross(&self.momentum, &u);
        let zero = [P::splat(0.0); 3];
        let two = P::splat(2.0);
        scaled(two, &force, &scaled(-two, &moment, &zero))
    }
}
