/* A host that does anything: fuzz RESOURCES TOKEN SEED CALLS VARIABLES.
 *
 * Calls functions of FMI 2 and 3, which it is linked with, in any order and with any values. Nothing may crash, every
 * status is one that FMI knows. It is built with sanitizers, which end it where the inside does what it must not, and
 * prints how many steps were made.
 */
#include <math.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "fmi3Functions.h"

enum { MOST = 8, STATES = 4 };

static uint64_t seed;

static uint64_t next(uint64_t below)
{
    seed ^= seed << 13;
    seed ^= seed >> 7;
    seed ^= seed << 17;
    return seed % below;
}

static double number(void)
{
    const double odd[] = {0.0, -1.0, 1e300, NAN, INFINITY, 1e-300, 0.5, 1.0, 2.0, 10.0};
    return next(3) ? odd[next(sizeof odd / sizeof *odd)] : (double)next(1000) / 250.0;
}

static unsigned variables;
static long steps;

static unsigned reference(void)
{
    return next(20) ? (unsigned)next(variables + 2) : (unsigned)next(UINT32_MAX);
}

static void check(int status)
{
    if (status < 0 || status > 3) { /* fatal: never */
        fprintf(stderr, "a call returned %d\n", status);
        exit(2);
    }
}

static void tell2(fmi2ComponentEnvironment, fmi2String, fmi2Status, fmi2String, fmi2String, ...) {}
static void tell3(fmi3InstanceEnvironment, fmi3Status, fmi3String, fmi3String) {}

static void call2(fmi2Component c, double *t, fmi2FMUstate states[STATES])
{
    unsigned which[MOST];
    double reals[MOST];
    int whole[MOST];
    const char *texts[MOST];
    size_t n = next(MOST + 1), size;
    for (size_t k = 0; k < MOST; k++) {
        which[k] = reference();
        reals[k] = number();
        whole[k] = (int)next(7) - 1;
    }
    fmi2FMUstate *state = &states[next(STATES)];
    double length = next(4) ? 1e-3 : number();
    switch (next(19)) {
    case 0:
        check(fmi2SetupExperiment(c, (int)next(2), number(), next(2) ? 0.0 : number(), (int)next(2), number()));
        break;
    case 1:
        check(fmi2EnterInitializationMode(c));
        break;
    case 2:
        check(fmi2ExitInitializationMode(c));
        break;
    case 3:
        check(fmi2SetReal(c, which, n, reals));
        break;
    case 4:
        check(fmi2SetInteger(c, which, n, whole));
        break;
    case 5:
        check(fmi2SetBoolean(c, which, n, whole));
        break;
    case 6:
        check(fmi2GetReal(c, which, n, reals));
        break;
    case 7:
        check(fmi2GetInteger(c, which, n, whole));
        check(fmi2GetBoolean(c, which, n, whole));
        check(fmi2GetString(c, which, n, texts));
        break;
    case 8:
        check(fmi2GetFMUstate(c, state));
        break;
    case 9:
        check(fmi2SetFMUstate(c, *state));
        break;
    case 10:
        check(fmi2FreeFMUstate(c, state));
        break;
    case 11:
        if (fmi2SerializedFMUstateSize(c, *state, &size) == fmi2OK && *state) {
            char *bytes = calloc(size, 1);
            check(fmi2SerializeFMUstate(c, *state, bytes, next(4) ? size : size / 2));
            if (!next(3))
                bytes[next(size)] ^= 1;
            check(fmi2FreeFMUstate(c, state));
            check(fmi2DeSerializeFMUstate(c, bytes, next(4) ? size : size / 2, state));
            free(bytes);
        }
        break;
    case 12:
        if (!next(20)) {
            check(fmi2Terminate(c));
            check(fmi2Reset(c));
            *t = 0.0;
        }
        break;
    case 13:
        check(fmi2SetRealInputDerivatives(c, which, n, whole, reals));
        check(fmi2GetRealOutputDerivatives(c, which, n, whole, reals));
        check(fmi2GetRealStatus(c, fmi2LastSuccessfulTime, t));
        break;
    case 14:
        check(fmi2GetDirectionalDerivative(c, which, n / 2, which + MOST / 2, n / 2, reals, reals + MOST / 2));
        break;
    default:
        if (fmi2DoStep(c, *t, length, fmi2True) == fmi2OK) {
            *t += length;
            steps++;
        } else
            fmi2GetRealStatus(c, fmi2LastSuccessfulTime, t);
    }
}

