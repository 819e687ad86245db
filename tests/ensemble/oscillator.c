/* An oscillator as an FMU (FMI 2.0 for co-simulation) that has nothing of ours: x'' = -k x, by the midpoint rule. */
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef struct {
    double x, v, k;
} Oscillator;

#define OK 0
#define DISCARD 2
#define ERROR 3

const char *fmi2GetTypesPlatform(void) { return "default"; }
const char *fmi2GetVersion(void) { return "2.0"; }
int fmi2SetDebugLogging(void *c, int on, size_t n, const char *const names[]) { return OK; }

void *fmi2Instantiate(const char *name, int type, const char *guid, const char *place, const void *calls, int visible, int log)
{
    Oscillator *own = malloc(sizeof *own);
    *own = (Oscillator){1.0, 0.0, 1.0};
    return own;
}

void fmi2FreeInstance(void *c) { free(c); }
int fmi2SetupExperiment(void *c, int given, double tolerance, double start, int ends, double stop) { return OK; }
int fmi2EnterInitializationMode(void *c) { return OK; }
int fmi2ExitInitializationMode(void *c) { return ((Oscillator *)c)->k < 0.0 ? ERROR : OK; }
int fmi2Terminate(void *c) { return OK; }
int fmi2Reset(void *c) { return OK; }

int fmi2GetReal(void *c, const unsigned r[], size_t n, double values[])
{
    const double *own = (const double *)c;
    for (size_t i = 0; i < n; i++)
        values[i] = own[r[i]];
    return OK;
}

int fmi2SetReal(void *c, const unsigned r[], size_t n, const double values[])
{
    double *own = (double *)c;
    for (size_t i = 0; i < n; i++)
        own[r[i]] = values[i];
    return OK;
}

int fmi2DoStep(void *c, double t, double h, int kept)
{
    Oscillator *o = c;
    if (o->k > 1e6) /* too stiff: it asks for a shorter step, which the host does not make */
        return DISCARD;
    if (o->k == 123.0 && t > 0.5) /* it loses its state, and does not say so */
        o->v = NAN;
    while (o->k == 321.0) /* it hangs */
        usleep(10000);
    for (int i = 0; i < 100; i++) {
        double d = 0.01 * h, x = o->x + 0.5 * d * o->v, v = o->v - 0.5 * d * o->k * o->x;
        o->x += d * v;
        o->v -= d * o->k * x;
    }
    return OK;
}

int fmi2GetBooleanStatus(void *c, int kind, int *ended)
{
    *ended = 0;
    return OK;
}

/* What an FMU must have and this one has no use for. */
#define NOTHING(name) int name(void) { return ERROR; }
NOTHING(fmi2GetInteger) NOTHING(fmi2GetBoolean) NOTHING(fmi2GetString)
NOTHING(fmi2SetInteger) NOTHING(fmi2SetBoolean) NOTHING(fmi2SetString)
NOTHING(fmi2GetFMUstate) NOTHING(fmi2SetFMUstate) NOTHING(fmi2FreeFMUstate)
NOTHING(fmi2SerializedFMUstateSize) NOTHING(fmi2SerializeFMUstate) NOTHING(fmi2DeSerializeFMUstate)
NOTHING(fmi2GetDirectionalDerivative) NOTHING(fmi2SetRealInputDerivatives) NOTHING(fmi2GetRealOutputDerivatives)
NOTHING(fmi2CancelStep) NOTHING(fmi2GetStatus) NOTHING(fmi2GetRealStatus) NOTHING(fmi2GetIntegerStatus)
NOTHING(fmi2GetStringStatus)
