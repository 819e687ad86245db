/* FMI 3.0 for co-simulation and model exchange. */

#include <stdlib.h>

#include "fmi3_host.h"

/* Give a message to the host if it has asked for those of its category. */
static void tell(void *host, Outcome outcome, const char *category, const char *text)
{
    const Host *h = host;
    if (h->log && is_logged(h->logged, category))
        h->log(h->environment, (fmi3Status)outcome, category, text);
}

const char *fmi3GetVersion(void)
{
    return fmi3Version;
}

fmi3Status fmi3SetDebugLogging(fmi3Instance c, fmi3Boolean on, size_t n, const fmi3String categories[])
{
    Host *host = c;
    return c ? (fmi3Status)choose_logging(host->own, &host->logged, on, n, categories) : fmi3Error;
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

/* Say why there is no instance, whatever was asked for: the standard wants the reason in the log. */
static fmi3Instance no_instance(fmi3LogMessageCallback log, fmi3InstanceEnvironment environment, const char *text)
{
    if (log)
        log(environment, fmi3Error, "logStatusError", text);
    return NULL;
}

/* Return a new instance; NULL if there is none, with the reason in the log. */
static fmi3Instance instantiate(fmi3String token, fmi3String folder, bool exchange, bool logging,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log)
{
    char text[SAYS] = "the memory for the instance cannot be allocated [out-of-memory]";
    Host *host = calloc(1, sizeof *host);
    if (!host)
        return no_instance(log, environment, text);
    host->log = log;
    host->environment = environment;
    host->logged = logging ? LOG_ALL : 0;
    host->own = create(token ? token : "", folder ? folder : "", exchange, tell, host, text);
    if (host->own)
        return host;
    free(host);
    return no_instance(log, environment, text);
}

fmi3Instance fmi3InstantiateCoSimulation(fmi3String, fmi3String token, fmi3String folder, fmi3Boolean,
                                         fmi3Boolean logging, fmi3Boolean, fmi3Boolean may_return_early,
                                         const fmi3ValueReference[], size_t, fmi3InstanceEnvironment environment,
                                         fmi3LogMessageCallback log, fmi3IntermediateUpdateCallback)
{
    Host *host = instantiate(token, folder, false, logging, environment, log);
    if (host)
        host->may_return_early = may_return_early;
    return host;
}

fmi3Instance fmi3InstantiateModelExchange(fmi3String, fmi3String token, fmi3String folder, fmi3Boolean,
                                          fmi3Boolean logging, fmi3InstanceEnvironment environment,
                                          fmi3LogMessageCallback log)
{
    return instantiate(token, folder, true, logging, environment, log);
}

fmi3Instance fmi3InstantiateScheduledExecution(fmi3String, fmi3String, fmi3String, fmi3Boolean, fmi3Boolean,
                                               fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                               fmi3ClockUpdateCallback, fmi3LockPreemptionCallback,
                                               fmi3UnlockPreemptionCallback)
{
    return no_instance(log, environment,
                       "scheduled execution is not supported: this FMU is for co-simulation and model exchange [fmi-call]");
}

void fmi3FreeInstance(fmi3Instance c)
{
    if (!c)
        return;
    destroy(instance(c));
    free(c);
}

fmi3Status fmi3EnterInitializationMode(fmi3Instance c, fmi3Boolean tolerant, fmi3Float64 tolerance, fmi3Float64 start,
                                       fmi3Boolean ends, fmi3Float64 stop)
{
    if (!c)
        return fmi3Error;
    Outcome outcome = set_up(instance(c), start, ends, stop, tolerant, tolerance);
    return (fmi3Status)(outcome == OK ? enter_initialization(instance(c)) : outcome);
}

fmi3Status fmi3DoStep(fmi3Instance c, fmi3Float64 t, fmi3Float64 length, fmi3Boolean, fmi3Boolean *event,
                      fmi3Boolean *ends, fmi3Boolean *early, fmi3Float64 *reached)
{
    if (!c)
        return fmi3Error;
    const Host *host = c;
    double last;
    Outcome outcome = step(instance(c), t, length, &last);
    bool has_left = has_ended(instance(c)); /* the step has succeeded up to the event that ends the run */
    if (event)
        *event = false;
    if (ends)
        *ends = stopped(instance(c));
    if (early)
        *early = has_left && host->may_return_early && last < t + length;
    if (reached)
        *reached = last;
    return has_left ? fmi3OK : (fmi3Status)outcome;
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

#define WHOLE (1u << TYPE_INTEGER | 1u << TYPE_ENUMERATION)

static fmi3Status wrong_count(fmi3Instance c)
{
    const char *text = "the number of values is not that of the value references, or NULL was given for them";
    return c ? (fmi3Status)mistake(instance(c), text) : fmi3Error;
}

/* Whether there are as many values as the references stand for. */
static bool fit(fmi3Instance c, const fmi3ValueReference references[], size_t n, const void *values, size_t count)
{
    size_t needed = 0;
    if (!c || (n && (!references || !values)))
        return false;
    for (size_t k = 0; k < n; k++)
        needed += width(instance(c), references[k]);
    return needed == count;
}

static Outcome read(Instance *own, fmi3ValueReference reference, unsigned types, double *value)
{
    if (reference != time_reference(own))
        return get(own, reference, types, value);
    if (!(types & 1u << TYPE_REAL))
        return mistake(own, "'time' is of type Float64, but it was accessed as another type");
    *value = last_successful_time(own);
    return OK;
}

static Outcome assign(Instance *own, fmi3ValueReference reference, unsigned types, double value)
{
    if (reference == time_reference(own))
        return mistake(own, "'time' was set, but it is the independent variable and determined by the steps");
    return set(own, reference, types, value);
}

/* Read values one by one; the worst outcome counts. */
#define GET(values, types, kind)                                                   \
    if (!fit(c, references, n, values, count))                                     \
        return wrong_count(c);                                                     \
    Instance *own = instance(c);                                                   \
    Outcome worst = OK;                                                            \
    size_t at = 0;                                                                 \
    for (size_t k = 0; k < n; k++)                                                 \
        for (size_t i = 0; worst != ERROR && i < width(own, references[k]); i++) { \
            double value = 0.0;                                                    \
            Outcome outcome = read(own, element(own, references[k], i), types, &value); \
            (values)[at++] = (kind)value;                                          \
            worst = outcome > worst ? outcome : worst;                             \
        }                                                                          \
    return (fmi3Status)worst

/* Set values one by one, all that can be. */
#define SET(values, types)                                                         \
    if (!fit(c, references, n, values, count))                                     \
        return wrong_count(c);                                                     \
    Instance *own = instance(c);                                                   \
    Outcome worst = OK;                                                            \
    size_t at = 0;                                                                 \
    for (size_t k = 0; k < n; k++)                                                 \
        for (size_t i = 0; i < width(own, references[k]); i++) {                   \
            Outcome outcome = assign(own, element(own, references[k], i), types, (double)(values)[at++]); \
            worst = outcome > worst ? outcome : worst;                             \
        }                                                                          \
    return (fmi3Status)worst

fmi3Status fmi3GetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t n, fmi3Float64 values[],
                          size_t count)
{
    GET(values, 1u << TYPE_REAL, fmi3Float64);
}

fmi3Status fmi3GetInt64(fmi3Instance c, const fmi3ValueReference references[], size_t n, fmi3Int64 values[],
                        size_t count)
{
    GET(values, WHOLE, fmi3Int64);
}

fmi3Status fmi3GetBoolean(fmi3Instance c, const fmi3ValueReference references[], size_t n, fmi3Boolean values[],
                          size_t count)
{
    GET(values, 1u << TYPE_BOOLEAN, fmi3Boolean);
}

fmi3Status fmi3GetString(fmi3Instance c, const fmi3ValueReference references[], size_t n, fmi3String values[],
                         size_t count)
{
    if (!fit(c, references, n, values, count) || n != count)
        return wrong_count(c);
    Outcome worst = OK;
    for (size_t k = 0; worst == OK && k < n; k++)
        if (references[k] == time_reference(instance(c)))
            worst = mistake(instance(c), "'time' is of type Float64, but it was accessed as another type");
        else
            worst = get_text(instance(c), references[k], &values[k]);
    return (fmi3Status)worst;
}

fmi3Status fmi3SetFloat64(fmi3Instance c, const fmi3ValueReference references[], size_t n, const fmi3Float64 values[],
                          size_t count)
{
    SET(values, 1u << TYPE_REAL);
}

fmi3Status fmi3SetInt64(fmi3Instance c, const fmi3ValueReference references[], size_t n, const fmi3Int64 values[],
                        size_t count)
{
    SET(values, WHOLE);
}

fmi3Status fmi3SetBoolean(fmi3Instance c, const fmi3ValueReference references[], size_t n, const fmi3Boolean values[],
                          size_t count)
{
    SET(values, 1u << TYPE_BOOLEAN);
}

/* ---- derivatives ------------------------------------------------------------------------------------------------- */

static Derivatives derivatives_of(fmi3Instance c, const fmi3ValueReference unknowns[], size_t unknown_count,
                                  const fmi3ValueReference knowns[], size_t known_count, const void *of_unknowns,
                                  size_t n, const void *of_knowns, size_t m)
{
    bool fits = fit(c, unknowns, unknown_count, of_unknowns, n) && fit(c, knowns, known_count, of_knowns, m);
    return (Derivatives){{unknowns, knowns}, {unknown_count, known_count}, true, fits};
}

fmi3Status fmi3GetDirectionalDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t unknown_count,
                                        const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[],
                                        size_t seeds, fmi3Float64 found[], size_t count)
{
    Derivatives d = derivatives_of(c, unknowns, unknown_count, knowns, known_count, found, count, seed, seeds);
    return c ? (fmi3Status)directional_derivative(instance(c), "fmi3GetDirectionalDerivative", &d, seed, found) : fmi3Error;
}