static void call3(fmi3Instance c, double *t)
{
    unsigned which[MOST];
    double reals[MOST];
    int64_t whole[MOST];
    bool truths[MOST], one, two, three;
    size_t n = next(MOST + 1), m = next(10) ? n : next(MOST + 1);
    for (size_t k = 0; k < MOST; k++) {
        which[k] = reference();
        reals[k] = number();
        whole[k] = (int64_t)next(7) - 1;
        truths[k] = next(2);
    }
    switch (next(10)) {
    case 0:
        check(fmi3EnterInitializationMode(c, next(2), number(), next(2) ? 0.0 : number(), next(2), number()));
        break;
    case 1:
        check(fmi3ExitInitializationMode(c));
        break;
    case 2:
        check(fmi3SetFloat64(c, which, n, reals, m));
        break;
    case 3:
        check(fmi3SetInt64(c, which, n, whole, m));
        check(fmi3SetBoolean(c, which, n, truths, m));
        break;
    case 4:
        check(fmi3GetFloat64(c, which, n, reals, m));
        check(fmi3GetInt64(c, which, n, whole, m));
        break;
    case 5:
        if (!next(20))
            check(fmi3Reset(c));
        break;
    case 6:
        check(fmi3EnterEventMode(c));
        break;
    case 7:
        n /= 2, m /= 2;
        check(fmi3GetDirectionalDerivative(c, which, n, which + MOST / 2, n, reals, m, reals + MOST / 2, n));
        check(fmi3GetAdjointDerivative(c, which, n, which + MOST / 2, n, reals, m, reals + MOST / 2, n));
        break;
    default:
        n = (size_t)fmi3DoStep(c, *t, 1e-3, true, &one, &two, &three, t);
        check((int)n);
        steps += n == fmi3OK;
    }
}

/* Model exchange: mostly in the order of an importing tool, so that it gets far, and anything in between. */
static void exchange2(fmi2Component c, double *t)
{
    double x[2 * MOST];
    fmi2EventInfo info;
    fmi2Boolean event, ends;
    static size_t n = 6;
    size_t m = next(20) ? n : next(2 * MOST);
    if (fmi2GetContinuousStates(c, x, m) != fmi2OK)
        for (size_t k = 0; k < 2 * MOST; k++)
            x[k] = number();
    switch (next(12)) {
    case 0:
        check(fmi2NewDiscreteStates(c, next(20) ? &info : NULL));
        break;
    case 1:
        check(fmi2EnterContinuousTimeMode(c));
        break;
    case 2:
        if (!next(4))
            check(fmi2EnterEventMode(c));
        break;
    case 3:
        check(fmi2CompletedIntegratorStep(c, fmi2True, next(20) ? &event : NULL, &ends));
        break;
    case 4:
        *t += 1e-3;
        check(fmi2SetTime(c, next(20) ? *t : number()));
        break;
    case 5:
    case 6:
        for (size_t k = 0; k < 2 * MOST; k++)
            x[k] = next(30) ? x[k] + 1e-3 * ((double)next(3) - 1.0) : number();
        check(fmi2SetContinuousStates(c, x, m));
        break;
    case 7:
        check(fmi2GetNominalsOfContinuousStates(c, x, m));
        break;
    case 8:
        check(fmi2GetEventIndicators(c, x, next(2)));
        break;
    default:
        steps += fmi2GetDerivatives(c, x, m) == fmi2OK;
    }
}

