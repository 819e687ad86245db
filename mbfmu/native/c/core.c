/* Life and values of an instance.

   A step that fails leaves everything as the step found it and may be tried again, shorter. What a host sets and is
   not allowed keeps its value, and no step is made until it is given right. */

#include "core.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "instance.h"

#define AGREED 1e-9 /* s, or part of the time: so much may a host's clock differ from ours */

static const char *const phases[] = {"instantiated", "initializing", "running", "failed", "terminated"};
static const char *const types[] = {"Real", "Integer", "Boolean", "String", "Enumeration"};

/* Calls of entry points, which return their code. */

static int64_t call(Instance *own, int32_t (*entry)(int64_t *, void **, void *))
{
    int64_t code;
    void *error;
    entry(&code, &error, root_of(own));
    return code;
}

static int64_t call_at(Instance *own, int32_t (*entry)(int64_t *, void **, void *, double), double t)
{
    int64_t code;
    void *error;
    entry(&code, &error, root_of(own), t);
    return code;
}

static double *numbers(Instance *own, int64_t at)
{
    return (double *)(own->block + at);
}

static double clock_of(Instance *own)
{
    return *numbers(own, own->header->clock_at);
}

void *host_of(Instance *own)
{
    return own->host;
}

double last_successful_time(const Instance *own)
{
    return own->reached;
}

/* ---- life -------------------------------------------------------------------------------------------------------- */

static void begin_life(Instance *own)
{
    for (size_t k = 0; k < count_of(own); k++)
        own->values[k] = own->variables[k].start;
    memset(own->flags, 0, count_of(own));
    own->start = own->reached = 0.0;
    own->stopped = false;
    own->phase = INSTANTIATED;
    own->fresh = false;
    own->message[0] = '\0';
}

