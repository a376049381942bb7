/* IMU: true means with a constant drift and bias, and white noise of the parameters' size (bench paper Table I).
 * The layout of the block is that of the records. Samples without any noise would be taken for those of a stuck sensor.
 */
#include <stdint.h>

#include "fmi_shell.h"

typedef struct {
    double step_s;                                      /* setup */
    double t_s, mean_rate[3], mean_force[3], w_CI_C[3]; /* input */
    double rate[3], force[3], drift[3], bias[3];        /* output */
    uint64_t random;                                    /* state */
} model;

static const double DRIFT[3] = {4.85e-8, -4.85e-8, 4.85e-8}, BIAS[3] = {3e-4, 3e-4, -3e-4}; /* rad/s, m/s^2 */
static const double RATE_NOISE = 1.45e-8, FORCE_NOISE = 1e-4;

static double normal(model *m) /* sum of twelve uniform numbers */
{
    double sum = -6.0;
    for (int i = 0; i < 12; i++) {
        m->random = m->random * 6364136223846793005u + 1442695040888963407u;
        sum += (double)(m->random >> 11) / 9007199254740992.0;
    }
    return sum;
}

int model_open(void *block, const char *resources, char *reason)
{
    model *m = block;
    (void)resources, (void)reason;
    m->random = 1;
    return 0;
}

int model_step(void *block, double t_s, double step_s, char *reason)
{
    model *m = block;
    (void)t_s, (void)step_s, (void)reason;
    for (int i = 0; i < 3; i++) {
        m->drift[i] = DRIFT[i];
        m->bias[i] = BIAS[i];
        m->rate[i] = m->mean_rate[i] + DRIFT[i] + RATE_NOISE * normal(m);
        m->force[i] = m->mean_force[i] + BIAS[i] + FORCE_NOISE * normal(m);
    }
    return 0;
}

void model_close(void *block) { (void)block; }
