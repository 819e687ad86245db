/* Life and steps of an instance. A step that fails leaves everything as the step found it and may be tried again,
   shorter. */

#include "core.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"
#include "folder.h"
#include "sundials.h"

#define AGREED 1e-9 /* s, or part of the time: so much may a host's clock differ from ours */

static const char *const phases[] = {"instantiated", "initializing", "running", "in event mode", "in continuous-time mode", "failed",
                                     "terminated"};

void *host_of(Instance *own)
{
    return own->host;
}

double last_successful_time(const Instance *own)
{
    return own->reached;
}

static void begin_life(Instance *own)
{
    for (size_t k = 0; k < count_of(own); k++)
        own->values[k] = own->variables[k].start;
    memset(own->flags, 0, count_of(own));
    own->start = own->reached = 0.0;
    own->stopped = own->ended = false;
    own->phase = INSTANTIATED;
    own->fresh = own->derived = false;
    own->message[0] = '\0';
}

Instance *create(const char *token, const char *folder, bool exchange, Log *log, void *host, char text[SAYS])
{
    Instance *own = calloc(1, sizeof *own);
    if (!own) {
        SAY(text, "the memory for the instance cannot be allocated [out-of-memory]");
        return NULL;
    }
    own->log = log;
    own->host = host;
    own->exchange = exchange;
    if (!open_model(own, folder, token, text)) {
        destroy(own);
        return NULL;
    }
    if (exchange && !own->header->exchange) {
        SAY(text, "model exchange is not supported: this FMU is for co-simulation [fmi-call]");
        destroy(own);
        return NULL;
    }
    begin_life(own);
    return own;
}

void destroy(Instance *own)
{
    if (!own)
        return;
    close_sundials(own);
    if (own->user_library)
        unload(own->user_library);
    free(own->path);
    free(own->tables);
    free(own->libraries);
    free(own->room);
    free(own->kept);
    free(own->values);
    free(own->rates);
    free(own->flags);
    free(own);
}

/* Say that a call does not fit the phase. */
Outcome refuse(Instance *own, const char *call)
{
    char text[SAYS];
    SAY(text, call, " is not allowed in the present state of the FMU: it is ", phases[own->phase]);
    return mistake(own, text);
}

/* Say that a call is none that this FMU offers. */
Outcome not_offered(Instance *own, const char *call)
{
    char text[SAYS];
    SAY(text, call, " is not supported: this ", own->exchange ? "instance is for model exchange" : "FMU is for co-simulation",
        "; its capabilities are in modelDescription.xml");
    return mistake(own, text);
}

/* Note where the experiment begins, and the host's tolerance unless the parameter was set. */
Outcome set_up(Instance *own, double start, bool ends, double stop, bool tolerant, double tolerance)
{
    char text[SAYS], one[32], two[32];
    if (own->phase != INSTANTIATED)
        return refuse(own, "setting up the experiment");
    if (!isfinite(start)) {
        SAY(text, "the start time is ", in_digits(one, start), "; allowed: a finite number");
        return mistake(own, text);
    }
    if (ends && !(stop >= start)) {
        SAY(text, "the stop time of the experiment is ", in_digits(one, stop), " s; allowed: not before its start at ",
            in_digits(two, start), " s");
        return mistake(own, text);
    }
    own->start = own->reached = start;
    for (size_t k = 0; tolerant && tolerance > 0.0 && k < count_of(own); k++) {
        const Variable *v = &own->variables[k];
        if (v->role == ROLE_SETTING && v->number == SETTING_TOLERANCE && !(own->flags[k] & GIVEN)) {
            Outcome outcome = set(own, (uint32_t)k, 1u << TYPE_REAL, tolerance);
            own->flags[k] &= (unsigned char)~GIVEN; /* the parameter may still come */
            return outcome;
        }
    }
    return OK;
}

Outcome enter_initialization(Instance *own)
{
    if (own->phase != INSTANTIATED)
        return refuse(own, "entering the initialization");
    own->phase = INITIALIZING;
    own->fresh = own->derived = false;
    return OK;
}

/* Tell how large errors may be at a coarse tolerance. */
static void warn_coarse_tolerance(Instance *own)
{
    const Options *options = (const Options *)(own->block + own->header->options_at);
    if (own->header->reports_coarse && options->rtol >= COARSE_TOLERANCE)
        warn_filled(own, COARSE_TOLERANCE_TEXT, &options->rtol, NULL);
}

/* Tell that the solver uses another tolerance than requested. */
static void warn_limited_rtol(Instance *own)
{
    const Options *options = (const Options *)(own->block + own->header->options_at);
    const double numbers[] = {own->header->min_rtol, options->rtol};
    if (!own->exchange && options->rtol < own->header->min_rtol)
        warn_filled(own, LIMITED_RTOL_TEXT, numbers, NULL);
}

