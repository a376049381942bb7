/* Observer with fixed gains as a backend of navigation: observer.py in C, with the same bits.
 *
 *   cc -std=c11 -O2 -ffp-contract=off -shared -fPIC -I"$(hil gnc header --folder)" observer.c -o observer.so -lm
 *   hil run scheme-1 --set 'gnc.navigation.backend="observer.so"'
 *
 * The IMU is integrated, and each pose corrects a fixed fraction of the error.
 */
#include "hil_backends.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>

enum { POSITION, VELOCITY, BIAS, ATTITUDE };

const hil_backend_setting hil_navigation_settings[] = {
    {"position_gain", "1", "fraction of a pose's position error that is corrected", 0.04, 0.0, 1.0},
    {"velocity_gain_per_s", "1/s", "of it that corrects the velocity", 0.003, 0.0, 5.0},
    {"bias_gain_per_s2", "1/s^2", "of it that corrects the accelerometer's bias", 0.0001, 0.0, 1.0},
    {"attitude_gain", "1", "fraction of a pose's attitude error that is corrected", 0.01, 0.0, 1.0},
    {NULL, NULL, NULL, 0.0, 0.0, 0.0},
};

typedef struct {
    const double *settings;
    int started;
    double r[3], v[3], q[4], w[3], bias[3];
} observer;

int hil_backends_protocol(void) { return HIL_BACKENDS_PROTOCOL; }

void *hil_navigation_open(const hil_gnc_setup *setup, const double *settings, char *reason)
{
    observer *m = calloc(1, sizeof *m);
    (void)setup;
    if (m == NULL)
        snprintf(reason, HIL_GNC_REASON_BYTES, "no memory");
    else
        m->settings = settings;
    return m;
}

void hil_navigation_close(void *instance) { free(instance); }

/* Write A(q), from H to c, into a. */
static void to_matrix(const double q[4], double a[3][3])
{
    double x = q[0], y = q[1], z = q[2], w = q[3];
    a[0][0] = 1.0 - 2.0 * (y * y + z * z), a[0][1] = 2.0 * (x * y + w * z), a[0][2] = 2.0 * (x * z - w * y);
    a[1][0] = 2.0 * (x * y - w * z), a[1][1] = 1.0 - 2.0 * (x * x + z * z), a[1][2] = 2.0 * (y * z + w * x);
    a[2][0] = 2.0 * (x * z + w * y), a[2][1] = 2.0 * (y * z - w * x), a[2][2] = 1.0 - 2.0 * (x * x + y * y);
}

/* Turn the frame of q by the small angles e, rad. */
static void turn(double q[4], const double e[3])
{
    double x = q[0], y = q[1], z = q[2], w = q[3];
    double a = 0.5 * e[0], b = 0.5 * e[1], c = 0.5 * e[2];
    q[0] = x + (w * a - z * b + y * c);
    q[1] = y + (z * a + w * b - x * c);
    q[2] = z + (-y * a + x * b + w * c);
    q[3] = w - (x * a + y * b + z * c);
    double length = sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]);
    for (int i = 0; i < 4; i++)
        q[i] /= length;
}

static void predict(observer *m, const hil_backend_sample *sample, double n, double dt)
{
    double a[3][3], f[3], e[3];
    to_matrix(m->q, a);
    for (int i = 0; i < 3; i++) {
        f[i] = sample->force_mps2[i] - m->bias[i];
        m->w[i] = sample->rate_radps[i] + n * a[i][1];
        e[i] = dt * m->w[i];
    }
    for (int i = 0; i < 3; i++) {
        m->r[i] += dt * m->v[i];
        m->v[i] += dt * (a[0][i] * f[0] + a[1][i] * f[1] + a[2][i] * f[2]);
    }
    m->v[0] += dt * (2.0 * n * m->v[2]);
    m->v[1] += dt * (-n * n * m->r[1]);
    m->v[2] += dt * (3.0 * n * n * m->r[2] - 2.0 * n * m->v[0]);
    turn(m->q, e);
}

static void correct(observer *m, const hil_backend_pose *pose)
{
    const double *z = pose->r_TC_C_m, *p = pose->q_CH, *q = m->q, *gain = m->settings;
    double a[3][3], e[3];
    to_matrix(p, a);
    if (!m->started) {
        m->started = 1;
        for (int i = 0; i < 4; i++)
            m->q[i] = p[i];
        for (int i = 0; i < 3; i++) {
            m->r[i] = -(a[0][i] * z[0] + a[1][i] * z[1] + a[2][i] * z[2]);
            m->bias[i] = 3e-4;
        }
    }
    for (int i = 0; i < 3; i++)
        e[i] = -(a[0][i] * z[0] + a[1][i] * z[1] + a[2][i] * z[2]) - m->r[i];
    for (int i = 0; i < 3; i++) {
        m->r[i] += gain[POSITION] * e[i];
        m->v[i] += gain[VELOCITY] * e[i];
        m->bias[i] -= gain[BIAS] * (a[i][0] * e[0] + a[i][1] * e[1] + a[i][2] * e[2]);
    }
    double side = p[0] * q[0] + p[1] * q[1] + p[2] * q[2] + p[3] * q[3] >= 0.0 ? 2.0 : -2.0;
    for (int i = 0; i < 3; i++) {
        int j = (i + 1) % 3, l = (i + 2) % 3;
        e[i] = side * gain[ATTITUDE] * (q[3] * p[i] - p[3] * q[i] + p[j] * q[l] - p[l] * q[j]);
    }
    turn(m->q, e);
}

int hil_navigation_step(const hil_navigation_input *input, hil_navigation_output *output, void *instance)
{
    observer *m = instance;
    for (int64_t k = 0; m->started && k < input->n_samples; k++)
        predict(m, &input->samples[k], input->setup.mean_motion_radps, input->setup.step_s / (double)input->n_samples);
    for (int64_t k = 0; k < input->n_poses; k++)
        correct(m, &input->poses[k]);
    output->valid = m->started;
    for (int i = 0; i < 3; i++) {
        output->r_CT_H[i] = m->r[i], output->v_CT_H[i] = m->v[i], output->w_CH_C[i] = m->w[i];
        output->sigma_r_m[i] = 0.0015, output->sigma_v_mps[i] = 0.0007;
        output->bias_mps2[i] = m->bias[i], output->bias_sigma_mps2[i] = 1e-3;
    }
    for (int i = 0; i < 4; i++)
        output->q_CH[i] = m->q[i];
    return 0;
}
