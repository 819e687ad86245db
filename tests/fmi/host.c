/* A host without Python of its own: host STEPS keep|unload {FMU.so RESOURCES GUID}...
 *
 * Runs one instance of every FMU side by side, with steps of 1 ms, and ends as a process does: with 0, or with the
 * number of the call that failed. The libraries are unloaded first or left to the end of the process.
 */
#include <dlfcn.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST = 8, LOADING = 10, MISSING, INSTANTIATE, INITIALIZE, STEP, TERMINATE };

typedef struct {
    void (*logger)(void *, const char *, int, const char *, const char *, ...);
    void *(*allocate)(size_t, size_t);
    void (*release)(void *);
    void (*finished)(void *, int);
    void *environment;
} Callbacks;

typedef void *Instantiate(const char *, int, const char *, const char *, const Callbacks *, int, int);
typedef int SetupExperiment(void *, int, double, double, int, double);
typedef int Call(void *);
typedef int DoStep(void *, double, double, int);
typedef void FreeInstance(void *);

static void *function(void *library, const char *name)
{
    void *found = dlsym(library, name);
    if (!found) {
        fprintf(stderr, "%s\n", dlerror());
        exit(MISSING);
    }
    return found;
}

static void tell(void *environment, const char *instance, int status, const char *category, const char *text, ...)
{
    va_list rest;
    va_start(rest, text);
    vfprintf(stderr, text, rest);
    va_end(rest);
    fputc('\n', stderr);
}

int main(int count, char **argument)
{
    static const Callbacks callbacks = {tell, calloc, free, NULL, NULL};
    void *library[MOST], *instance[MOST];
    int fmus = (count - 3) / 3;

    for (int i = 0; i < fmus; i++) {
        char **place = argument + 3 + 3 * i;
        library[i] = dlopen(place[0], RTLD_NOW | RTLD_LOCAL);
        if (!library[i]) {
            fprintf(stderr, "%s\n", dlerror());
            return LOADING;
        }
        Instantiate *instantiate = function(library[i], "fmi2Instantiate");
        instance[i] = instantiate("one", 1, place[2], place[1], &callbacks, 0, 1);
        if (!instance[i])
            return INSTANTIATE;
        if (((SetupExperiment *)function(library[i], "fmi2SetupExperiment"))(instance[i], 0, 0.0, 0.0, 0, 0.0) ||
            ((Call *)function(library[i], "fmi2EnterInitializationMode"))(instance[i]) ||
            ((Call *)function(library[i], "fmi2ExitInitializationMode"))(instance[i]))
            return INITIALIZE;
    }
    for (int k = 0; k < atoi(argument[1]); k++)
        for (int i = 0; i < fmus; i++)
            if (((DoStep *)function(library[i], "fmi2DoStep"))(instance[i], 1e-3 * k, 1e-3, 1))
                return STEP;
    for (int i = 0; i < fmus; i++) {
        if (((Call *)function(library[i], "fmi2Terminate"))(instance[i]))
            return TERMINATE;
        ((FreeInstance *)function(library[i], "fmi2FreeInstance"))(instance[i]);
    }
    if (!strcmp(argument[2], "unload"))
        for (int i = 0; i < fmus; i++)
            dlclose(library[i]);
    return 0;
}
