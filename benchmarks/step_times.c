/* Times of communication steps: step_times LIBRARY RESOURCES TOKEN STEPS LENGTH RUNS INPUT REFERENCE...
 *
 * Simulates an FMU of FMI 2 RUNS times by STEPS steps of LENGTH s, with fmi2Reset in between. A step is fmi2SetReal of
 * sin(t) to the input of this value reference (-1: no input), fmi2DoStep, and fmi2GetReal of these variables.
 * All runs compute the same numbers, so that the time of a step is the shortest of its times in the runs: longer ones
 * contain interruptions by the operating system. Prints in ns: the time of one reading of the clock; then mean, median,
 * 99.9th percentile and the largest of the times of steps; the first and the number of the longest step; the longest
 * step of any run, with its interruptions; and the mean times of the three parts of a step.
 */
#include <dlfcn.h>
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <time.h>

#include "fmi2Functions.h"

enum { MAX_REFERENCES = 4096, PARTS = 3 };

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
    long steps = atol(arguments[4]), runs = atol(arguments[6]), input = atol(arguments[7]), longest = 0;
    double length = strtod(arguments[5], NULL), parts[PARTS] = {0.0}, total = 0.0;
    size_t n = 0;
    for (int k = 8; k < count && n < MAX_REFERENCES; k++)
        references[n++] = (fmi2ValueReference)atol(arguments[k]);
    uint32_t *times = malloc((size_t)steps * sizeof *times), interrupted = 0;
    fmi2Component c = call_fmi2Instantiate("one", fmi2CoSimulation, arguments[3], arguments[2], &callbacks, 0, 0);
    if (!c || !times)
        return 2;
    for (long k = 0; k < steps; k++)
        times[k] = UINT32_MAX; /* makes the pages of the array resident, too */
    int64_t begin = now();
    for (int k = 0; k < 1000; k++)
        now();
    double clock = (double)(now() - begin) / 1000.0;
    for (long run = 0; run < runs; run++) {
        if (run)
            CALL(fmi2Reset, c);
        CALL(fmi2SetupExperiment, c, 0, 0.0, 0.0, 0, 0.0);
        CALL(fmi2EnterInitializationMode, c);
        CALL(fmi2ExitInitializationMode, c);
        for (long k = 0; k < steps; k++) {
            double t = (double)k * length, value = sin(t);
            fmi2ValueReference changed = (fmi2ValueReference)input;
            int64_t at[PARTS + 1] = {now()};
            if (input >= 0)
                CALL(fmi2SetReal, c, &changed, 1, &value);
            at[1] = now();
            CALL(fmi2DoStep, c, t, length, 1);
            at[2] = now();
            CALL(fmi2GetReal, c, references, n, values);
            at[3] = now();
            uint32_t took = (uint32_t)(at[PARTS] - at[0]);
            times[k] = took < times[k] ? took : times[k];
            interrupted = took > interrupted ? took : interrupted;
            for (int part = 0; part < PARTS; part++)
                parts[part] += (double)(at[part + 1] - at[part]) / (double)(steps * runs);
        }
    }
    for (long k = 0; k < steps; k++) {
        total += times[k];
        longest = times[k] > times[longest] ? k : longest;
    }
    uint32_t first = times[0];
    qsort(times, (size_t)steps, sizeof *times, ascending);
    printf("%.1f\n%.1f\n%u\n%u\n%u\n%u\n%ld\n%u\n", clock, total / (double)steps, times[steps / 2], times[steps - steps / 1000 - 1],
           times[steps - 1], first, longest, interrupted);
    for (int part = 0; part < PARTS; part++)
        printf("%.1f\n", parts[part]);
    return 0;
}