Outcome exit_initialization(Instance *own)
{
    if (own->phase != INITIALIZING)
        return refuse(own, "leaving the initialization");
    Outcome outcome = own->fresh ? OK : start_anew(own);
    if (outcome != OK) {
        own->phase = FAILED;
        return ERROR;
    }
    own->phase = own->exchange ? EVENT_MODE : RUNNING;
    for (size_t k = 0; k < count_of(own); k++)
        own->flags[k] = own->flags[k] & RATED ? GIVEN | RATED : 0; /* the first step begins with the rates */
    warn_coarse_tolerance(own);
    warn_limited_rtol(own);
    watch_wheels(own);
    return OK;
}

/* Whether a step may be made from t; else it is said why not. */
static bool may_step(Instance *own, double t, double length)
{
    char text[SAYS], one[32], two[32];
    const Variable *wrong = refused_value(own);
    if (own->phase != RUNNING) {
        if (own->phase != FAILED)
            refuse(own, "a step");
        else
            mistake(own, own->message);
        return false;
    }
    if (wrong) {
        fail_refused(own, DISCARD, wrong);
        return false;
    }
    double here = clock_of(own);
    if (!isfinite(t) || !isfinite(length) || length < 0.0) {
        SAY(text, "a step from ", in_digits(one, t), " s by ", in_digits(two, length),
            " s was requested; allowed: finite times, and a step size that is not negative");
        fail(own, DISCARD, text);
        return false;
    }
    if (!(fabs(t - here) <= AGREED * fmax(1.0, fabs(here)))) {
        SAY(text, "a step from ", in_digits(one, t), " s was requested, but the FMU has reached ", in_digits(two, here),
            " s; continue from this time, or restore an FMU state saved at the other time");
        fail(own, DISCARD, text);
        return false;
    }
    return true;
}

/* Tell what is unusual about a step that was made from t, s; a lost balance is the message of every one since. */
static void log_new(Instance *own, const RunStatus *status, double t)
{
    warn_jump(own, status, t);
    warn_near_miss(own);
    if (status->lost) {
        describe_energy_error(own, own->message);
        if (!own->warned_balance)
            warn(own, own->message);
        own->warned_balance = true;
    }
    warn_coarse(own, status);
}

static Outcome go(Instance *own, double t, double length)
{
    char text[SAYS];
    if (!may_step(own, t, length))
        return own->phase == RUNNING ? DISCARD : ERROR;
    apply_changes(own);
    const RunStatus *status = (const RunStatus *)(own->block + own->header->run_status_at);
    if (length == 0.0) {
        own->message[0] = '\0';
        if (status->lost)
            describe_energy_error(own, own->message);
        return OK;
    }
    size_t saved = saved_bytes(own);
    memcpy(own->kept, own->block, saved);
    double here = clock_of(own), end = fmax(here, t + length); /* the host's clock may be a little slow */
    clear_report(own);
    bool has_events = own->header->has_events != 0;
    int64_t code = has_events ? call_events(own, own->family->events_step, end) : call_entry_at(own, own->family->step, end);
    own->ended = code == RUN_ENDED;
    if (code != CODE_OK && !own->ended) {
        warn_reported(own);
        describe_stop(own, code, text);
        if (status->unknown) {
            char what[SAYS];
            SAY(what, "the rate of an input jumps at a time at which the impulse is not determined: ", text);
            memcpy(text, what, sizeof text);
        }
        put_back(own, own->kept);
        return fail(own, DISCARD, text);
    }
    if (!(status->limit_ratio <= MAX_VALID_RATIO)) {
        describe_bend(own, "a cell is folded", ". " UNFOLD " [folded-cell]", text);
        put_back(own, own->kept);
        return fail(own, DISCARD, text);
    }
    unmark(own, RATED);
    own->fresh = own->derived = false;
    own->message[0] = '\0';
    own->reached = own->ended ? clock_of(own) : end;
    log_new(own, status, here);
    own->advanced = !has_events && end > here;
    watch_wheels(own);
    if (!own->ended)
        return OK;
    describe_end(own, text);
    return fail(own, DISCARD, text);
}

/* Whether an event has ended the run in the last step: the FMU stands at the time of the event. */
bool has_ended(const Instance *own)
{
    return own->ended;
}

/* Go from t by a length, both s; ``reached`` is where the FMU stands afterwards. */
Outcome step(Instance *own, double t, double length, double *reached)
{
    Outcome outcome = go(own, t, length);
    own->stopped = outcome != OK;
    own->ended = own->ended && own->stopped;
    *reached = own->reached;
    return outcome;
}

/* Whether the FMU would end here, as the last step failed; a host that can try a shorter one need not follow. Some
 * hosts know nothing but to try the same step again, for ever, where this is not said. */
bool stopped(const Instance *own)
{
    return own->stopped;
}

Outcome terminate(Instance *own)
{
    if (own->phase < RUNNING || own->phase > FAILED)
        return refuse(own, "terminating");
    own->phase = TERMINATED;
    return OK;
}

Outcome reset(Instance *own)
{
    begin_life(own);
    return OK;
}
