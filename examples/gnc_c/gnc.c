/* A small GNC for the bench: a complementary filter on poses and IMU, and on/off control with a dead band.
 *
 * As a shared library:  cc -O2 -fPIC -shared -I"$(hil gnc header --folder)" gnc.c -o mygnc.so -lm
 *                       hil run scheme-1 --set gnc.library=mygnc.so
 * As a program:         see gnc_udp.c
 *
 * Filter. Between poses the gyro propagates the attitude, and the accelerometer together with the relative motion on
 * an orbit (Hill, Clohessy and Wiltshire) propagates the position. A pose corrects the estimate at its time of
 * exposure, with gains given by one bandwidth. The position observer also estimates the accelerometer's bias; that of
 * the attitude needs none, the gyros drift slowly.
 *
 * Control. The switching function of each axis is s = error + lead * rate. The axis fires against s from the edge of a
 * dead band until s has returned to a fraction of it; a large error is corrected at a limited rate.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "hil_gnc.h"

static const double BANDWIDTH_RADPS = 0.15;    /* of the position observer */
static const double SETTLED_S = 10.0;          /* after the first pose; from then on the estimate is sent */
static const double ATTITUDE_GAIN = 0.15;     /* fraction of an attitude difference that a pose corrects */
static const double LONGEST_GAP_S = 1.0;       /* between poses; limits the gain */
static const double LEAD_S[2] = {5.0, 2.5};    /* force, torque */
static const double DEAD_BAND[2] = {6e-3, 2e-3}; /* m, rad */
static const double NOISE_BAND = 1.0;          /* of the poses' sigma, added to the dead band of a force */
static const double RELEASE[2] = {0.4, 0.3};   /* fraction of the dead band at which an axis stops firing */
static const double RATE_MAX[2] = {0.01, 5e-3}; /* m/s, rad/s, at which an error is corrected */

typedef struct {
    hil_gnc_setup setup;
    int started;
    double first_s, pose_s; /* times of the first and of the newest pose */
    double r[3], v[3];      /* m, m/s in H */
    double q[4];            /* q_CH */
    double w[3];            /* rad/s, chaser relative to H, in c */
    double sigma_m;         /* of the newest pose */
    double bias[3];         /* m/s^2, accelerometer, in c */
    int firing[6];          /* -1, 0, 1 */
} gnc_state;

/* --- vectors and quaternions ------------------------------------------------------------------------------------ */

/* The matrix A that transforms components in H to components in c. */
static void matrix_of(const double q[4], double a[3][3])
{
    const double x = q[0], y = q[1], z = q[2], s = q[3];
    const double rows[3][3] = {
        {x * x - y * y - z * z + s * s, 2 * (x * y + z * s), 2 * (x * z - y * s)},
        {2 * (x * y - z * s), -x * x + y * y - z * z + s * s, 2 * (y * z + x * s)},
        {2 * (x * z + y * s), 2 * (y * z - x * s), -x * x - y * y + z * z + s * s},
    };
    memcpy(a, rows, sizeof rows);
}

static void to_c(double a[3][3], const double in_h[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a[i][0] * in_h[0] + a[i][1] * in_h[1] + a[i][2] * in_h[2];
}

static void to_h(double a[3][3], const double in_c[3], double out[3])
{
    for (int i = 0; i < 3; i++)
        out[i] = a[0][i] * in_c[0] + a[1][i] * in_c[1] + a[2][i] * in_c[2];
}

/* Rotate c by the small rotation vector phi, rad, in c. */
static void rotate(double q[4], const double phi[3])
{
    const double x = 0.5 * phi[0], y = 0.5 * phi[1], z = 0.5 * phi[2];
    const double p[4] = {
        q[0] + z * q[1] - y * q[2] + x * q[3],
        -z * q[0] + q[1] + x * q[2] + y * q[3],
        y * q[0] - x * q[1] + q[2] + z * q[3],
        -x * q[0] - y * q[1] - z * q[2] + q[3],
    };
    const double length = sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2] + p[3] * p[3]);
    for (int i = 0; i < 4; i++)
        q[i] = p[i] / length;
}

/* The rotation vector, rad, in c, from the attitude `from` to the attitude `to`; valid for small angles. */
static void rotation_between(const double from[4], const double to[4], double phi[3])
{
    const double scalar = to[0] * from[0] + to[1] * from[1] + to[2] * from[2] + to[3] * from[3];
    const double twice = scalar < 0.0 ? -2.0 : 2.0;
    phi[0] = twice * (to[0] * from[3] - to[3] * from[0] - to[2] * from[1] + to[1] * from[2]);
    phi[1] = twice * (to[1] * from[3] - to[3] * from[1] - to[0] * from[2] + to[2] * from[0]);
    phi[2] = twice * (to[2] * from[3] - to[3] * from[2] - to[1] * from[0] + to[0] * from[1]);
}

/* --- navigation ------------------------------------------------------------------------------------------------- */

/* Propagate the estimate by one step of the IMU. */
static void predict(gnc_state *g, const hil_gnc_input *in)
{
    const double dt = g->setup.step_s, n = g->setup.mean_motion_radps;
    const double orbit_h[3] = {0.0, -n, 0.0}; /* rate of H relative to inertial space */
    double a[3][3], orbit_c[3], phi[3], force_c[3], force_h[3];

    matrix_of(g->q, a);
    to_c(a, orbit_h, orbit_c);
    for (int i = 0; i < 3; i++) {
        g->w[i] = in->rate_radps[i] - orbit_c[i];
        phi[i] = dt * g->w[i];
        force_c[i] = in->force_mps2[i] - g->bias[i];
    }
    to_h(a, force_c, force_h);
    const double hill[3] = {
        2 * n * g->v[2], -n * n * g->r[1], -2 * n * g->v[0] + 3 * n * n * g->r[2],
    };
    for (int i = 0; i < 3; i++) {
        const double dv = dt * (force_h[i] + hill[i]);
        g->r[i] += dt * g->v[i] + 0.5 * dt * dv;
        g->v[i] += dv;
    }
    rotate(g->q, phi);
}

