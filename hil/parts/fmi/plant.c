/* Plant of the bench as a model for fmi_shell.h: the compiled loop, one cycle per step, with the FMU's inputs as its GNC.
 *
 * The loop of a cycle senses, calls the GNC, and moves the truth. A step gives it the commands of the present cycle, then
 * runs the next cycle up to the call of the GNC and takes everything back but the input that the GNC would have received:
 * these are the outputs of the FMU. plant_layout.h is generated: layout of the records and of plant.bin.
 */
#include <ctype.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi_shell.h"
#include "hil_gnc.h"
#include "plant_layout.h"

static const char *reason_of(int64_t code)
{
    switch (code) {
    case FOLLOWING: return "an axis of the bench does not follow its setpoint";
    case TRAVEL_LEFT: return "an axis of the bench leaves its range";
    case VISION_SILENT: return "no frame of the vision unit arrived in time";
    case NOT_FINITE: return "a setpoint is not finite";
    case GNC_FAILED: return "the command is not allowed: demands are -1, 0 or 1, thrusters 0 or 1, estimates finite";
    default: return "the loop has ended";
    }
}

typedef struct { /* layout of the model's block, see hil/parts/fmi/plant_fmu.py */
    hil_gnc_output command; /* inputs of the FMU */
    hil_gnc_input sensed;   /* outputs */
    double truth[PLANT_TRUTH];
    struct plant *plant;
} model;

typedef struct plant {
    unsigned char *data;                /* plant.bin */
    unsigned char *part[PLANT_PARTS];   /* its parts */
    unsigned char *kept;                /* copy of the parts that a cycle changes */
    model *of;
    int looks_ahead;                    /* 1: the cycle ends at the call of the GNC */
} plant;

#define FIELD(p, TYPE, offset) (*(TYPE *)(void *)((p)->part[PLANT_STATE] + (offset)))

static int gnc(void *instance, const void *input, void *output)
{
    plant *p = instance;
    if (p->looks_ahead) {
        memcpy(&p->of->sensed, input, sizeof p->of->sensed);
        return 1;
    }
    hil_gnc_output *out = output;
    const int64_t cycle = out->cycle;
    *out = p->of->command;
    out->cycle = cycle;
    return 0;
}

/* The parts that a cycle changes lie one after the other. */
static void keep(plant *p) { memcpy(p->kept, p->part[PLANT_STATE], PLANT_CHANGED_BYTES); }
static void take_back(plant *p) { memcpy(p->part[PLANT_STATE], p->kept, PLANT_CHANGED_BYTES); }

static int64_t run_cycle(plant *p)
{
    const int64_t cycle = FIELD(p, int64_t, PLANT_CYCLE);
    const int64_t exposure = FIELD(p, int64_t, PLANT_OPENED) ?
        FIELD(p, int64_t, PLANT_NEXT_EXPOSURE) - FIELD(p, int64_t, PLANT_FIRST_EXPOSURE) : 0;
    FIELD(p, int64_t, PLANT_END) = cycle + 1;
    FIELD(p, int64_t, PLANT_STEP_ADDRESS) = (int64_t)(intptr_t)gnc;
    FIELD(p, int64_t, PLANT_INSTANCE) = (int64_t)(intptr_t)p;
    return plant_loop(p->part, cycle, exposure);
}

/* Write the outputs of the present cycle. */
static int look_ahead(plant *p, char *reason)
{
    model *m = p->of;
    for (int i = 0; i < PLANT_TRUTH_FIELDS; i++)
        memcpy(m->truth + PLANT_TRUTH_PLACES[i].at, p->part[PLANT_STATE] + PLANT_TRUTH_PLACES[i].offset,
               PLANT_TRUTH_PLACES[i].n * sizeof(double));
    keep(p);
    p->looks_ahead = 1;
    const int64_t code = run_cycle(p);
    p->looks_ahead = 0;
    take_back(p);
    if (code == GNC_FAILED)
        return 0;
    snprintf(reason, FMI_REASON, "%s", reason_of(code));
    return 1;
}

