/* The start of the model from the values as they are, and its outputs. */

#include <math.h>
#include <string.h>

#include "instance.h"

/* Calls of entry points, which return their code. */

int64_t call_entry(Instance *own, int32_t (*entry)(int64_t *, void **, void *))
{
    int64_t code;
    void *error;
    own->linearized = false;
    entry(&code, &error, root_of(own));
    return code;
}

int64_t call_entry_at(Instance *own, int32_t (*entry)(int64_t *, void **, void *, double), double t)
{
    int64_t code;
    void *error;
    own->linearized = false;
    entry(&code, &error, root_of(own), t);
    return code;
}

/* Call an entry point of events at a time (s), which is interrupted where an event sets a parameter. */
int64_t call_events(Instance *own, int32_t (*entry)(int64_t *, void **, void *, double), double t)
{
    int64_t code;
    while ((code = call_entry_at(own, entry, t)) == PARAMETER_REQUESTED) {
        const EventControl *control = (const EventControl *)(own->block + own->header->events_at);
        call_entry(own, own->family->note_energy);
        numbers_at(own, own->header->event_values_at)[control->parameter] = control->value;
        put_parameters(own, true);
        call_entry(own, own->family->retune);
    }
    return code;
}

double *numbers_at(Instance *own, int64_t at)
{
    return (double *)(own->block + at);
}

double clock_of(Instance *own)
{
    return *numbers_at(own, own->header->clock_at);
}

/* Let the block continue from the first part of another one, which was saved. */
void put_back(Instance *own, const unsigned char *saved)
{
    memcpy(own->block, saved, saved_bytes(own));
    call_entry(own, own->family->restore);
}

static void read_outputs(Instance *own)
{
    const double *out = numbers_at(own, own->header->out_at);
    const int64_t *counts = (const int64_t *)(own->block + own->header->counts_at);
    if (!own->exchange)
        call_entry(own, own->family->count);
    for (size_t k = 0; k < count_of(own); k++) {
        const Variable *v = &own->variables[k];
        if (v->role == ROLE_OUTPUT)
            own->values[k] = out[v->number];
        else if (v->role == ROLE_COUNTER)
            own->values[k] = (double)counts[v->number];
    }
}

/* Evaluate the outputs at the time reached. */
Outcome evaluate(Instance *own)
{
    char text[SAYS];
    int64_t code = own->exchange ? read_exchanged(own)
                                 : call_entry(own, own->advanced ? own->family->read_advanced : own->family->read);
    if (code != CODE_OK) {
        describe_stop(own, code, text);
        return fail(own, DISCARD, text);
    }
    read_outputs(own);
    warn_undetermined(own);
    own->fresh = true;
    return OK;
}

/* Give the model an input: its entry point says from when. */
void give(Instance *own, int32_t (*entry)(int64_t *, void **, void *, int64_t, double), size_t k)
{
    int64_t code;
    void *error;
    own->linearized = false;
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
        " before the end of the initialization, but the steady state in which this FMU starts was computed at the export "
        "for ", in_digits(two, v->start), ". Set it after the initialization, or export the FMU again with this value");
    return fail(own, ERROR, text);
}

/* Give the model its values, and return whether it has to be assembled, or balanced, again: a start in a steady state is
 * that of the file unless a value differs from that of the export. */
static bool give_values(Instance *own)
{
    bool late = own->start != 0.0, other = put_parameters(own, false) || (late && !own->header->steady);
    *numbers_at(own, own->header->clock_at) = own->start;
    for (size_t k = 0; k < count_of(own); k++) {
        const Variable *v = &own->variables[k];
        if (v->role != ROLE_INPUT || !(late || own->flags[k] & GIVEN))
            continue;
        give(own, own->family->start, k); /* what it moves begins at the start time */
        other = other || !own->header->steady || own->values[k] != v->start;
    }
    return other;
}

/* Start the model from the values as they are. */
Outcome start_anew(Instance *own)
{
    char text[SAYS];
    const Variable *wrong = refused_value(own);
    if (wrong)
        return fail_refused(own, ERROR, wrong);
    if (!own->untouched && !load_block(own)) {
        SAY(text, "file '", own->path, "', which is needed to reset the FMU, is missing or was changed; unzip the FMU again [fmu-files]");
        return fail(own, ERROR, text);
    }
    own->untouched = false;
    own->warned_balance = own->warned_coarse = own->warned_near_miss = own->warned_undetermined = own->warned_branch = false;
    own->warned_lifting = own->warned_slipping = own->warned_second = own->warned_end = 0;
    for (size_t k = 0; k < count_of(own); k++)
        own->flags[k] &= (unsigned char)~JUMP_REPORTED;
    put_options(own);
    if ((wrong = moved_from_rest(own)))
        return fail_moved(own, wrong);
    int64_t code = ASSEMBLY_ASSEMBLED;
    if (give_values(own))
        code = own->header->steady ? call_entry(own, own->family->balance)
                                   : call_entry_at(own, own->family->assemble, own->start);
    if (code != ASSEMBLY_ASSEMBLED) {
        describe_assembly(own, code, text);
        return fail(own, ERROR, text);
    }
    code = call_entry_at(own, own->family->begin, own->start);
    if (code != CODE_OK) {
        describe_stop(own, code, text);
        return fail(own, ERROR, text);
    }
    const RunStatus *status = (const RunStatus *)(own->block + own->header->run_status_at);
    if (status->flaw) {
        describe_assembly(own, status->flaw, text);
        return fail(own, ERROR, text);
    }
    if (own->header->has_events && !own->exchange &&
        (code = call_events(own, own->family->events_begin, own->start)) != CODE_OK) {
        describe_stop(own, code, text);
        return fail(own, ERROR, text);
    }
    own->reached = own->start;
    if (status->singular)
        warn_singular_start(own);
    warn_coarse(own, status);
    own->derived = false;
    if (own->exchange && (code = start_exchange(own)) != CODE_OK) {
        describe_stop(own, code, text);
        return fail(own, ERROR, text);
    }
    return evaluate(own);
}
