/* A host without Python: host FMI LIBRARY RESOURCES TOKEN OUT STEPS LENGTH VALUES REFERENCE...
 *
 * Runs one instance of an FMU of FMI 2 or 3 by STEPS steps of LENGTH s, and writes its real variables of these value
 * references at every point, as doubles, to the file OUT. In FMI 3 they stand for VALUES numbers in all. Ends with 0, or says which call failed.
 */
#ifdef _WIN32
#include <windows.h>
#define dlopen(path, how) ((void *)LoadLibraryA(path))
#define dlsym(library, name) ((void *)GetProcAddress(library, name))
#define dlclose(library) FreeLibrary(library)
#define dlerror() "the library is not what it should be"
#else
#include <dlfcn.h>
#endif
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

#define MOST 4096

static void *library;

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
    va_list rest;
    va_start(rest, text);
    fprintf(stderr, "%d: ", (int)status);
    vfprintf(stderr, text, rest);
    fprintf(stderr, "\n");
    va_end(rest);
}

static void tell3(fmi3InstanceEnvironment, fmi3Status status, fmi3String, fmi3String text)
{
    fprintf(stderr, "%d: %s\n", (int)status, text);
}

static void run2(char **told, FILE *out, int steps, double length, const unsigned *references, size_t n, size_t)
{
    fmi2CallbackFunctions callbacks = {tell2, calloc, free, NULL, NULL};
    double values[MOST];
    fmi2Component c = ((fmi2InstantiateTYPE *)function("fmi2Instantiate"))(
        "one", fmi2CoSimulation, told[2], told[1], &callbacks, fmi2False, fmi2True);
    if (!c)
        fail("fmi2Instantiate");
    CALL(fmi2SetupExperiment, c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    CALL(fmi2EnterInitializationMode, c);
    CALL(fmi2ExitInitializationMode, c);
    for (int k = 0; k <= steps; k++) {
        if (k)
            CALL(fmi2DoStep, c, (k - 1) * length, k * length - (k - 1) * length, fmi2True);
        CALL(fmi2GetReal, c, references, n, values);
        fwrite(values, sizeof *values, n, out);
    }
    CALL(fmi2Terminate, c);
    ((fmi2FreeInstanceTYPE *)function("fmi2FreeInstance"))(c);
}

static void run3(char **told, FILE *out, int steps, double length, const unsigned *references, size_t n,
                 size_t many)
{
    double values[MOST], reached;
    fmi3Boolean event, ends, early;
    fmi3Instance c = ((fmi3InstantiateCoSimulationTYPE *)function("fmi3InstantiateCoSimulation"))(
        "one", told[2], told[1], false, true, false, false, NULL, 0, NULL, tell3, NULL);
    if (!c)
        fail("fmi3InstantiateCoSimulation");
    CALL(fmi3EnterInitializationMode, c, false, 0.0, 0.0, false, 0.0);
    CALL(fmi3ExitInitializationMode, c);
    for (int k = 0; k <= steps; k++) {
        if (k)
            CALL(fmi3DoStep, c, (k - 1) * length, k * length - (k - 1) * length, true, &event, &ends, &early,
                 &reached);
        CALL(fmi3GetFloat64, c, references, n, values, many);
        fwrite(values, sizeof *values, many, out);
    }
    CALL(fmi3Terminate, c);
    ((fmi3FreeInstanceTYPE *)function("fmi3FreeInstance"))(c);
}

int main(int count, char **told)
{
    unsigned references[MOST];
    if (count < 9 || count - 9 > MOST || atoi(told[8]) > MOST)
        fail("host FMI LIBRARY RESOURCES TOKEN OUT STEPS LENGTH VALUES REFERENCE...");
    library = dlopen(told[2], RTLD_NOW | RTLD_LOCAL);
    if (!library)
        fail(dlerror());
    for (int k = 9; k < count; k++)
        references[k - 9] = (unsigned)strtoul(told[k], NULL, 10);
    FILE *out = fopen(told[5], "wb");
    if (!out)
        fail(told[5]);
    (atoi(told[1]) == 2 ? run2 : run3)(told + 2, out, atoi(told[6]), strtod(told[7], NULL), references,
                                       (size_t)(count - 9), (size_t)atoi(told[8]));
    fclose(out);
    dlclose(library);
    return 0;
}