Instance *create(const char *token, const char *folder, Log *log, void *host, char text[SAYS])
{
    Instance *own = calloc(1, sizeof *own);
    if (!own) {
        SAY(text, "there is no memory for the instance");
        return NULL;
    }
    own->log = log;
    own->host = host;
    if (!open_model(own, folder, token, text)) {
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
    free(own->path);
    free(own->tables);
    free(own->room);
    free(own->kept);
    free(own->values);
    free(own->flags);
    free(own);
}

/* Say that a call does not fit the phase. */
Outcome refuse(Instance *own, const char *call)
{
    char text[SAYS];
    SAY(text, call, " is not allowed while the FMU is ", phases[own->phase]);
    return mistake(own, text);
}

/* Say that a call is none that this FMU offers. */
Outcome not_offered(Instance *own, const char *call)
{
    char text[SAYS];
    SAY(text, call, " is not supported: this FMU is for co-simulation, and modelDescription.xml lists what it can do");
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
        SAY(text, "the experiment stops at ", in_digits(one, stop), " s, before its start at ", in_digits(two, start),
            " s");
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

/* Whether a flag of some variable is set; every step asks. */
static bool marked(const Instance *own, unsigned flag)
{
    const unsigned char *flags = own->flags;
    unsigned all = 0;
    for (size_t k = 0, count = count_of(own); k < count; k++)
        all |= flags[k];
    return all & flag;
}

/* Return what was refused and not given right since; NULL: nothing. */
static const Variable *refused(const Instance *own)
{
    if (!marked(own, REFUSED))
        return NULL;
    for (size_t k = 0; k < count_of(own); k++)
        if (own->flags[k] & REFUSED)
            return &own->variables[k];
    return NULL;
}

static Outcome fail_refused(Instance *own, Outcome outcome, const Variable *v)
{
    char text[SAYS];
    SAY(text, "'", text_at(own, v->name), "' was given a value that is not allowed; allowed: ",
        text_at(own, v->allowed));
    return fail(own, outcome, text);
}

static void read_outputs(Instance *own)
{
    const double *out = numbers(own, own->header->out_at);
    const int64_t *counts = (const int64_t *)(own->block + own->header->counts_at);
    call(own, own->family->count);
    for (size_t k = 0; k < count_of(own); k++) {
        const Variable *v = &own->variables[k];
        if (v->role == ROLE_OUTPUT)
            own->values[k] = out[v->number];
        else if (v->role == ROLE_COUNTER)
            own->values[k] = (double)counts[v->number];
    }
}

/* Evaluate the outputs at the time reached. */
static Outcome evaluate(Instance *own)
{
    char text[SAYS];
    int64_t code = call(own, own->family->read);
    if (code != CODE_OK) {
        tell_stop(own, code, text);
        return fail(own, DISCARD, text);
    }
    read_outputs(own);
    own->fresh = true;
    return OK;
}

/* Give the model an input: its entry point says from when. */
static void give(Instance *own, int32_t (*entry)(int64_t *, void **, void *, int64_t, double), size_t k)
{
    int64_t code;
    void *error;
    entry(&code, &error, root_of(own), own->variables[k].number, own->values[k]);
}

/* Return an input that differs from the one whose steady state the model starts in; NULL: none does. */
static const Variable *moved_from_rest(const Instance *own)
{
    const Options *o = (const Options *)(own->block + own->header->options_at);
    for (size_t k = 0; k < count_of(own); k++) {
        const Variable *v = &own->variables[k];
        if (v->rest_scale > 0.0 && fabs(own->values[k] - v->start) > o->rtol * v->rest_scale)
            return v;
    }
    return NULL;
}

static Outcome fail_moved(Instance *own, const Variable *v)
{
    char text[SAYS], one[32], two[32];
    SAY(text, "'", text_at(own, v->name), "' was set to ", in_digits(one, own->values[v - own->variables]),
        " in the initialization, but the steady state that the FMU starts in was found at the export, for ",
        in_digits(two, v->start), ". Set it after the initialization, export the FMU with this value as the start, or "
        "export it without --native, which finds the steady state of the values that are set");
    return fail(own, ERROR, text);
}

/* Start the model from the values as they are. */
static Outcome start_anew(Instance *own)
{
    char text[SAYS];
    const Variable *wrong = refused(own);
    if (wrong)
        return fail_refused(own, ERROR, wrong);
    if (!own->untouched && !load_block(own)) {
        SAY(text, "file '", own->path, "', from which the FMU starts anew, is gone or was changed; unzip the FMU anew");
        return fail(own, ERROR, text);
    }
    own->untouched = false;
    own->warned_jump = own->warned_balance = own->warned_coarse = false;
    put_options(own);
    if ((wrong = moved_from_rest(own)))
        return fail_moved(own, wrong);
    bool late = own->start != 0.0, other = put_parameters(own, false) || late;
    *numbers(own, own->header->clock_at) = own->start;
    for (size_t k = 0; k < count_of(own); k++)
        if (own->variables[k].role == ROLE_INPUT && (late || own->flags[k] & GIVEN)) {
            give(own, own->family->start, k); /* what it moves begins at the start time */
            other = true;
        }
    int64_t code = other ? call_at(own, own->family->assemble, own->start) : ASSEMBLY_ASSEMBLED;
    if (code != ASSEMBLY_ASSEMBLED) {
        tell_assembly(own, code, text);
        return fail(own, ERROR, text);
    }
    code = call_at(own, own->family->begin, own->start);
    if (code != CODE_OK) {
        tell_stop(own, code, text);
        return fail(own, ERROR, text);
    }
    const Told *told = (const Told *)(own->block + own->header->told_at);
    if (told->flaw) {
        tell_assembly(own, told->flaw, text);
        return fail(own, ERROR, text);
    }
    own->reached = own->start;
    return evaluate(own);
}

Outcome enter_initialization(Instance *own)
{
    if (own->phase != INSTANTIATED)
        return refuse(own, "entering the initialization");
    own->phase = INITIALIZING;
    own->fresh = false;
    return OK;
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
    own->phase = RUNNING;
    memset(own->flags, 0, count_of(own));
    return OK;
}

/* Let what was set since the last step reach the model. */
static void apply_changes(Instance *own)
{
    bool tuned = false;
    if (!marked(own, GIVEN))
        return;
    for (size_t k = 0; k < count_of(own); k++)
        tuned = tuned || (own->flags[k] & GIVEN && own->variables[k].role == ROLE_PARAMETER);
    if (tuned) {
        call(own, own->family->weigh);
        put_parameters(own, true);
        call(own, own->family->retune);
    }
    for (size_t k = 0; k < count_of(own); k++) {
        if (!(own->flags[k] & GIVEN))
            continue;
        if (own->variables[k].role == ROLE_INPUT)
            give(own, own->family->set, k);
        own->flags[k] &= (unsigned char)~GIVEN;
        own->fresh = false;
    }
}

/* Whether a step may be made from t; else it is said why not. */
static bool may_step(Instance *own, double t, double length)
{
    char text[SAYS], one[32], two[32];
    const Variable *wrong = refused(own);
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
            " s was asked for; allowed: finite times, and forward");
        fail(own, DISCARD, text);
        return false;
    }
    if (!(fabs(t - here) <= AGREED * fmax(1.0, fabs(here)))) {
        SAY(text, "a step from ", in_digits(one, t), " s was asked for, but the FMU stands at ", in_digits(two, here),
            " s; go on from there, or restore a state saved at the other time");
        fail(own, DISCARD, text);
        return false;
    }
    return true;
}

/* Tell what is unusual about a step that was made; a lost balance is the message of every one since. */
static void look_around(Instance *own, const Told *told)
{
    if (told->jumps && !own->warned_jump) {
        own->warned_jump = true;
        warn(own, "an input jumps in position, farther than its rate explains; the support moves there within a "
                  "communication step");
    }
    if (told->lost) {
        tell_loss(own, own->message);
        if (!own->warned_balance)
            warn(own, own->message);
        own->warned_balance = true;
    }
    if (told->bent > COARSE && !own->warned_coarse) {
        char text[SAYS];
        tell_bend(own, "", "", text);
        warn(own, text);
        own->warned_coarse = true;
    }
}

