/* An instance of FMI 3.0 with what the importing tool has given for it. */

#ifndef MBFMU_FMI3_HOST_H
#define MBFMU_FMI3_HOST_H

#include "core.h"
#include "fmi3Functions.h"

typedef struct {
    Instance *own;
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    unsigned logged; /* categories */
    bool may_return_early;
} Host;

static inline Instance *instance(fmi3Instance c)
{
    return ((Host *)c)->own;
}

#endif
