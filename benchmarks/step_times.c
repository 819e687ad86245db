/* Times of communication steps: step_times LIBRARY RESOURCES TOKEN STEPS LENGTH RUNS INPUT REFERENCE...
 *
 * Simulates an FMU of FMI 2 RUNS times by STEPS steps of LENGTH s, with fmi2Reset in between. A step is fmi2SetReal of
 * sin(t) to the input of this value reference (-1: no input), fmi2DoStep, and fmi2GetReal of these variables.
 * All runs compute the same numbers, so that the time of a step is the shortest of its times in the runs: longer ones
 * contain interruptions by the operating system. Prints mean, median, 99.9th percentile and the largest of these times,
 * in ns, without the first step; the time of the first step, and that of the first step of the first run, whose code
 * and data are not in the caches of the processor yet; the largest time of any step with its interruptions; and the
 * number of the step that takes longest. A reading of the clock is in these times, about 16 ns.
 */
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2Functions.h"

enum { MAX_REFERENCES = 4096 };

static void check(int status, const char *call)
{
    if (status) {
        fprintf(stderr, "%s returned %d\n", call, status);
        exit(2);
    }
}

static int64_t now(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return 1000000000 * (int64_t)t.tv_sec + t.tv_nsec;
}

static int ascending(const void *a, const void *b)
{
    uint32_t one = *(const uint32_t *)a, two = *(const uint32_t *)b;
    return (one > two) - (one < two);
}

#define FUNCTION(name) name##TYPE *call_##name = (name##TYPE *)dlsym(library, #name)
#define CALL(name, ...) check(call_##name(__VA_ARGS__), #name)

int main(int count, char **arguments)
{
    static double values[MAX_REFERENCES];
    fmi2ValueReference references[MAX_REFERENCES];
    fmi2CallbackFunctions callbacks = {NULL, calloc, free, NULL, NULL};
    void *library = count > 8 ? dlopen(arguments[1], RTLD_NOW) : NULL;
    if (!library)
        return 1;
    FUNCTION(fmi2Instantiate);
    FUNCTION(fmi2SetupExperiment);
    FUNCTION(fmi2EnterInitializationMode);
    FUNCTION(fmi2ExitInitializationMode);
    FUNCTION(fmi2SetReal);
    FUNCTION(fmi2DoStep);
    FUNCTION(fmi2GetReal);
    FUNCTION(fmi2Reset);
    long steps = atol(arguments[4]), runs = atol(arguments[6]), input = atol(arguments[7]), longest = 1;
    double length = strtod(arguments[5], NULL), total = 0.0;
    size_t n = 0;
    for (int k = 8; k < count && n < MAX_REFERENCES; k++)
        references[n++] = (fmi2ValueReference)atol(arguments[k]);
    uint32_t *times = malloc((size_t)steps * sizeof *times), interrupted = 0, cold = 0;
    fmi2Component c = call_fmi2Instantiate("one", fmi2CoSimulation, arguments[3], arguments[2], &callbacks, 0, 0);
    if (!c || !times || steps < 2)
        return 2;
    for (long k = 0; k < steps; k++)
        times[k] = UINT32_MAX; /* makes the pages of the array resident, too */
    for (long run = 0; run < runs; run++) {
        if (run)
            CALL(fmi2Reset, c);
        CALL(fmi2SetupExperiment, c, 0, 0.0, 0.0, 0, 0.0);
        CALL(fmi2EnterInitializationMode, c);
        CALL(fmi2ExitInitializationMode, c);
        for (long k = 0; k < steps; k++) {
            double t = (double)k * length, value = sin(t);
            fmi2ValueReference changed = (fmi2ValueReference)input;
            int64_t begin = now();
            if (input >= 0)
                CALL(fmi2SetReal, c, &changed, 1, &value);
            CALL(fmi2DoStep, c, t, length, 1);
            CALL(fmi2GetReal, c, references, n, values);
            uint32_t took = (uint32_t)(now() - begin);
            cold = run == 0 && k == 0 ? took : cold;
            times[k] = took < times[k] ? took : times[k];
            interrupted = took > interrupted ? took : interrupted;
        }
    }
    for (long k = 1; k < steps; k++) {
        total += times[k];
        longest = times[k] > times[longest] ? k : longest;
    }
    uint32_t first = times[0];
    qsort(times + 1, (size_t)steps - 1, sizeof *times, ascending);
    printf("%.1f\n%u\n%u\n%u\n", total / (double)(steps - 1), times[steps / 2], times[steps - 1 - steps / 1000], times[steps - 1]);
    printf("%u\n%u\n%u\n%ld\n", first, cold, interrupted, longest);
    return 0;
}
