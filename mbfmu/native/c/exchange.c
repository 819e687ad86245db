/* Model exchange: modes, states and derivatives. Kernels evaluate the equations at the time and the states of the block. */

#include <math.h>
#include <string.h>

#include "instance.h"

#define AT_WORK (1u << EVENT_MODE | 1u << CONTINUOUS_MODE)

size_t state_count(const Instance *own)
{
    return own->header->exchange ? (size_t)(own->header->positions + own->header->velocities) : 0;
}

/* Whether an instance for model exchange is in one of these modes; else the reason is logged. */
static bool is_in(Instance *own, unsigned modes, const char *call)
{
    if (!own->exchange)
        not_offered(own, call);
    else if (own->phase == FAILED)
        mistake(own, own->message);
    else if (!(modes & 1u << own->phase))
        refuse(own, call);
    else
        return true;
    return false;
}

/* Whether a place for a result is given; else the reason is logged. */
static bool is_given(Instance *own, const char *call, const void *place)
{
    char text[SAYS];
    if (place)
        return true;
    SAY(text, call, " was called with NULL for a result");
    mistake(own, text);
    return false;
}

/* Return the number of continuous states, or of event indicators. */
Outcome count_exchanged(Instance *own, const char *call, bool indicators, size_t *n)
{
    if (!own->exchange)
        return not_offered(own, call);
    if (!is_given(own, call, n))
        return ERROR;
    *n = indicators ? (size_t)own->header->indicators : state_count(own);
    return OK;
}

/* Whether an array has as many entries as there are states; else the reason is logged. */
static bool fits_states(Instance *own, const char *call, const double *x, size_t n)
{
    char text[SAYS], one[32], two[32];
    if (n == state_count(own) && (x || !n))
        return true;
    SAY(text, call, " was called with ", in_digits(one, (double)n), x || !n ? "" : " (and NULL)",
        " as the number of continuous states; allowed: ", in_digits(two, (double)state_count(own)));
    mistake(own, text);
    return false;
}

static double *times_of(Instance *own)
{
    return numbers_at(own, own->header->exchange_times_at);
}

/* Let values of parameters reach the model, at the present time. */
static void retune(Instance *own)
{
    call_entry_at(own, own->family->exchange_read, clock_of(own)); /* places the bodies for the energy */
    call_entry(own, own->family->note_energy);
    put_parameters(own, true);
    call_entry(own, own->family->retune);
    times_of(own)[RESTART] = 1.0;
}

/* Let what was set reach the model, at the present time. */
void apply_exchange_changes(Instance *own)
{
    bool tuned = false;
    for (size_t k = 0; k < count_of(own); k++)
        tuned = tuned || (own->flags[k] & GIVEN && own->variables[k].role == ROLE_PARAMETER);
    if (tuned)
        retune(own);
    for (size_t k = 0; k < count_of(own); k++) {
        if (own->flags[k] & GIVEN && own->variables[k].role == ROLE_INPUT)
            give(own, own->family->start, k);
        own->flags[k] &= (unsigned char)~GIVEN;
    }
    own->fresh = own->derived = false;
}

/* Begin a run at the start time and the reported state; return a code. */
int64_t start_exchange(Instance *own)
{
    call_entry_at(own, own->family->exchange_start, own->start);
    own->derived = false;
    own->reported = 0;
    return own->header->has_events ? call_entry_at(own, own->family->events_exchange_start, own->start) : CODE_OK;
}

/* Call an entry point at the present time; return a code of the solvers. */
static int64_t call_now(Instance *own, int32_t (*entry)(int64_t *, void **, void *, double))
{
    int64_t code = call_entry_at(own, entry, clock_of(own));
    return code == STATES_NOT_FINITE ? CODE_NOT_FINITE : code;
}

