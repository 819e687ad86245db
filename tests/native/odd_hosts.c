/* Hosts that do what hosts may do: odd_hosts WAY {LIBRARY LOCATION TOKEN OUTPUTS INPUT}...
 *
 * Every way runs FMUs of FMI 2 otherwise than one after the other, and holds what they tell against a plain run, byte by
 * byte. OUTPUTS are value references of real outputs, with commas between; INPUT is that of a real input, set at every
 * step. Ends with 0, or says what was wrong; with 77 where the machine cannot do it.
 */
#define _GNU_SOURCE
#include <dlfcn.h>
#include <locale.h>
#include <math.h>
#include <pthread.h>
#include <stdarg.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>
#ifdef __SSE__
#include <xmmintrin.h>
#endif

#include "fmi2Functions.h"

enum { MOST = 64, STEPS = 60, THREADS = 100, INSTANCES = 1000, UNABLE = 77 };
static const double LENGTH = 0.01; /* s, of a step */

typedef struct {
    char **told;
    void *library;
    fmi2ValueReference outputs[MOST];
    size_t count;
} Fmu;

typedef struct {
    double values[STEPS + 1][MOST];
} Rows;

static char message[1024];   /* the last one of an FMU */
static atomic_long allocated; /* how often memory was asked for */

void *__libc_malloc(size_t);
void *__libc_calloc(size_t, size_t);
void *__libc_realloc(void *, size_t);

void *malloc(size_t size)
{
    allocated++;
    return __libc_malloc(size);
}

void *calloc(size_t count, size_t size)
{
    allocated++;
    return __libc_calloc(count, size);
}

void *realloc(void *old, size_t size)
{
    allocated++;
    return __libc_realloc(old, size);
}

static void need(int truth, const char *what)
{
    if (truth)
        return;
    fprintf(stderr, "%s; the FMU said: %s\n", what, message);
    _exit(1);
}

#define F(fmu, name) ((fmi2##name##TYPE *)dlsym((fmu)->library, "fmi2" #name))
#define WELL(fmu, name, ...) need(F(fmu, name)(__VA_ARGS__) == fmi2OK, #name)
#define WRONG(fmu, name, ...) need(F(fmu, name)(__VA_ARGS__) == fmi2Error, #name " is to be refused")

static void tell(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String text, ...)
{
    va_list rest;
    va_start(rest, text);
    vsnprintf(message, sizeof message, text, rest);
    va_end(rest);
}

static const fmi2CallbackFunctions callbacks = {tell, calloc, free, NULL, NULL};

static void load(Fmu *fmu)
{
    fmu->library = dlopen(fmu->told[0], RTLD_NOW | RTLD_GLOBAL); /* the worst: names of all meet */
    need(fmu->library != NULL, "dlopen");
}

static fmi2Component made(const Fmu *fmu)
{
    fmi2Component c =
        F(fmu, Instantiate)("one", fmi2CoSimulation, fmu->told[2], fmu->told[1], &callbacks, fmi2False, fmi2True);
    need(c != NULL, "fmi2Instantiate");
    return c;
}

static fmi2Component begun(const Fmu *fmu)
{
    fmi2Component c = made(fmu);
    WELL(fmu, SetupExperiment, c, fmi2False, 0.0, 0.0, fmi2False, 0.0);
    WELL(fmu, EnterInitializationMode, c);
    WELL(fmu, ExitInitializationMode, c);
    return c;
}

static void read_row(const Fmu *fmu, fmi2Component c, Rows *rows, int k)
{
    WELL(fmu, GetReal, c, fmu->outputs, fmu->count, rows->values[k]);
}

static void step(const Fmu *fmu, fmi2Component c, Rows *rows, int k)
{
    fmi2ValueReference input = (fmi2ValueReference)atoi(fmu->told[4]);
    double value = 0.5 * sin(0.3 * k), t = (k - 1) * LENGTH;
    WELL(fmu, SetReal, c, &input, 1, &value);
    WELL(fmu, DoStep, c, t, k * LENGTH - t, fmi2True);
    read_row(fmu, c, rows, k);
}

static void go(const Fmu *fmu, fmi2Component c, Rows *rows, int from, int to)
{
    for (int k = from; k <= to; k++)
        step(fmu, c, rows, k);
}

static void run(const Fmu *fmu, Rows *rows)
{
    fmi2Component c = begun(fmu);
    read_row(fmu, c, rows, 0);
    go(fmu, c, rows, 1, STEPS);
    WELL(fmu, Terminate, c);
    F(fmu, FreeInstance)(c);
}