/* Start with the first pose and the planned velocity. */
static void start(gnc_state *g, const hil_gnc_input *in, const hil_gnc_pose *pose)
{
    double a[3][3], back[3];
    memcpy(g->q, pose->q_CH, sizeof g->q);
    matrix_of(g->q, a);
    to_h(a, pose->r_TC_C_m, back);
    for (int i = 0; i < 3; i++) {
        g->r[i] = -back[i];
        g->v[i] = in->reference_v_CT_H_mps[i];
    }
    g->first_s = g->pose_s = pose->t_s;
    g->started = 1;
}

/* Correct the estimate by a pose, at its time of exposure. */
static void correct(gnc_state *g, double now_s, const hil_gnc_pose *pose)
{
    const double age_s = now_s - pose->t_s;
    const double gap_s = fmin(pose->t_s - g->pose_s, LONGEST_GAP_S);
    double a[3][3], phi[3], then[4], seen[3], error[3], error_c[3];

    if (gap_s <= 0.0)
        return; /* a duplicate, or older than the newest one */
    g->pose_s = pose->t_s;
    g->sigma_m = sqrt((pose->covariance_position_m2[0][0] + pose->covariance_position_m2[1][1]
                       + pose->covariance_position_m2[2][2]) / 3.0);
    memcpy(then, g->q, sizeof then);
    for (int i = 0; i < 3; i++)
        phi[i] = -age_s * g->w[i];
    rotate(then, phi);
    rotation_between(then, pose->q_CH, phi);
    for (int i = 0; i < 3; i++)
        phi[i] *= ATTITUDE_GAIN;
    rotate(g->q, phi);
    rotate(then, phi);
    matrix_of(then, a);
    to_h(a, pose->r_TC_C_m, seen);
    for (int i = 0; i < 3; i++)
        error[i] = -seen[i] - (g->r[i] - age_s * g->v[i]);

    /* three poles at -b, as gains for one gap */
    const double b = BANDWIDTH_RADPS;
    to_c(a, error, error_c);
    for (int i = 0; i < 3; i++) {
        g->r[i] += 3 * b * gap_s * error[i];
        g->v[i] += 3 * b * b * gap_s * error[i];
        g->bias[i] -= b * b * b * gap_s * error_c[i];
    }
}

/* --- control ---------------------------------------------------------------------------------------------------- */

/* Return the demand of one axis; kind: 0 force, 1 torque; more: added to the dead band. */
static int fire(int firing, int kind, double error, double rate, double more)
{
    const double band = DEAD_BAND[kind] + more;
    const double reach = LEAD_S[kind] * RATE_MAX[kind];
    const double s = fmax(-reach, fmin(reach, error)) + LEAD_S[kind] * rate;
    const double edge = firing != 0 && firing * s < 0.0 ? RELEASE[kind] * band : band;
    return s > edge ? -1 : s < -edge ? 1 : 0;
}

static void control(gnc_state *g, const hil_gnc_input *in, hil_gnc_output *out)
{
    double a[3][3], off_h[3], rate_h[3], off[3], rate[3], phi[3];
    for (int i = 0; i < 3; i++) {
        off_h[i] = g->r[i] - in->reference_r_CT_H_m[i];
        rate_h[i] = g->v[i] - in->reference_v_CT_H_mps[i];
    }
    matrix_of(g->q, a);
    to_c(a, off_h, off);
    to_c(a, rate_h, rate);
    rotation_between(in->reference_q_CH, g->q, phi);
    for (int i = 0; i < 3; i++) {
        out->force[i] = g->firing[i] = fire(g->firing[i], 0, off[i], rate[i], NOISE_BAND * g->sigma_m);
        out->torque[i] = g->firing[3 + i] = fire(g->firing[3 + i], 1, phi[i], g->w[i], 0.0);
    }
}

/* --- called by the bench ---------------------------------------------------------------------------------------- */

int hil_gnc_protocol(void)
{
    return HIL_GNC_PROTOCOL;
}

void *hil_gnc_open(const hil_gnc_setup *setup, char *reason)
{
    gnc_state *g = calloc(1, sizeof *g);
    if (g == NULL)
        strcpy(reason, "no memory");
    else
        g->setup = *setup;
    return g;
}

int hil_gnc_step(void *gnc, const hil_gnc_input *input, hil_gnc_output *output)
{
    gnc_state *g = gnc;
    if (input->mode != HIL_GNC_RUNNING) {
        memset(g->firing, 0, sizeof g->firing);
        return 0;
    }
    if (g->started)
        predict(g, input);
    for (int64_t i = 0; i < input->n_poses; i++) {
        if (g->started)
            correct(g, input->t_s, &input->poses[i]);
        else
            start(g, input, &input->poses[i]);
    }
    if (!g->started)
        return 0; /* no estimate yet: no demands */
    control(g, input, output);
    output->estimate = input->t_s > g->first_s + SETTLED_S;
    memcpy(output->r_CT_H_m, g->r, sizeof g->r);
    memcpy(output->v_CT_H_mps, g->v, sizeof g->v);
    memcpy(output->q_CH, g->q, sizeof g->q);
    memcpy(output->w_CH_C_radps, g->w, sizeof g->w);
    return 0;
}

void hil_gnc_close(void *gnc)
{
    free(gnc);
}