/* Report, once for each reason, that an evaluation is discarded. */
Outcome discard(Instance *own, int64_t code)
{
    unsigned bit = 1u << (unsigned)(code < 0 ? 32 + code : code);
    const Sentence *sentences = section(own, own->header->sentences);
    char digits[32];
    const char *what = code == LEFT_BRANCH ? "the state is on another branch of the motion than the last completed step"
                       : code == STATES_NOT_FINITE ? "a continuous state that the importing tool has set is not finite"
                       : code >= 0                 ? text_at(own, sentences[code].what)
                                                   : "";
    if (own->reported & bit || (code == STATES_NOT_FINITE && own->reported)) /* a result of a discarded evaluation */
        return DISCARD;
    own->reported |= bit;
    if (code == NOT_DIFFERENTIABLE)
        SAY(own->message, "derivatives by states and inputs are not determined at t = ", in_digits(digits, clock_of(own)),
            " s: two branches of the motion cross there. Request them at another state [discarded-evaluation]");
    else
        SAY(own->message, "the evaluation at t = ", in_digits(digits, clock_of(own)), " s is discarded: ", what,
            ". The importing tool is expected to repeat the step with a smaller step size; if it cannot, reduce its "
            "tolerance or its step size [discarded-evaluation]");
    own->log(own->host, DISCARD, "logStatusDiscard", own->message);
    return DISCARD;
}

/* Return the number of the state that a value reference stands for, or of which it is the derivative; negative: none. */
int64_t exchanged_index(Instance *own, uint32_t reference, bool *is_derivative)
{
    size_t first = (size_t)time_reference(own) + 1 + (size_t)own->header->arrays_count, n = state_count(own);
    if (reference < first || reference - first >= 2 * n)
        return -1;
    size_t k = reference - first;
    *is_derivative = k >= n;
    return (int64_t)(*is_derivative ? k - n : k);
}

/* Return where a value reference is in the block: a state, or a derivative. */
static double *place_of(Instance *own, uint32_t reference)
{
    bool is_derivative;
    int64_t k = exchanged_index(own, reference, &is_derivative);
    if (k < 0)
        return NULL;
    return numbers_at(own, is_derivative ? own->header->exchange_derivatives_at : own->header->exchange_x_at) + k;
}

/* Return the number of the event indicator that a value reference stands for; negative: none. */
static int64_t indicator_index(Instance *own, uint32_t reference)
{
    size_t first = (size_t)time_reference(own) + 1 + (size_t)own->header->arrays_count + 2 * state_count(own);
    if (reference < first || reference - first >= (size_t)own->header->indicators)
        return -1;
    return (int64_t)(reference - first);
}

bool is_exchanged(Instance *own, uint32_t reference)
{
    return place_of(own, reference) != NULL || indicator_index(own, reference) >= 0;
}

/* Evaluate the derivatives, if they are not known yet. */
Outcome derive(Instance *own)
{
    if (own->phase == INITIALIZING && !own->fresh) {
        Outcome outcome = start_anew(own);
        if (outcome != OK)
            return outcome;
    }
    if (is_marked(own, GIVEN) && own->phase != INITIALIZING)
        apply_changes(own);
    if (own->derived)
        return OK;
    int64_t code = call_entry_at(
        own, own->exchange ? own->family->exchange_evaluate : own->family->exchange_report, clock_of(own));
    if (code != CODE_OK)
        return discard(own, code);
    own->derived = true;
    return OK;
}

/* Evaluate the event indicators, in model exchange at the time and the states. */
static Outcome indicate(Instance *own)
{
    Outcome outcome = own->phase == INITIALIZING && !own->fresh ? start_anew(own) : OK;
    if (outcome == OK && own->phase != INITIALIZING && is_marked(own, GIVEN))
        apply_changes(own);
    if (outcome != OK)
        return outcome;
    const Family *family = own->family;
    int64_t code = call_now(own, own->exchange ? family->events_exchange_indicate : family->events_exchange_report);
    return code == CODE_OK ? OK : discard(own, code);
}

/* Return the value of a state, of a derivative, or of an event indicator. */
Outcome get_exchanged(Instance *own, uint32_t reference, unsigned wanted, double *value)
{
    if (!(wanted & 1u << TYPE_REAL))
        return mistake(own, "a continuous state, its derivative or an event indicator is of type Real, but it was accessed as "
                            "another type");
    Outcome outcome = OK;
    int64_t indicator = indicator_index(own, reference);
    if (indicator >= 0) {
        if (own->phase != INSTANTIATED && own->phase != FAILED && own->phase != TERMINATED)
            outcome = indicate(own);
        *value = outcome == OK ? numbers_at(own, own->header->indicators_at)[indicator] : NAN;
        return outcome;
    }
    bool derivative = place_of(own, reference) >= numbers_at(own, own->header->exchange_derivatives_at);
    if (own->phase != INSTANTIATED && own->phase != FAILED && own->phase != TERMINATED && (derivative || !own->exchange))
        outcome = derive(own);
    *value = outcome == OK || !derivative ? *place_of(own, reference) : NAN;
    return outcome;
}

