/* The GNC of gnc.c (or any other with the functions of hil_gnc.h) as a model for fmi_shell.h, see build_fmu.py. */
#include <string.h>

#include "fmi_shell.h"
#include "hil_gnc.h"

typedef struct { /* layout of the model's block, which build_fmu.py describes */
    hil_gnc_setup setup;
    hil_gnc_input input;
    hil_gnc_output output;
    void *gnc;
} model;

int model_open(void *block, const char *resources, char *reason)
{
    model *m = block;
    (void)resources;
    m->gnc = hil_gnc_open(&m->setup, reason);
    return m->gnc == NULL;
}

int model_step(void *block, double t_s, double step_s, char *reason)
{
    model *m = block;
    (void)t_s, (void)step_s;
    memset(&m->output, 0, sizeof m->output);
    m->output.cycle = m->input.cycle;
    m->output.state = HIL_GNC_WORKING;
    const int code = hil_gnc_step(m->gnc, &m->input, &m->output);
    if (code != 0)
        memcpy(reason, m->output.text, sizeof m->output.text);
    return code;
}

void model_close(void *block)
{
    model *m = block;
    hil_gnc_close(m->gnc);
    m->gnc = NULL;
}