fmi3Status fmi3GetAdjointDerivative(fmi3Instance c, const fmi3ValueReference unknowns[], size_t unknown_count,
                                    const fmi3ValueReference knowns[], size_t known_count, const fmi3Float64 seed[],
                                    size_t seeds, fmi3Float64 found[], size_t count)
{
    Derivatives d = derivatives_of(c, unknowns, unknown_count, knowns, known_count, seed, seeds, found, count);
    return c ? (fmi3Status)adjoint_derivative(instance(c), "fmi3GetAdjointDerivative", &d, seed, found) : fmi3Error;
}

fmi3Status fmi3GetOutputDerivatives(fmi3Instance c, const fmi3ValueReference outputs[], size_t n,
                                    const fmi3Int32 orders[], fmi3Float64 found[], size_t count)
{
    if (!c || (n && !orders) || !fit(c, outputs, n, found, count))
        return wrong_count(c);
    Outcome worst = OK;
    for (size_t k = 0; worst != ERROR && k < n; k++)
        for (size_t i = 0; worst != ERROR && i < width(instance(c), outputs[k]); i++) {
            uint32_t own = element(instance(c), outputs[k], i);
            Outcome outcome = output_derivatives(instance(c), "fmi3GetOutputDerivatives", &own, 1, &orders[k], found++);
            worst = outcome > worst ? outcome : worst;
        }
    return (fmi3Status)worst;
}