/* Set one state; the standard has a function for all of them, but some tools set them as variables. */
Outcome set_exchanged(Instance *own, uint32_t reference, unsigned wanted, double value)
{
    bool is_derivative = false;
    exchanged_index(own, reference, &is_derivative);
    if (!(wanted & 1u << TYPE_REAL))
        return mistake(own, "a continuous state is of type Real, but it was set as another type");
    if (indicator_index(own, reference) >= 0 || is_derivative || !own->exchange || !(AT_WORK & 1u << own->phase))
        return mistake(own, "a continuous state, its derivative or an event indicator was set as a variable; allowed: to set "
                            "states in model exchange, after the initialization");
    double *place = place_of(own, reference);
    if (*place != value)
        own->fresh = own->derived = false;
    *place = value;
    return OK;
}

/* Evaluate the outputs at the time and the states. */
int64_t read_exchanged(Instance *own)
{
    return call_now(own, own->family->exchange_read);
}

Outcome set_time(Instance *own, const char *call, bool in_events, double t)
{
    char text[SAYS], digits[32];
    if (!is_in(own, in_events ? AT_WORK : 1u << CONTINUOUS_MODE, call))
        return ERROR;
    if (!isfinite(t)) {
        SAY(text, call, " was called with ", in_digits(digits, t), "; allowed: a finite time");
        return mistake(own, text);
    }
    if (t != clock_of(own))
        own->fresh = own->derived = false;
    *numbers_at(own, own->header->clock_at) = own->reached = t;
    return OK;
}

Outcome set_states(Instance *own, const char *call, const double *x, size_t n)
{
    if (!is_in(own, 1u << CONTINUOUS_MODE, call) || !fits_states(own, call, x, n))
        return ERROR;
    double *own_x = numbers_at(own, own->header->exchange_x_at);
    if (n && memcmp(own_x, x, n * sizeof *x)) {
        memcpy(own_x, x, n * sizeof *x);
        own->fresh = own->derived = false;
    }
    return OK;
}

Outcome get_states(Instance *own, const char *call, double *x, size_t n)
{
    if (!is_in(own, AT_WORK | 1u << INITIALIZING, call) || !fits_states(own, call, x, n))
        return ERROR;
    Outcome outcome = own->phase == INITIALIZING && !own->fresh ? start_anew(own) : OK;
    if (n)
        memcpy(x, numbers_at(own, own->header->exchange_x_at), n * sizeof *x);
    return outcome;
}

/* Derivatives that are discarded are no numbers: a tool that does not look at the status must not use them. */
Outcome get_derivatives(Instance *own, const char *call, double *dx, size_t n)
{
    if (!is_in(own, AT_WORK | 1u << INITIALIZING, call) || !fits_states(own, call, dx, n))
        return ERROR;
    Outcome outcome = derive(own);
    const double *known = numbers_at(own, own->header->exchange_derivatives_at);
    for (size_t k = 0; k < n; k++)
        dx[k] = outcome == OK ? known[k] : NAN;
    return outcome;
}

Outcome get_nominals(Instance *own, const char *call, double *nominal, size_t n)
{
    if (!is_in(own, AT_WORK | 1u << INITIALIZING, call) || !fits_states(own, call, nominal, n))
        return ERROR;
    Outcome outcome = own->phase == INITIALIZING && !own->fresh ? start_anew(own) : OK;
    const double *known = numbers_at(own, own->header->exchange_nominal_at);
    for (size_t k = 0; k < n; k++)
        nominal[k] = known[k] > 0.0 ? known[k] : 1.0;
    return outcome;
}