static void compare(const Fmu *fmu, const Rows *one, const Rows *other, int from)
{
    for (int k = from; k <= STEPS; k++)
        need(memcmp(one->values[k], other->values[k], fmu->count * sizeof(double)) == 0, "outputs differ");
}

/* ---- the ways ---------------------------------------------------------------------------------------------------- */

static Rows plain[2], found[2];

static void two_models(Fmu *fmus)
{
    fmi2Component c[2];
    for (int i = 0; i < 2; i++) {
        c[i] = begun(&fmus[i]);
        read_row(&fmus[i], c[i], &found[i], 0);
    }
    for (int k = 1; k <= STEPS; k++)
        for (int i = 0; i < 2; i++)
            step(&fmus[i], c[i], &found[i], k);
    compare(&fmus[1], &plain[1], &found[1], 0);
}

static void another_s_state(Fmu *fmus)
{
    fmi2Component c = begun(&fmus[0]), other = begun(&fmus[1]);
    fmi2FMUstate state = NULL;
    WELL(&fmus[1], GetFMUstate, other, &state);
    WRONG(&fmus[0], SetFMUstate, c, state);
    WRONG(&fmus[0], GetFMUstate, c, &state); /* which has not room for it */
    need(strstr(message, "not one of this FMU") != NULL, "what is wrong with a state");
    read_row(&fmus[0], c, &found[0], 0);
    go(&fmus[0], c, &found[0], 1, STEPS);
}

static void loaded_again(Fmu *fmu)
{
    for (int k = 0; k < 3; k++) {
        need(dlclose(fmu->library) == 0, "dlclose");
        need(dlopen(fmu->told[0], RTLD_NOW | RTLD_NOLOAD) == NULL, "the library stays");
        load(fmu);
        run(fmu, &found[0]);
    }
}

static void forked(Fmu *fmu)
{
    fmi2Component c = begun(fmu);
    read_row(fmu, c, &found[0], 0);
    go(fmu, c, &found[0], 1, STEPS / 2);
    pid_t child = fork();
    go(fmu, c, &found[0], STEPS / 2 + 1, STEPS);
    compare(fmu, &plain[0], &found[0], 0);
    if (child == 0)
        _exit(0);
    int status;
    need(waitpid(child, &status, 0) == child && WIFEXITED(status) && WEXITSTATUS(status) == 0, "the child went wrong");
}

static void *of_a_thread(void *fmu)
{
    Rows *own = calloc(1, sizeof *own);
    run(fmu, own);
    compare(fmu, &plain[0], own, 0);
    free(own);
    return NULL;
}

static void threads(Fmu *fmu)
{
    pthread_t all[THREADS];
    for (int k = 0; k < THREADS; k++)
        need(pthread_create(&all[k], NULL, of_a_thread, fmu) == 0, "pthread_create");
    for (int k = 0; k < THREADS; k++)
        pthread_join(all[k], NULL);
    run(fmu, &found[0]);
}

static void many(Fmu *fmu)
{
    static fmi2Component all[INSTANCES];
    for (int i = 0; i < INSTANCES; i++)
        all[i] = begun(fmu);
    for (int k = 1; k <= 3; k++)
        for (int i = 0; i < INSTANCES; i++) {
            step(fmu, all[i], &found[0], k);
            need(memcmp(found[0].values[k], plain[0].values[k], fmu->count * sizeof(double)) == 0, "outputs differ");
        }
    for (int i = 0; i < INSTANCES; i++)
        F(fmu, FreeInstance)(all[i]);
    run(fmu, &found[0]);
}

/* Denormals are zero: no motion here has numbers as small. */
static void flushed(Fmu *fmu)
{
#ifdef __SSE__
    unsigned before = _mm_getcsr();
    _mm_setcsr(before | 0x8040);
    run(fmu, &found[0]);
    need(_mm_getcsr() & 0x8000, "the mode of the host was changed");
    _mm_setcsr(before);
#else
    exit(UNABLE);
#endif
}

/* No memory is allocated between the initialization and the end, but for a state. */
static void counted(Fmu *fmu)
{
    fmi2FMUstate first = NULL, later = NULL;
    fmi2Component c = begun(fmu);
    WELL(fmu, GetFMUstate, c, &first);
    WELL(fmu, GetFMUstate, c, &later);
    long before = allocated;
    read_row(fmu, c, &found[0], 0);
    go(fmu, c, &found[0], 1, STEPS);
    need(allocated == before, "memory was allocated");
    need(F(fmu, DoStep)(c, 0.0, LENGTH, fmi2True) == fmi2Discard, "a step from elsewhere");
    WELL(fmu, GetFMUstate, c, &later); /* the given one is used again */
    WELL(fmu, SetFMUstate, c, first);  /* a history of IDA begins again, in the same memory */
    go(fmu, c, &found[0], 1, STEPS);
    need(allocated == before, "memory was allocated after a state");
}

