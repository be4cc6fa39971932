/* Peer of bench_arm.py: the equations of the two-link arm in plain C, fourth-order Runge-Kutta.
 *
 * bench_arm.py writes arm_values.h with the parameters of the simulated arm and compiles this file with several
 * sets of flags. Three-slope gears have sharp knees; friction follows the sign of the motor velocity, without
 * events; the torque of the current loop is exact at the beginning, middle and end of a step. Prints the time of
 * a step in ns. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

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

/* (1) and (2): x' for the state x and the motor torques tau. */
static inline __attribute__((always_inline)) State field(const Arm *p, State x, double tau1, double tau2)
{
    double s = sin(x.l2), c = cos(x.l2);
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
    double least = 1e9;
    volatile double sink = 0;
    for (int round = 0; round < 7; round++) {
        State x = {0};
        double tau1 = 0, tau2 = 0, begin = now();
        for (int k = 0; k < ticks; k++)
            for (int i = 0; i < per_tick; i++)
                x = step(&ARM, x, &tau1, &tau2, goal[2 * k], goal[2 * k + 1], clock);
        least = fmin(least, (now() - begin) / steps);
        sink += x.m1 + x.m2 + x.l1 + x.l2;
    }
    printf("%.2f\n", 1e9 * least);
    return isnan(sink);
}
