/* An importer for model exchange without Python: exchange_host FMI LIBRARY RESOURCES TOKEN OUT STEPS LENGTH STATES REFERENCE...
 *
 * Integrates one instance of an FMU of FMI 2 or 3 by STEPS steps of LENGTH s of the classical Runge-Kutta method of
 * order 4, and writes its real variables of these value references after every step, as doubles, to the file OUT. A
 * step in which an evaluation is discarded is made as two steps of half the length. It handles time events. In the
 * middle it saves the FMU state, goes on, and restores the state. Ends with 0, or says which call failed.
 */
#ifdef _WIN32
#include <windows.h>
#define dlopen(path, how) ((void *)LoadLibraryA(path))
#define dlsym(library, name) ((void *)GetProcAddress(library, name))
#define dlerror() "the library is not what it should be"
#else
#include <dlfcn.h>
#endif
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

#define MOST 1024
#define SHORTEST 1e-9 /* s */

static void *library;
static void *c; /* the instance */
static int version;
static size_t n; /* states */

static void fail(const char *what)
{
    fprintf(stderr, "%s\n", what);
    exit(1);
}

static void *function(const char *name)
{
    void *found = dlsym(library, name);
    if (!found)
        fail(dlerror());
    return found;
}

#define CALL(name, ...)                                                            \
    do {                                                                           \
        if (((name##TYPE *)function(#name))(__VA_ARGS__))                          \
            fail(#name);                                                           \
    } while (0)

static void tell2(fmi2ComponentEnvironment, fmi2String, fmi2Status status, fmi2String, fmi2String text, ...)
{
    if (status != fmi2Discard)
        fprintf(stderr, "%d: %s\n", (int)status, text);
}

static void tell3(fmi3InstanceEnvironment, fmi3Status status, fmi3String, fmi3String text)
{
    if (status != fmi3Discard)
        fprintf(stderr, "%d: %s\n", (int)status, text);
}

/* Return the time of the next event, s; at first of the start. */
static double update(double none)
{
    if (version == 2) {
        fmi2EventInfo info;
        CALL(fmi2NewDiscreteStates, c, &info);
        if (info.newDiscreteStatesNeeded || info.terminateSimulation)
            fail("event iteration");
        CALL(fmi2EnterContinuousTimeMode, c);
        return info.nextEventTimeDefined ? info.nextEventTime : none;
    }
    bool more, ends, nominals, values, has_next;
    double next;
    CALL(fmi3UpdateDiscreteStates, c, &more, &ends, &nominals, &values, &has_next, &next);
    if (more || ends)
        fail("event iteration");
    CALL(fmi3EnterContinuousTimeMode, c);
    return has_next ? next : none;
}

static double start(char **told)
{
    static const fmi2CallbackFunctions callbacks = {tell2, calloc, free, NULL, NULL};
    if (version == 2) {
        c = ((fmi2InstantiateTYPE *)function("fmi2Instantiate"))("one", fmi2ModelExchange, told[2], told[1], &callbacks,
                                                                 fmi2False, fmi2True);
        if (!c)
            fail("fmi2Instantiate");
        CALL(fmi2SetupExperiment, c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
        CALL(fmi2EnterInitializationMode, c);
        CALL(fmi2ExitInitializationMode, c);
    } else {
        c = ((fmi3InstantiateModelExchangeTYPE *)function("fmi3InstantiateModelExchange"))("one", told[2], told[1], false,
                                                                                           true, NULL, tell3);
        if (!c)
            fail("fmi3InstantiateModelExchange");
        CALL(fmi3EnterInitializationMode, c, false, 0.0, 0.0, false, 0.0);
        CALL(fmi3ExitInitializationMode, c);
        CALL(fmi3GetNumberOfContinuousStates, c, &n);
    }
    return update(1e300);
}

static void place(double t, const double *x)
{
    if (version == 2) {
        CALL(fmi2SetTime, c, t);
        CALL(fmi2SetContinuousStates, c, x, n);
    } else {
        CALL(fmi3SetTime, c, t);
        CALL(fmi3SetContinuousStates, c, x, n);
    }
}

static void states(double *x)
{
    if (version == 2)
        CALL(fmi2GetContinuousStates, c, x, n);
    else
        CALL(fmi3GetContinuousStates, c, x, n);
}

/* Evaluate the derivatives; false: the evaluation is discarded. */
static bool derive(double t, const double *x, double *dx)
{
    place(t, x);
    int status = version == 2 ? (int)((fmi2GetDerivativesTYPE *)function("fmi2GetDerivatives"))(c, dx, n)
                              : (int)((fmi3GetContinuousStateDerivativesTYPE *)function(
                                    "fmi3GetContinuousStateDerivatives"))(c, dx, n);
    if (status != 0 && status != 2)
        fail("derivatives");
    return status == 0;
}

static void complete(void)
{
    if (version == 2) {
        fmi2Boolean event, ends;
        CALL(fmi2CompletedIntegratorStep, c, fmi2True, &event, &ends);
        if (event || ends)
            fail("completed step");
    } else {
        bool event, ends;
        CALL(fmi3CompletedIntegratorStep, c, true, &event, &ends);
        if (event || ends)
            fail("completed step");
    }
}

/* One step of length h; false: an evaluation is discarded. */
static bool attempt(double t, double *x, double h)
{
    static const double nodes[] = {0.0, 0.5, 0.5, 1.0}, weights[] = {1.0 / 6, 1.0 / 3, 1.0 / 3, 1.0 / 6};
    double k[MOST] = {0}, y[MOST], sum[MOST] = {0};
    for (int stage = 0; stage < 4; stage++) {
        for (size_t i = 0; i < n; i++)
            y[i] = x[i] + nodes[stage] * h * k[i];
        if (!derive(t + nodes[stage] * h, y, k))
            return false;
        for (size_t i = 0; i < n; i++)
            sum[i] += weights[stage] * k[i];
    }
    for (size_t i = 0; i < n; i++)
        x[i] += h * sum[i];
    return true;
}

static void advance(double t, double *x, double h)
{
    if (attempt(t, x, h)) {
        place(t + h, x);
        complete();
        return;
    }
    if (h < SHORTEST)
        fail("the step is too short");
    advance(t, x, 0.5 * h);
    advance(t + 0.5 * h, x, 0.5 * h);
}

static void event(double *next, double *x)
{
    if (version == 2)
        CALL(fmi2EnterEventMode, c);
    else
        CALL(fmi3EnterEventMode, c);
    *next = update(1e300);
    states(x);
}

/* Advance to ``end``, with the events on the way. */
static void advance_to(double t, double end, double *x, double *next)
{
    while (*next < end) {
        double at = *next;
        if (at > t)
            advance(t, x, at - t);
        t = at;
        event(next, x);
    }
    if (end > t)
        advance(t, x, end - t);
}

/* Save the FMU state, go on for two steps, and restore it. */
static void go_and_return(double t, double length, const double *x)
{
    double y[MOST], next = 1e300;
    void *state = NULL;
    memcpy(y, x, n * sizeof *x);
    if (version == 2)
        CALL(fmi2GetFMUstate, c, &state);
    else
        CALL(fmi3GetFMUState, c, &state);
    advance_to(t, t + length, y, &next);
    advance_to(t + length, t + 2.0 * length, y, &next);
    if (version == 2) {
        CALL(fmi2SetFMUstate, c, state);
        CALL(fmi2FreeFMUstate, c, &state);
    } else {
        CALL(fmi3SetFMUState, c, state);
        CALL(fmi3FreeFMUState, c, &state);
    }
    states(y);
    if (memcmp(x, y, n * sizeof *x))
        fail("restored states");
}

int main(int count, char **told)
{
    double x[MOST], values[MOST];
    unsigned references[MOST];
    if (count < 9)
        return 2;
    version = atoi(told[1]);
    library = dlopen(told[2], RTLD_NOW | RTLD_LOCAL);
    if (!library)
        fail(dlerror());
    int steps = atoi(told[6]), wanted = count - 9;
    double length = atof(told[7]);
    n = (size_t)atoi(told[8]);
    for (int k = 0; k < wanted; k++)
        references[k] = (unsigned)atoi(told[9 + k]);
    FILE *out = fopen(told[5], "wb");
    if (!out)
        fail("the output file cannot be written");
    double next = start(told + 2);
    states(x);
    for (int k = 0; k <= steps; k++) {
        if (k)
            advance_to((k - 1) * length, k * length, x, &next);
        if (k == steps / 2)
            go_and_return(k * length, length, x);
        if (version == 2)
            CALL(fmi2GetReal, c, references, (size_t)wanted, values);
        else
            CALL(fmi3GetFloat64, c, references, (size_t)wanted, values, (size_t)wanted);
        fwrite(values, sizeof *values, (size_t)wanted, out);
    }
    fclose(out);
    if (version == 2) {
        CALL(fmi2Terminate, c);
        ((fmi2FreeInstanceTYPE *)function("fmi2FreeInstance"))(c);
    } else {
        CALL(fmi3Terminate, c);
        ((fmi3FreeInstanceTYPE *)function("fmi3FreeInstance"))(c);
    }
    return 0;
}
