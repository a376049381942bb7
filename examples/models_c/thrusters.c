/* Valves: open while commanded, and for at least minimum_on_s. The layout of the block is that of the records. */
#include "fmi_shell.h"

enum { N = 24 };

typedef struct {
    double step_s, n_thrusters, minimum_on_s; /* setup */
    double t_s, on[N];                        /* input */
    double thrust_fraction[N];                /* output */
    double open_s[N];                         /* state */
} model;

int model_open(void *block, const char *resources, char *reason)
{
    (void)block, (void)resources, (void)reason;
    return 0;
}

int model_step(void *block, double t_s, double step_s, char *reason)
{
    model *m = block;
    (void)t_s, (void)reason;
    for (int j = 0; j < (int)m->n_thrusters; j++) {
        double *open_s = &m->open_s[j], *fraction = &m->thrust_fraction[j];
        if (m->on[j] != 0.0) {
            *fraction = 1.0;
            *open_s += step_s;
        } else if (0.0 < *open_s && *open_s < m->minimum_on_s) {
            const double left = (m->minimum_on_s - *open_s) / step_s;
            *fraction = left < 1.0 ? left : 1.0;
            *open_s += step_s;
            if (*open_s >= m->minimum_on_s)
                *open_s = 0.0;
        } else {
            *fraction = 0.0;
            *open_s = 0.0;
        }
    }
    return 0;
}

void model_close(void *block) { (void)block; }
