/* The peer to be measured against: the two-link arm's equations in plain C, fourth-order
 * Runge-Kutta, as a good C programmer would write them and let the compiler do the rest.
 *
 * bench_arm.py writes arm_values.h, the parameters of the very arm that strainwave simulates, compiles this
 * with several sets of flags and takes the best of each figure; which of them vectorises the lanes' loop
 * depends on the compiler.
 *
 * Three-slope gears with sharp knees, friction by the sign of the motor velocity (no events), the
 * current loop's torque exact at a step's begin, middle and end. Prints ns a step of one trajectory
 * and, with the lanes' loop vectorised by the compiler, of LANES trajectories side by side. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

enum { LANES = 16 };

typedef struct {
    double alpha, beta, gamma;
    double n[2], mobility[2], d_m[2], f[2], d_l[2], d_g[2], k[2][3], knee[2][2]; /* knees: torsion */
} Arm;

#include "arm_values.h" /* static const Arm ARM, static const double TORQUE[2] at full voltage */

static inline __attribute__((always_inline)) double positive(double x) { return x > 0 ? x : 0; }

static inline __attribute__((always_inline)) double spring(const Arm *p, int i, double delta)
{
    double x = fabs(delta);
    double t = p->k[i][0] * x + (p->k[i][1] - p->k[i][0]) * positive(x - p->knee[i][0])
             + (p->k[i][2] - p->k[i][1]) * positive(x - p->knee[i][1]);
    return copysign(t, delta);
}

typedef struct { double m1, m2, l1, l2, vm1, vm2, vl1, vl2; } State; /* angles, velocities */

/* (1) and (2): x' for the state x and the motor torques tau. The cosine is a shifted sine because
 * the compiler would merge sine and cosine into one call, of which there is no vector version. */
static inline __attribute__((always_inline)) State field(const Arm *p, State x, double tau1, double tau2)
{
    double s = sin(x.l2), c = sin(x.l2 + M_PI_2);
    double t1 = spring(p, 0, p->n[0] * x.m1 - x.l1) + p->d_g[0] * (p->n[0] * x.vm1 - x.vl1);
    double t2 = spring(p, 1, p->n[1] * x.m2 - x.l2) + p->d_g[1] * (p->n[1] * x.vm2 - x.vl2);
    double m12 = p->beta + p->gamma * c, m11 = p->alpha + m12 + p->gamma * c, m22 = p->beta;
    double r1 = t1 - p->d_l[0] * x.vl1 + p->gamma * s * x.vl2 * (2 * x.vl1 + x.vl2);
    double r2 = t2 - p->d_l[1] * x.vl2 - p->gamma * s * x.vl1 * x.vl1;
    double scale = 1 / (m11 * m22 - m12 * m12);
    return (State){
        x.vm1, x.vm2, x.vl1, x.vl2,
        (tau1 - p->d_m[0] * x.vm1 - copysign(p->f[0], x.vm1) - p->n[0] * t1) * p->mobility[0],
        (tau2 - p->d_m[1] * x.vm2 - copysign(p->f[1], x.vm2) - p->n[1] * t2) * p->mobility[1],
        (m22 * r1 - m12 * r2) * scale, (m11 * r2 - m12 * r1) * scale,
    };
}

static inline __attribute__((always_inline)) State along(State x, double h, State k)
{
    return (State){x.m1 + h * k.m1, x.m2 + h * k.m2, x.l1 + h * k.l1, x.l2 + h * k.l2,
                   x.vm1 + h * k.vm1, x.vm2 + h * k.vm2, x.vl1 + h * k.vl1, x.vl2 + h * k.vl2};
}

typedef struct { double h, decay_half, decay; } Clock;

static inline __attribute__((always_inline)) State step(const Arm *p, State x, double *tau1, double *tau2, double goal1, double goal2, Clock c)
{
    double middle1 = goal1 + (*tau1 - goal1) * c.decay_half, middle2 = goal2 + (*tau2 - goal2) * c.decay_half;
    double end1 = goal1 + (*tau1 - goal1) * c.decay, end2 = goal2 + (*tau2 - goal2) * c.decay;
    State k1 = field(p, x, *tau1, *tau2);
    State k2 = field(p, along(x, 0.5 * c.h, k1), middle1, middle2);
    State k3 = field(p, along(x, 0.5 * c.h, k2), middle1, middle2);
    State k4 = field(p, along(x, c.h, k3), end1, end2);
    *tau1 = end1, *tau2 = end2;
    return along(along(along(along(x, c.h / 6, k1), c.h / 3, k2), c.h / 3, k3), c.h / 6, k4);
}

static double now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return t.tv_sec + 1e-9 * t.tv_nsec;
}

int main(int argc, char **argv)
{
    int steps = argc > 1 ? atoi(argv[1]) : 80000, per_tick = 8, ticks = steps / per_tick;
    double h = 1.25e-4, w = 2 * M_PI * 1000;
    Clock clock = {h, exp(-w * h / 2), exp(-w * h)};
    double *goal = malloc(2 * ticks * sizeof *goal);
    unsigned seed = 1;
    for (int k = 0; k < 2 * ticks; k++) {
        seed = seed * 1664525u + 1013904223u;
        goal[k] = (seed >> 31 ? 1 : -1) * TORQUE[k % 2];
    }
    double one = 1e9, all = 1e9;
    volatile double sink = 0;
    for (int round = 0; round < 7; round++) {
        State x = {0};
        double tau1 = 0, tau2 = 0, begin = now();
        for (int k = 0; k < ticks; k++)
            for (int i = 0; i < per_tick; i++)
                x = step(&ARM, x, &tau1, &tau2, goal[2 * k], goal[2 * k + 1], clock);
        one = fmin(one, (now() - begin) / steps);
        sink += x.m1 + x.m2 + x.l1 + x.l2;

        static double m1[LANES], m2[LANES], l1[LANES], l2[LANES];
        static double vm1[LANES], vm2[LANES], vl1[LANES], vl2[LANES], t1[LANES], t2[LANES];
        for (int l = 0; l < LANES; l++) {
            m1[l] = 1e-6 * l;
            m2[l] = l1[l] = l2[l] = vm1[l] = vm2[l] = vl1[l] = vl2[l] = t1[l] = t2[l] = 0;
        }
        begin = now();
        for (int k = 0; k < ticks; k++)
            for (int i = 0; i < per_tick; i++)
#pragma omp simd
                for (int l = 0; l < LANES; l++) {
                    State y = {m1[l], m2[l], l1[l], l2[l], vm1[l], vm2[l], vl1[l], vl2[l]};
                    double a = t1[l], b = t2[l];
                    y = step(&ARM, y, &a, &b, goal[2 * k], goal[2 * k + 1], clock);
                    m1[l] = y.m1, m2[l] = y.m2, l1[l] = y.l1, l2[l] = y.l2;
                    vm1[l] = y.vm1, vm2[l] = y.vm2, vl1[l] = y.vl1, vl2[l] = y.vl2;
                    t1[l] = a, t2[l] = b;
                }
        all = fmin(all, (now() - begin) / steps);
        for (int l = 0; l < LANES; l++) sink += m1[l] + l2[l];
    }
    printf("C, one trajectory   %7.1f ns a step\n", 1e9 * one);
    printf("C, %d side by side  %7.1f ns a step for all, %.1f each\n", LANES, 1e9 * all, 1e9 * all / LANES);
    return isnan(sink);
}