/* ---- states ------------------------------------------------------------------------------------------------------ */

fmi3Status fmi3GetFMUState(fmi3Instance c, fmi3FMUState *state)
{
    return c && state ? (fmi3Status)save(instance(c), (State **)state) : fmi3Error;
}

fmi3Status fmi3SetFMUState(fmi3Instance c, fmi3FMUState state)
{
    return c ? (fmi3Status)restore(instance(c), state) : fmi3Error;
}

fmi3Status fmi3FreeFMUState(fmi3Instance, fmi3FMUState *state)
{
    if (state) {
        free(*state);
        *state = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance c, fmi3FMUState, size_t *size)
{
    if (!c || !size)
        return fmi3Error;
    *size = bytes_of(instance(c));
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance c, fmi3FMUState state, fmi3Byte bytes[], size_t size)
{
    return c ? (fmi3Status)write_state(instance(c), state, bytes, size) : fmi3Error;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance c, const fmi3Byte bytes[], size_t size, fmi3FMUState *state)
{
    return c && state ? (fmi3Status)read_state(instance(c), bytes, size, (State **)state) : fmi3Error;
}

/* ---- model exchange ---------------------------------------------------------------------------------------------- */

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance c, fmi3Boolean *more, fmi3Boolean *ends, fmi3Boolean *nominals,
                                    fmi3Boolean *values, fmi3Boolean *has_next, fmi3Float64 *next)
{
    Events events;
    bool given = more && ends && nominals && values && has_next && next;
    Outcome outcome = c ? update_events(instance(c), "fmi3UpdateDiscreteStates", given ? &events : NULL) : ERROR;
    if (outcome != OK)
        return (fmi3Status)outcome;
    *more = false;
    *ends = events.ends;
    *nominals = events.nominals_changed;
    *values = events.states_changed;
    *has_next = events.has_next;
    *next = events.has_next ? events.next : 0.0;
    return fmi3OK;
}

fmi3Status fmi3CompletedIntegratorStep(fmi3Instance c, fmi3Boolean, fmi3Boolean *event, fmi3Boolean *ends)
{
    return c ? (fmi3Status)complete_step(instance(c), "fmi3CompletedIntegratorStep", event, ends) : fmi3Error;
}

fmi3Status fmi3SetTime(fmi3Instance c, fmi3Float64 t)
{
    return c ? (fmi3Status)set_time(instance(c), "fmi3SetTime", false, t) : fmi3Error;
}

fmi3Status fmi3GetContinuousStateDerivatives(fmi3Instance c, fmi3Float64 dx[], size_t n)
{
    return c ? (fmi3Status)get_derivatives(instance(c), "fmi3GetContinuousStateDerivatives", dx, n) : fmi3Error;
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance c, size_t *n)
{
    return c ? (fmi3Status)count_exchanged(instance(c), "fmi3GetNumberOfEventIndicators", true, n) : fmi3Error;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance c, size_t *n)
{
    return c ? (fmi3Status)count_exchanged(instance(c), "fmi3GetNumberOfContinuousStates", false, n) : fmi3Error;
}

/* ---- what both versions have ------------------------------------------------------------------------------------- */

typedef fmi3Status Status;
typedef fmi3Instance Component;
typedef fmi3Float64 Real;
#define FMI(name) fmi3##name
#include "same_calls.h"
