/* Shell of an FMU for co-simulation around a model in C: FMI 2.0 with -DFMI=2, FMI 3.0 with -DFMI=3.
 *
 * The variables of the model are elements of one block of memory; their places are in tables that are generated with
 * the model description. The model has three functions, which return 0, or write a reason of at most FMI_REASON bytes.
 */
#ifndef FMI_SHELL_H
#define FMI_SHELL_H

#include <stddef.h>
#include <stdint.h>

enum { FMI_REASON = 256 };
enum { FMI_F8, FMI_I4, FMI_I8, FMI_U1 }; /* types in the block */

typedef struct {
    uint32_t offset; /* in the block, bytes */
    uint32_t count;  /* elements */
    uint32_t type;
    uint32_t is_set; /* 1: may be set */
} fmi_variable;

/* generated */
extern const fmi_variable fmi_variables[]; /* by value reference */
extern const uint32_t fmi_n_variables;
extern const char fmi_token[];
extern const size_t fmi_block_bytes;
extern const unsigned char fmi_start_block[]; /* start values */

/* of the model */
int model_open(void *block, const char *resources, char *reason); /* after the parameters are set */
int model_step(void *block, double t_s, double step_s, char *reason);
void model_close(void *block);

#endif