static Outcome go(Instance *own, double t, double length)
{
    char text[SAYS];
    if (!may_step(own, t, length))
        return own->phase == RUNNING ? DISCARD : ERROR;
    apply_changes(own);
    if (length == 0.0)
        return OK;
    size_t saved = (size_t)own->header->saved;
    memcpy(own->kept, own->block, saved);
    double end = fmax(clock_of(own), t + length); /* the host's clock may be a little slow */
    int64_t code = call_at(own, own->family->step, end);
    const Told *told = (const Told *)(own->block + own->header->told_at);
    if (code != CODE_OK) {
        tell_stop(own, code, text);
        if (told->unknown) {
            char what[SAYS];
            SAY(what, "the rate of an input jumps where its impulse is not known: ", text);
            memcpy(text, what, sizeof text);
        }
        memcpy(own->block, own->kept, saved);
        return fail(own, DISCARD, text);
    }
    if (told->bent > FOLDED) {
        tell_bend(own, "a cell is folded: ", ". " UNFOLD, text);
        memcpy(own->block, own->kept, saved);
        return fail(own, DISCARD, text);
    }
    own->fresh = false;
    own->message[0] = '\0';
    own->reached = end;
    look_around(own, told);
    return OK;
}

/* Go from t by a length, both s; ``reached`` is where the FMU stands afterwards. */
Outcome step(Instance *own, double t, double length, double *reached)
{
    Outcome outcome = go(own, t, length);
    own->stopped = outcome != OK;
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
    if (own->phase != RUNNING && own->phase != FAILED)
        return refuse(own, "terminating");
    own->phase = TERMINATED;
    return OK;
}

Outcome reset(Instance *own)
{
    begin_life(own);
    return OK;
}

/* ---- values ------------------------------------------------------------------------------------------------------ */

/* Return a variable of these types; NULL: there is none, which is said. */
static const Variable *known(Instance *own, uint32_t reference, unsigned wanted)
{
    char text[SAYS], digits[32];
    if (reference >= count_of(own)) {
        SAY(text, "value reference ", in_digits(digits, reference), " is no variable of this FMU");
        mistake(own, text);
        return NULL;
    }
    const Variable *v = &own->variables[reference];
    if (!(wanted & 1u << v->type)) {
        SAY(text, "'", text_at(own, v->name), "' is of type ", types[v->type], "; it was used as another one");
        mistake(own, text);
        return NULL;
    }
    return v;
}

/* Evaluate what is asked for, if it is not known yet. */
static Outcome refresh(Instance *own)
{
    if (own->phase == INITIALIZING)
        return start_anew(own);
    if (own->phase == RUNNING) {
        apply_changes(own); /* an input changes accelerations and forces at once */
        return evaluate(own);
    }
    return OK;
}

Outcome get(Instance *own, uint32_t reference, unsigned wanted, double *value)
{
    const Variable *v = known(own, reference, wanted);
    if (!v)
        return ERROR;
    Outcome outcome = OK;
    if ((v->role == ROLE_OUTPUT || v->role == ROLE_COUNTER) && !own->fresh)
        outcome = refresh(own);
    *value = own->values[reference];
    return outcome;
}

Outcome get_text(Instance *own, uint32_t reference, const char **text)
{
    if (!known(own, reference, 1u << TYPE_STRING))
        return ERROR;
    *text = own->message;
    return OK;
}

/* Return why a variable cannot be set now; NULL: it can. */
static const char *locked(const Instance *own, const Variable *v)
{
    if (v->role == ROLE_OUTPUT)
        return "it is an output";
    if (v->role == ROLE_COUNTER || v->role == ROLE_MESSAGE)
        return "the solver reports it";
    if (v->settable == SETTABLE_NEVER)
        return "it is fixed since the export";
    if (own->phase == TERMINATED)
        return "the FMU is terminated";
    if (v->settable == SETTABLE_BEFORE && own->phase != INSTANTIATED && own->phase != INITIALIZING)
        return "it is fixed since the initialization";
    return NULL;
}

Outcome set(Instance *own, uint32_t reference, unsigned wanted, double value)
{
    char text[SAYS], digits[32];
    const Variable *v = known(own, reference, wanted);
    if (!v)
        return ERROR;
    const char *why = locked(own, v);
    if (why) {
        SAY(text, "'", text_at(own, v->name), "' was set to ", in_digits(digits, value), ", but ", why);
        return mistake(own, text);
    }
    if (!isfinite(value) || value < v->low || value > v->high) {
        own->flags[reference] |= REFUSED;
        SAY(text, "'", text_at(own, v->name), "' was set to ", in_digits(digits, value), "; allowed: ",
            text_at(own, v->allowed));
        return mistake(own, text);
    }
    own->flags[reference] &= (unsigned char)~REFUSED;
    if (own->phase == RUNNING && own->values[reference] == value && !v->moves)
        return OK;
    own->values[reference] = value;
    own->flags[reference] |= GIVEN;
    own->fresh = false;
    return OK;
}
