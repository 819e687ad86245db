/* FMI 2.0 for co-simulation and model exchange. */

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "core.h"
#include "fmi2Functions.h"
#include "location.h"

typedef struct {
    Instance *own;
    const fmi2CallbackFunctions *callbacks;
    unsigned logged; /* categories */
    char name[]; /* of the instance */
} Host;

static Instance *instance(fmi2Component c)
{
    return ((Host *)c)->own;
}

/* Give a message to the host. The text is its own format, percent signs doubled: there are hosts that do not fill in
   what would follow. */
static void deliver(const Host *h, Outcome outcome, const char *category, const char *text)
{
    char format[2 * SAYS], *out = format;
    if (!h->callbacks || !h->callbacks->logger)
        return;
    for (const char *c = text; *c; c++) {
        *out++ = *c;
        if (*c == '%')
            *out++ = '%';
    }
    *out = '\0';
    h->callbacks->logger(h->callbacks->componentEnvironment, h->name, (fmi2Status)outcome, category, format);
}

/* Give a message to the host if it has asked for those of its category. */
static void tell(void *host, Outcome outcome, const char *category, const char *text)
{
    if (is_logged(((const Host *)host)->logged, category))
        deliver(host, outcome, category, text);
}

static Host *host_named(const char *name, const fmi2CallbackFunctions *callbacks)
{
    const char *known = name ? name : "";
    Host *host = calloc(1, sizeof *host + strlen(known) + 1);
    if (host) {
        host->callbacks = callbacks;
        memcpy(host->name, known, strlen(known) + 1);
    }
    return host;
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    Host *host = c;
    return c ? (fmi2Status)choose_logging(host->own, &host->logged, on != fmi2False, n, categories) : fmi2Error;
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean, fmi2Boolean logging)
{
    char text[SAYS] = "the memory for the instance cannot be allocated [out-of-memory]";
    Host *host = host_named(name, callbacks);
    char *folder = malloc(strlen(location ? location : "") + 1);
    if (host && folder) {
        host->logged = logging ? LOG_ALL : 0;
        read_location(location ? location : "", folder);
        if (type == fmi2ModelExchange || type == fmi2CoSimulation)
            host->own = create(guid ? guid : "", folder, type == fmi2ModelExchange, tell, host, text);
        else
            snprintf(text, sizeof text,
                     "the type of the FMU is %d; allowed: 0 (model exchange) or 1 (co-simulation) [fmi-call]", (int)type);
    }
    free(folder);
    if (!host || host->own)
        return host;
    deliver(host, ERROR, "logStatusError", text); /* the standard wants the reason in the log, whatever is asked for */
    free(host);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c)
{
    if (!c)
        return;
    destroy(instance(c));
    free(c);
}

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start,
                               fmi2Boolean ends, fmi2Real stop)
{
    return c ? (fmi2Status)set_up(instance(c), start, ends, stop, tolerant, tolerance) : fmi2Error;
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    return c ? (fmi2Status)enter_initialization(instance(c)) : fmi2Error;
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real t, fmi2Real length, fmi2Boolean)
{
    double reached;
    return c ? (fmi2Status)step(instance(c), t, length, &reached) : fmi2Error;
}

fmi2Status fmi2CancelStep(fmi2Component c)
{
    return c ? (fmi2Status)not_offered(instance(c), "fmi2CancelStep") : fmi2Error;
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

#define WHOLE (1u << TYPE_INTEGER | 1u << TYPE_ENUMERATION)

/* Read values one by one; the worst outcome counts. */
#define GET(values, types, kind)                                                   \
    Outcome worst = c && (n == 0 || (references && (values))) ? OK : ERROR;        \
    for (size_t k = 0; c && worst != ERROR && k < n; k++) {                        \
        double value = 0.0;                                                        \
        Outcome outcome = get(instance(c), references[k], types, &value);          \
        (values)[k] = (kind)value;                                                 \
        worst = outcome > worst ? outcome : worst;                                 \
    }                                                                              \
    return (fmi2Status)worst

/* Set values one by one, all that can be. */
#define SET(values, types)                                                         \
    Outcome worst = c && (n == 0 || (references && (values))) ? OK : ERROR;        \
    for (size_t k = 0; c && references && (values) && k < n; k++) {                \
        Outcome outcome = set(instance(c), references[k], types, (values)[k]);     \
        worst = outcome > worst ? outcome : worst;                                 \
    }                                                                              \
    return (fmi2Status)worst

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2Real values[])
{
    GET(values, 1u << TYPE_REAL, fmi2Real);
}

fmi2Status fmi2GetInteger(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2Integer values[])
{
    GET(values, WHOLE, fmi2Integer);
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2Boolean values[])
{
    GET(values, 1u << TYPE_BOOLEAN, fmi2Boolean);
}

fmi2Status fmi2GetString(fmi2Component c, const fmi2ValueReference references[], size_t n, fmi2String values[])
{
    Outcome worst = c && (n == 0 || (references && values)) ? OK : ERROR;
    for (size_t k = 0; worst == OK && k < n; k++)
        worst = get_text(instance(c), references[k], &values[k]);
    return (fmi2Status)worst;
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference references[], size_t n, const fmi2Real values[])
{
    SET(values, 1u << TYPE_REAL);
}

fmi2Status fmi2SetInteger(fmi2Component c, const fmi2ValueReference references[], size_t n, const fmi2Integer values[])
{
    SET(values, WHOLE);
}

fmi2Status fmi2SetBoolean(fmi2Component c, const fmi2ValueReference references[], size_t n, const fmi2Boolean values[])
{
    SET(values, 1u << TYPE_BOOLEAN);
}