/* The path that the URI or path of the resources names, with the name of the file. */
static void path_of(const char *resources, const char *name, char *path, size_t size)
{
    size_t n = 0;
    if (strncmp(resources, "file:", 5) == 0) {
        resources += 5;
        if (strncmp(resources, "//", 2) == 0)
            resources = strchr(resources + 2, '/') != NULL ? strchr(resources + 2, '/') : resources + 2;
        if (resources[0] == '/' && isalpha((unsigned char)resources[1]) && resources[2] == ':')
            resources++; /* a drive of Windows */
    }
    for (; *resources != '\0' && n + 1 < size; resources++) {
        unsigned code;
        if (*resources == '%' && sscanf(resources + 1, "%2x", &code) == 1) {
            path[n++] = (char)code;
            resources += 2;
        } else
            path[n++] = *resources;
    }
    if (n > 0 && path[n - 1] == '/')
        n--;
    snprintf(path + n, size - n, "/%s", name);
}

static int load(plant *p, const char *resources, char *reason)
{
    char path[4096];
    path_of(resources, "plant.bin", path, sizeof path);
    FILE *file = fopen(path, "rb");
    const size_t read = file != NULL ? fread(p->data, 1, PLANT_BYTES, file) : 0;
    if (file != NULL)
        fclose(file);
    if (read != PLANT_BYTES) {
        snprintf(reason, FMI_REASON, "cannot read %.200s", path);
        return 1;
    }
    for (int i = 0; i < PLANT_PARTS; i++)
        p->part[i] = p->data + PLANT_PART_PLACES[i];
    return 0;
}

int model_open(void *block, const char *resources, char *reason)
{
    model *m = block;
    plant *p = calloc(1, sizeof *p);
    if (p != NULL) {
        p->of = m;
        p->data = malloc(PLANT_BYTES);
        p->kept = malloc(PLANT_CHANGED_BYTES);
    }
    if (p == NULL || p->data == NULL || p->kept == NULL || load(p, resources, reason) != 0 || look_ahead(p, reason) != 0) {
        if (reason[0] == '\0')
            snprintf(reason, FMI_REASON, "no memory");
        m->plant = p;
        model_close(m);
        return 1;
    }
    m->plant = p;
    return 0;
}

int model_step(void *block, double t_s, double step_s, char *reason)
{
    model *m = block;
    plant *p = m->plant;
    const int64_t cycle = FIELD(p, int64_t, PLANT_CYCLE);
    if (fabs(step_s - PLANT_STEP_S) > 1e-9 || fabs(t_s - (double)cycle * PLANT_STEP_S) > 1e-6) {
        snprintf(reason, FMI_REASON, "a step from %g s over %g s: allowed is one from %g s over %g s", t_s, step_s,
                 (double)cycle * PLANT_STEP_S, PLANT_STEP_S);
        return 1;
    }
    if (cycle >= PLANT_CYCLES) {
        snprintf(reason, FMI_REASON, "the run is over after %g s", (double)PLANT_CYCLES * PLANT_STEP_S);
        return 1;
    }
    const int64_t code = run_cycle(p);
    if (code != COMPLETED && code != GNC_HOLDS) {
        snprintf(reason, FMI_REASON, "%s", reason_of(code));
        return 1;
    }
    return look_ahead(p, reason);
}

void model_close(void *block)
{
    model *m = block;
    if (m->plant == NULL)
        return;
    free(m->plant->data);
    free(m->plant->kept);
    free(m->plant);
    m->plant = NULL;
}

/* Reference counts of arrays, which the compiled loop expects from its runtime. */
typedef struct {
    int64_t count;
    void *unused[2], *data;
    size_t size;
    void *allocator;
} array_memory;

void *NRT_MemInfo_alloc_aligned(int64_t size, int32_t alignment)
{
    const size_t align = (size_t)alignment;
    array_memory *m = malloc(sizeof *m + (size_t)size + align);
    if (m == NULL)
        abort();
    memset(m, 0, sizeof *m);
    m->count = 1;
    m->size = (size_t)size;
    m->data = (void *)(((uintptr_t)(m + 1) + align - 1) / align * align);
    return m;
}

void NRT_MemInfo_call_dtor(void *m) { free(m); }
void NRT_Free(void *m) { free(m); }

void NRT_incref(void *m)
{
    if (m != NULL)
        ((array_memory *)m)->count++;
}

void NRT_decref(void *m)
{
    if (m != NULL && --((array_memory *)m)->count == 0)
        free(m);
}
