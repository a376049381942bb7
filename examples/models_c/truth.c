/* Motion of the chaser: Hill's equations and a rigid body, integrated by classical Runge-Kutta steps.
 * The layout of the block is that of the records. H rotates with [0, -n, 0] against inertial space.
 */
#include <math.h>
#include <string.h>

#include "fmi_shell.h"

enum { THRUSTERS = 24, STATES = 13 };

typedef struct {
    double step_s, n, r0[3], v0[3], q0[4], w0[3], mass0, inertia[3][3]; /* setup */
    double t_s, fraction[THRUSTERS], force[3], torque[3];               /* input */
    double r[3], v[3], q[4], w[3], mass, mean_rate[3], mean_force[3];   /* output */
} model;

static void to_matrix(const double q[4], double a[3][3]) /* components in H to components in c */
{
    const double x = q[0], y = q[1], z = q[2], s = q[3];
    a[0][0] = s * s + x * x - y * y - z * z, a[0][1] = 2 * (x * y + z * s), a[0][2] = 2 * (x * z - y * s);
    a[1][0] = 2 * (x * y - z * s), a[1][1] = s * s - x * x + y * y - z * z, a[1][2] = 2 * (y * z + x * s);
    a[2][0] = 2 * (x * z + y * s), a[2][1] = 2 * (y * z - x * s), a[2][2] = s * s - x * x - y * y + z * z;
}

static void solve(double a[3][3], const double b[3], double x[3]) /* Cramer's rule */
{
    double c[3][3], det = 0.0;
    for (int i = 0; i < 3; i++)
        for (int j = 0; j < 3; j++)
            c[i][j] = a[(i + 1) % 3][(j + 1) % 3] * a[(i + 2) % 3][(j + 2) % 3]
                      - a[(i + 1) % 3][(j + 2) % 3] * a[(i + 2) % 3][(j + 1) % 3];
    for (int j = 0; j < 3; j++)
        det += a[0][j] * c[0][j];
    for (int j = 0; j < 3; j++)
        x[j] = (c[0][j] * b[0] + c[1][j] * b[1] + c[2][j] * b[2]) / det;
}

static void derivative(model *m, const double s[STATES], double d[STATES])
{
    const double *r = s, *v = s + 3, *q = s + 6, *w = s + 10, n = m->n;
    double a[3][3], l[3], rhs[3], u[3];
    to_matrix(q, a);
    for (int i = 0; i < 3; i++) {
        d[i] = v[i];
        d[3 + i] = (a[0][i] * m->force[0] + a[1][i] * m->force[1] + a[2][i] * m->force[2]) / m->mass;
        l[i] = m->inertia[i][0] * w[0] + m->inertia[i][1] * w[1] + m->inertia[i][2] * w[2];
        u[i] = w[i] + a[i][1] * n; /* rate of c against H */
    }
    d[3] += 2.0 * n * v[2];
    d[4] += -n * n * r[1];
    d[5] += -2.0 * n * v[0] + 3.0 * n * n * r[2];
    d[6] = 0.5 * (u[2] * q[1] - u[1] * q[2] + u[0] * q[3]);
    d[7] = 0.5 * (-u[2] * q[0] + u[0] * q[2] + u[1] * q[3]);
    d[8] = 0.5 * (u[1] * q[0] - u[0] * q[1] + u[2] * q[3]);
    d[9] = 0.5 * (-u[0] * q[0] - u[1] * q[1] - u[2] * q[2]);
    for (int i = 0; i < 3; i++)
        rhs[i] = m->torque[i] - (w[(i + 1) % 3] * l[(i + 2) % 3] - w[(i + 2) % 3] * l[(i + 1) % 3]);
    solve(m->inertia, rhs, d + 10);
}

int model_open(void *block, const char *resources, char *reason)
{
    model *m = block;
    (void)resources, (void)reason;
    memcpy(m->r, m->r0, sizeof m->r);
    memcpy(m->v, m->v0, sizeof m->v);
    memcpy(m->q, m->q0, sizeof m->q);
    memcpy(m->w, m->w0, sizeof m->w);
    m->mass = m->mass0;
    return 0;
}

int model_step(void *block, double t_s, double step_s, char *reason)
{
    model *m = block;
    double s[STATES], k[4][STATES], trial[STATES];
    (void)t_s, (void)reason;
    memcpy(s, m->r, sizeof s); /* r, v, q, w lie one after the other */
    for (int stage = 0; stage < 4; stage++) {
        const double part = stage == 0 ? 0.0 : stage == 3 ? step_s : 0.5 * step_s;
        for (int i = 0; i < STATES; i++)
            trial[i] = s[i] + (stage ? part * k[stage - 1][i] : 0.0);
        derivative(m, trial, k[stage]);
    }
    for (int i = 0; i < 3; i++) {
        m->mean_rate[i] = 0.5 * m->w[i];
        m->mean_force[i] = m->force[i] / m->mass;
    }
    for (int i = 0; i < STATES; i++)
        s[i] += step_s / 6.0 * (k[0][i] + 2.0 * k[1][i] + 2.0 * k[2][i] + k[3][i]);
    const double length = sqrt(s[6] * s[6] + s[7] * s[7] + s[8] * s[8] + s[9] * s[9]);
    for (int i = 6; i < 10; i++)
        s[i] /= length;
    memcpy(m->r, s, sizeof s);
    for (int i = 0; i < 3; i++)
        m->mean_rate[i] += 0.5 * m->w[i];
    return 0;
}

void model_close(void *block) { (void)block; }