fmi2Status fmi2SetString(fmi2Component c, const fmi2ValueReference[], size_t n, const fmi2String[])
{
    if (!c)
        return fmi2Error;
    const char *text = "a string variable was set; this FMU has no string variable that can be set";
    return n ? (fmi2Status)mistake(instance(c), text) : fmi2OK;
}

fmi2Status fmi2SetRealInputDerivatives(fmi2Component c, const fmi2ValueReference inputs[], size_t n,
                                       const fmi2Integer orders[], const fmi2Real rates[])
{
    if (!c || (n && (!inputs || !orders || !rates)))
        return fmi2Error;
    return n ? (fmi2Status)set_rates(instance(c), "fmi2SetRealInputDerivatives", inputs, n, orders, rates) : fmi2OK;
}

fmi2Status fmi2GetRealOutputDerivatives(fmi2Component c, const fmi2ValueReference outputs[], size_t n,
                                        const fmi2Integer orders[], fmi2Real found[])
{
    if (!c || (n && (!outputs || !orders || !found)))
        return fmi2Error;
    return (fmi2Status)output_derivatives(instance(c), "fmi2GetRealOutputDerivatives", outputs, n, orders, found);
}

fmi2Status fmi2GetDirectionalDerivative(fmi2Component c, const fmi2ValueReference unknowns[], size_t unknown_count,
                                        const fmi2ValueReference knowns[], size_t known_count, const fmi2Real seed[],
                                        fmi2Real found[])
{
    const Derivatives d = {{unknowns, knowns}, {unknown_count, known_count}, false,
                           (!unknown_count || (unknowns && found)) && (!known_count || (knowns && seed))};
    return c ? (fmi2Status)directional_derivative(instance(c), "fmi2GetDirectionalDerivative", &d, seed, found) : fmi2Error;
}

/* ---- states and status ------------------------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    return c && state ? (fmi2Status)save(instance(c), (State **)state) : fmi2Error;
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate state)
{
    return c ? (fmi2Status)restore(instance(c), state) : fmi2Error;
}

fmi2Status fmi2FreeFMUstate(fmi2Component, fmi2FMUstate *state)
{
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate, size_t *size)
{
    if (!c || !size)
        return fmi2Error;
    *size = bytes_of(instance(c));
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size)
{
    return c ? (fmi2Status)write_state(instance(c), state, bytes, size) : fmi2Error;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state)
{
    return c && state ? (fmi2Status)read_state(instance(c), bytes, size, (State **)state) : fmi2Error;
}

fmi2Status fmi2GetStatus(fmi2Component c, const fmi2StatusKind, fmi2Status *)
{
    return c ? fmi2Discard : fmi2Error; /* no step is ever pending */
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Real *value)
{
    if (!c || !value)
        return fmi2Error;
    if (kind != fmi2LastSuccessfulTime)
        return fmi2Discard;
    *value = last_successful_time(instance(c));
    return fmi2OK;
}

fmi2Status fmi2GetIntegerStatus(fmi2Component c, const fmi2StatusKind, fmi2Integer *)
{
    return c ? fmi2Discard : fmi2Error;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value)
{
    if (!c || !value)
        return fmi2Error;
    if (kind != fmi2Terminated)
        return fmi2Discard;
    *value = stopped(instance(c));
    return fmi2OK;
}

fmi2Status fmi2GetStringStatus(fmi2Component c, const fmi2StatusKind, fmi2String *)
{
    return c ? fmi2Discard : fmi2Error;
}

/* ---- model exchange ---------------------------------------------------------------------------------------------- */

fmi2Status fmi2NewDiscreteStates(fmi2Component c, fmi2EventInfo *info)
{
    Events events;
    Outcome outcome = c ? update_events(instance(c), "fmi2NewDiscreteStates", info ? &events : NULL) : ERROR;
    if (outcome != OK)
        return (fmi2Status)outcome;
    info->newDiscreteStatesNeeded = fmi2False;
    info->terminateSimulation = events.ends;
    info->nominalsOfContinuousStatesChanged = events.nominals_changed;
    info->valuesOfContinuousStatesChanged = events.states_changed;
    info->nextEventTimeDefined = events.has_next;
    info->nextEventTime = events.has_next ? events.next : 0.0;
    return fmi2OK;
}

fmi2Status fmi2CompletedIntegratorStep(fmi2Component c, fmi2Boolean, fmi2Boolean *event, fmi2Boolean *ends)
{
    bool one, two;
    Outcome outcome = ERROR;
    if (c)
        outcome = complete_step(instance(c), "fmi2CompletedIntegratorStep", event ? &one : NULL, ends ? &two : NULL);
    if (outcome == OK || outcome == WARNING) {
        *event = one;
        *ends = two;
    }
    return (fmi2Status)outcome;
}

fmi2Status fmi2SetTime(fmi2Component c, fmi2Real t)
{
    return c ? (fmi2Status)set_time(instance(c), "fmi2SetTime", true, t) : fmi2Error;
}

fmi2Status fmi2GetDerivatives(fmi2Component c, fmi2Real dx[], size_t n)
{
    return c ? (fmi2Status)get_derivatives(instance(c), "fmi2GetDerivatives", dx, n) : fmi2Error;
}

/* ---- what both versions have ------------------------------------------------------------------------------------- */

typedef fmi2Status Status;
typedef fmi2Component Component;
typedef fmi2Real Real;
#define FMI(name) fmi2##name
#include "same_calls.h"