static void exchange3(fmi3Instance c, double *t)
{
    double x[2 * MOST], at;
    bool a, b, d, e, f;
    size_t n = 6, m;
    check(fmi3GetNumberOfContinuousStates(c, &n));
    check(fmi3GetNumberOfEventIndicators(c, &m));
    m = n <= 2 * MOST && next(20) ? n : next(2 * MOST);
    if (fmi3GetContinuousStates(c, x, m) != fmi3OK)
        for (size_t k = 0; k < 2 * MOST; k++)
            x[k] = number();
    switch (next(10)) {
    case 0:
        check(fmi3UpdateDiscreteStates(c, &a, &b, &d, &e, next(20) ? &f : NULL, &at));
        break;
    case 1:
        check(fmi3EnterContinuousTimeMode(c));
        break;
    case 2:
        if (!next(4))
            check(fmi3EnterEventMode(c));
        break;
    case 3:
        check(fmi3CompletedIntegratorStep(c, true, &a, next(20) ? &b : NULL));
        break;
    case 4:
        *t += 1e-3;
        check(fmi3SetTime(c, next(20) ? *t : number()));
        break;
    case 5:
    case 6:
        for (size_t k = 0; k < 2 * MOST; k++)
            x[k] = next(30) ? x[k] + 1e-3 * ((double)next(3) - 1.0) : number();
        check(fmi3SetContinuousStates(c, x, m));
        break;
    default:
        steps += fmi3GetContinuousStateDerivatives(c, x, m) == fmi3OK;
    }
}

int main(int count, char **told)
{
    if (count < 6)
        return 1;
    seed = strtoull(told[3], NULL, 10) * 2654435761u + 1;
    variables = (unsigned)atoi(told[5]);
    fmi2CallbackFunctions callbacks = {tell2, calloc, free, NULL, NULL};
    char location[4096];
    snprintf(location, sizeof location, "file://%s", told[1]);
    fmi2Component c = fmi2Instantiate("one", fmi2CoSimulation, told[2], location, &callbacks, fmi2False, fmi2True);
    fmi3Instance d = fmi3InstantiateCoSimulation("two", told[2], told[1], false, true, false, false, NULL, 0, NULL, tell3,
                                                 NULL);
    fmi2Component e = fmi2Instantiate("three", fmi2ModelExchange, told[2], location, &callbacks, fmi2False, fmi2True);
    fmi3Instance f = fmi3InstantiateModelExchange("four", told[2], told[1], false, true, NULL, tell3);
    if (!c || !d || !e || !f)
        return 3;
    if (fmi2Instantiate("bad", fmi2CoSimulation, "other", location, &callbacks, fmi2False, fmi2True) ||
        fmi2Instantiate("bad", fmi2CoSimulation, told[2], "file:///no/where", &callbacks, fmi2False, fmi2True) ||
        fmi2Instantiate(NULL, fmi2ModelExchange, told[2], NULL, NULL, fmi2False, fmi2True))
        return 4;
    check(fmi2DoStep(NULL, 0.0, 1.0, fmi2True));
    double t = 0.0, t3 = 0.0, te = 0.0, tf = 0.0;
    fmi2FMUstate states[STATES] = {NULL}, own[STATES] = {NULL};
    for (long k = 0; k < atol(told[4]); k++) {
        call2(c, &t, states);
        call3(d, &t3);
        if (next(3)) {
            exchange2(e, &te);
            exchange3(f, &tf);
        } else {
            call2(e, &te, next(10) ? own : states);
            call3(f, &tf);
        }
    }
    for (int k = 0; k < STATES; k++) {
        fmi2FreeFMUstate(c, &states[k]);
        fmi2FreeFMUstate(e, &own[k]);
    }
    fmi2FreeInstance(c);
    fmi3FreeInstance(d);
    fmi2FreeInstance(e);
    fmi3FreeInstance(f);
    printf("%ld\n", steps);
    return 0;
}