/* Evaluate the event indicators; those of a discarded evaluation are no numbers. */
Outcome get_indicators(Instance *own, const char *call, double *z, size_t n)
{
    char text[SAYS], one[32], two[32];
    size_t count = (size_t)own->header->indicators;
    if (!is_in(own, AT_WORK | 1u << INITIALIZING, call))
        return ERROR;
    if (n != count || (n && !z)) {
        SAY(text, call, " was called with ", in_digits(one, (double)n), n && !z ? " (and NULL)" : "",
            " as the number of event indicators; allowed: ", in_digits(two, (double)count));
        return mistake(own, text);
    }
    if (!n)
        return OK;
    Outcome outcome = indicate(own);
    const double *known = numbers_at(own, own->header->indicators_at);
    for (size_t k = 0; k < n; k++)
        z[k] = outcome == OK ? known[k] : NAN;
    return outcome;
}

Outcome enter_event_mode(Instance *own, const char *call)
{
    if (!is_in(own, 1u << CONTINUOUS_MODE, call))
        return ERROR;
    own->phase = EVENT_MODE;
    return OK;
}

Outcome enter_continuous_mode(Instance *own, const char *call)
{
    if (!is_in(own, 1u << EVENT_MODE, call))
        return ERROR;
    Events events;
    Outcome outcome = times_of(own)[RESTART] > 0.0 ? update_events(own, call, &events) : OK;
    if (outcome == OK)
        own->phase = CONTINUOUS_MODE;
    return outcome;
}

/* Execute the events of the present time, which are interrupted where one sets a parameter, and update; return a code. */
static int64_t execute_events(Instance *own, bool *restarts)
{
    int64_t code;
    while ((code = call_now(own, own->family->events_exchange_update)) == PARAMETER_REQUESTED) {
        const EventControl *control = (const EventControl *)(own->block + own->header->events_at);
        numbers_at(own, own->header->event_values_at)[control->parameter] = control->value;
        retune(own);
        *restarts = true;
    }
    return code;
}

/* Update at an event. States are projected onto the constraints, which may change them. */
Outcome update_events(Instance *own, const char *call, Events *events)
{
    char text[SAYS];
    if (!is_in(own, 1u << EVENT_MODE, call) || !is_given(own, call, events))
        return ERROR;
    const Variable *wrong = refused_value(own);
    if (wrong)
        return fail_refused(own, ERROR, wrong);
    apply_changes(own);
    size_t bytes = state_count(own) * sizeof(double);
    double *x = numbers_at(own, own->header->exchange_x_at), *before = (double *)own->kept; /* a part of the block */
    bool restarts = times_of(own)[RESTART] > 0.0;
    memcpy(before, x, bytes);
    int64_t code = own->header->has_events ? execute_events(own, &restarts) : call_now(own, own->family->exchange_update);
    events->ends = code == RUN_ENDED;
    if (events->ends)
        describe_end(own, own->message);
    else if (code != CODE_OK) {
        describe_stop(own, code, text);
        return fail(own, ERROR, text);
    }
    own->fresh = own->derived = false;
    events->states_changed = memcmp(before, x, bytes) != 0;
    events->nominals_changed = restarts;
    events->next = times_of(own)[NEXT_EVENT];
    events->has_next = isfinite(events->next);
    return OK;
}

/* Record a completed step, and warn if it ended on another branch of the motion. */
Outcome complete_step(Instance *own, const char *call, bool *event, bool *ends)
{
    char text[SAYS], digits[32];
    if (!is_in(own, 1u << CONTINUOUS_MODE, call) || !is_given(own, call, event) || !is_given(own, call, ends))
        return ERROR;
    *event = *ends = false;
    apply_changes(own);
    int64_t code = call_now(own, own->family->exchange_accept);
    if (own->header->has_events && (code == CODE_OK || code == LEFT_BRANCH))
        *event = call_now(own, own->family->events_exchange_accept) == EVENT_REQUESTED;
    if (code == CODE_OK) {
        watch_wheels(own);
        return OK;
    }
    if (code != LEFT_BRANCH) {
        describe_stop(own, code, text);
        return fail(own, ERROR, text);
    }
    SAY(own->message, "the step that ended at t = ", in_digits(digits, clock_of(own)), " s seems to have changed from one "
        "branch of the motion to another near a singular configuration; the motion after it may be wrong. Use a tolerance "
        "of 1e-6 or smaller in the importing tool, or a smaller step size [left-branch]");
    if (!own->warned_branch)
        warn(own, own->message);
    own->warned_branch = true;
    return WARNING;
}
