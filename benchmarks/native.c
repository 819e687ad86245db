/* What calls of an FMU cost a host in C: native LIBRARY RESOURCES TOKEN COUNT REFERENCE...
 *
 * Prints nanoseconds of CPU for a step of no length, for reading these variables, for taking a state and giving it back.
 */
#include <dlfcn.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2Functions.h"

static double seconds(void)
{
    struct timespec now;
    clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
    return (double)now.tv_sec + 1e-9 * (double)now.tv_nsec;
}

#define FUNCTION(name) name##TYPE *call_##name = (name##TYPE *)dlsym(library, #name)
#define TIMED(...)                                                                 \
    do {                                                                           \
        double begin = seconds();                                                  \
        for (long k = 0; k < calls; k++)                                           \
            __VA_ARGS__;                                                           \
        printf("%.2f\n", 1e9 * (seconds() - begin) / (double)calls);               \
    } while (0)

int main(int count, char **told)
{
    enum { MOST = 256 };
    fmi2ValueReference references[MOST];
    double values[MOST];
    fmi2FMUstate state = NULL;
    fmi2CallbackFunctions callbacks = {NULL, calloc, free, NULL, NULL};
    void *library = count > 4 ? dlopen(told[1], RTLD_NOW) : NULL;
    if (!library)
        return 1;
    FUNCTION(fmi2Instantiate);
    FUNCTION(fmi2EnterInitializationMode);
    FUNCTION(fmi2ExitInitializationMode);
    FUNCTION(fmi2DoStep);
    FUNCTION(fmi2GetReal);
    FUNCTION(fmi2GetFMUstate);
    FUNCTION(fmi2SetFMUstate);
    size_t n = 0;
    for (int k = 5; k < count && n < MOST; k++)
        references[n++] = (fmi2ValueReference)atoi(told[k]);
    fmi2Component c = call_fmi2Instantiate("one", fmi2CoSimulation, told[3], told[2], &callbacks, 0, 0);
    if (!c || call_fmi2EnterInitializationMode(c) || call_fmi2ExitInitializationMode(c))
        return 2;
    long calls = atol(told[4]);
    TIMED(call_fmi2DoStep(c, 0.0, 0.0, 1));
    TIMED(call_fmi2GetReal(c, references, n, values));
    TIMED(call_fmi2GetFMUstate(c, &state));
    TIMED(call_fmi2SetFMUstate(c, state));
    return 0;
}