/* Formatting of numbers is the host's, and so are decimal commas. */
static void comma(Fmu *fmu)
{
    fmi2Component c = begun(fmu);
    fmi2ValueReference output = fmu->outputs[0];
    double value = 1.5;
    if (!setlocale(LC_ALL, "de_DE.UTF-8") || localeconv()->decimal_point[0] != ',')
        exit(UNABLE);
    WRONG(fmu, SetReal, c, &output, 1, &value);
    need(strstr(message, "set to 1.5,") != NULL, "a decimal comma");
    run(fmu, &found[0]);
}

/* A state goes on in an instance that was never begun, and in one that was begun otherwise. */
static void restored(Fmu *fmu)
{
    fmi2Component c = begun(fmu), fresh = made(fmu);
    fmi2FMUstate state = NULL;
    read_row(fmu, c, &found[0], 0);
    go(fmu, c, &found[0], 1, STEPS / 2);
    WELL(fmu, GetFMUstate, c, &state);
    F(fmu, FreeInstance)(c);
    WELL(fmu, SetFMUstate, fresh, state);
    go(fmu, fresh, &found[0], STEPS / 2 + 1, STEPS);
    compare(fmu, &plain[0], &found[0], 0);
    WELL(fmu, SetFMUstate, fresh, state); /* and back */
    go(fmu, fresh, &found[0], STEPS / 2 + 1, STEPS);
    WELL(fmu, FreeFMUstate, fresh, &state);
}

/* What a host may pass by mistake or for nothing. */
static void nothing(Fmu *fmu)
{
    fmi2Component c = begun(fmu);
    fmi2FMUstate state = NULL;
    double value = 1.0;
    F(fmu, FreeInstance)(NULL);
    WELL(fmu, FreeFMUstate, c, NULL);
    WELL(fmu, FreeFMUstate, c, &state);
    WELL(fmu, FreeFMUstate, c, &state);
    WELL(fmu, GetReal, c, NULL, 0, NULL);
    WELL(fmu, SetReal, c, NULL, 0, NULL);
    WRONG(fmu, GetReal, c, NULL, 1, &value);
    WRONG(fmu, SetReal, c, fmu->outputs, 1, NULL);
    WRONG(fmu, SetReal, c, fmu->outputs, 1, &value); /* an output */
    WRONG(fmu, SetFMUstate, c, NULL);
    WRONG(fmu, GetFMUstate, c, NULL);
    WRONG(fmu, DoStep, NULL, 0.0, LENGTH, fmi2True);
    read_row(fmu, c, &found[0], 0);
    go(fmu, c, &found[0], 1, STEPS);
    WELL(fmu, Terminate, c);
    WRONG(fmu, DoStep, c, STEPS * LENGTH, LENGTH, fmi2True);
}

static const struct {
    const char *name;
    void (*go)(Fmu *);
    int needs; /* FMUs */
} ways[] = {
    {"two models", two_models, 2}, {"another's state", another_s_state, 2},
    {"loaded again", loaded_again, 1}, {"forked", forked, 1}, {"threads", threads, 1}, {"many", many, 1},
    {"flushed", flushed, 1}, {"counted", counted, 1}, {"comma", comma, 1}, {"restored", restored, 1},
    {"nothing", nothing, 1},
};

int main(int count, char **told)
{
    Fmu fmus[2] = {{.told = told + 2}, {.told = told + 7}};
    for (size_t i = 0; count > 6 && i < sizeof ways / sizeof *ways; i++) {
        if (strcmp(told[1], ways[i].name) || count != 2 + 5 * ways[i].needs)
            continue;
        for (int k = 0; k < ways[i].needs; k++) {
            for (char *at = strtok(strdup(fmus[k].told[3]), ","); at && fmus[k].count < MOST; at = strtok(NULL, ","))
                fmus[k].outputs[fmus[k].count++] = (fmi2ValueReference)atoi(at);
            load(&fmus[k]);
            run(&fmus[k], &plain[k]);
        }
        need(memcmp(plain[0].values[0], plain[0].values[STEPS], sizeof plain[0].values[0]) != 0, "nothing moves");
        ways[i].go(fmus);
        compare(&fmus[0], &plain[0], &found[0], 0);
        return 0;
    }
    fprintf(stderr, "odd_hosts WAY {LIBRARY LOCATION TOKEN OUTPUTS INPUT}...\n");
    return 2;
}
