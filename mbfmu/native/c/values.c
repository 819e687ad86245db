/* Values of variables: what a host reads and sets.

   A value that is not allowed is not taken, and no step is made until an allowed one is given. */

#include <math.h>
#include <string.h>

#include "instance.h"

static const char *const types[] = {"Real", "Integer", "Boolean", "String", "Enumeration"};

/* Whether a flag of some variable is set; every step asks. */
bool is_marked(const Instance *own, unsigned flag)
{
    const unsigned char *flags = own->flags;
    uint64_t all = 0, word;
    for (size_t k = 0, count = flag_words(own); k < count; k++) {
        memcpy(&word, flags + k * sizeof word, sizeof word);
        all |= word;
    }
    return all & flag * UINT64_C(0x0101010101010101);
}

/* Clear a flag of all variables. */
void unmark(Instance *own, unsigned flag)
{
    if (is_marked(own, flag))
        for (size_t k = 0; k < count_of(own); k++)
            own->flags[k] &= (unsigned char)~flag;
}

/* Return what was refused and not given right since; NULL: nothing. */
const Variable *refused_value(const Instance *own)
{
    if (!is_marked(own, REFUSED))
        return NULL;
    for (size_t k = 0; k < count_of(own); k++)
        if (own->flags[k] & REFUSED)
            return &own->variables[k];
    return NULL;
}

Outcome fail_refused(Instance *own, Outcome outcome, const Variable *v)
{
    char text[SAYS];
    SAY(text, "'", text_at(own, v->name), "' was set to a value that is not allowed; allowed: ",
        text_at(own, v->allowed));
    return fail(own, outcome, text);
}

/* Return the place of the value of a parameter that events set; NULL: no event sets this variable. */
static double *event_value(const Instance *own, size_t k)
{
    const Member *set = section(own, own->header->event_parameters);
    for (int64_t i = 0; i < own->header->event_parameters_count; i++)
        if ((size_t)set[i].variable == k)
            return (double *)(own->block + own->header->event_values_at) + i;
    return NULL;
}

/* Return the value of a variable: an event may have set a parameter since it was given. */
double present_value(const Instance *own, size_t k)
{
    const double *by_event = event_value(own, k);
    return by_event && !isnan(*by_event) ? *by_event : own->values[k];
}

/* Whether the initialization is over and nothing has failed. */
static bool is_at_work(const Instance *own)
{
    return own->phase >= RUNNING && own->phase < FAILED;
}

/* Give the model an input, with its rate if that was set too. */
static void give_now(Instance *own, size_t k)
{
    int64_t code, number = own->variables[k].number;
    void *error;
    own->linearized = false;
    own->family->set(&code, &error, root_of(own), number, own->values[k], own->flags[k] & RATED ? own->rates[number] : NAN);
}

/* Let what was set since the last step reach the model, in the order of mbfmu/session/kernels/sequence.py. */
void apply_changes(Instance *own)
{
    bool tuned = false;
    if (!is_marked(own, GIVEN))
        return;
    if (own->exchange) {
        apply_exchange_changes(own);
        return;
    }
    for (size_t k = 0; k < count_of(own); k++)
        tuned = tuned || (own->flags[k] & GIVEN && own->variables[k].role == ROLE_PARAMETER);
    if (tuned) {
        call_entry(own, own->family->note_energy);
        put_parameters(own, true);
        call_entry(own, own->family->retune);
    }
    for (size_t k = 0; k < count_of(own); k++) {
        if (!(own->flags[k] & GIVEN))
            continue;
        if (own->variables[k].role == ROLE_INPUT)
            give_now(own, k);
        own->flags[k] &= (unsigned char)~GIVEN;
        own->fresh = own->derived = false;
    }
}

/* Return a variable of these types; NULL: there is none, which is said. */
static const Variable *known(Instance *own, uint32_t reference, unsigned wanted)
{
    char text[SAYS], digits[32];
    if (reference >= count_of(own)) {
        SAY(text, "value reference ", in_digits(digits, reference), " is not a variable of this FMU");
        mistake(own, text);
        return NULL;
    }
    const Variable *v = &own->variables[reference];
    if (!(wanted & 1u << v->type)) {
        SAY(text, "'", text_at(own, v->name), "' is of type ", types[v->type], ", but it was accessed as another type");
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
    if (is_at_work(own)) {
        apply_changes(own); /* an input changes accelerations and forces at once */
        return evaluate(own);
    }
    return OK;
}

Outcome get(Instance *own, uint32_t reference, unsigned wanted, double *value)
{
    if (reference >= count_of(own) && is_exchanged(own, reference))
        return get_exchanged(own, reference, wanted, value);
    const Variable *v = known(own, reference, wanted);
    if (!v)
        return ERROR;
    Outcome outcome = OK;
    if ((v->role == ROLE_OUTPUT || v->role == ROLE_COUNTER) && !own->fresh)
        outcome = refresh(own);
    *value = present_value(own, reference);
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
        return "it is an output of the solver";
    if (v->settable == SETTABLE_NEVER)
        return "it is a constant in this FMU; export the FMU again to change it";
    if (own->phase == TERMINATED)
        return "the FMU is terminated; reset it first";
    if (v->settable == SETTABLE_BEFORE && own->phase != INSTANTIATED && own->phase != INITIALIZING)
        return "it can be changed only before the end of the initialization";
    if (v->role == ROLE_PARAMETER && own->phase == CONTINUOUS_MODE)
        return "a parameter can be changed only in event mode";
    return NULL;
}

Outcome set(Instance *own, uint32_t reference, unsigned wanted, double value)
{
    char text[SAYS], digits[32];
    if (is_exchanged(own, reference))
        return set_exchanged(own, reference, wanted, value);
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
    if (is_at_work(own) && present_value(own, reference) == value && (own->exchange || v->role != ROLE_INPUT))
        return OK; /* an input may have changed since; whether it has is decided where it is set */
    if (own->exchange && v->fixed_in_exchange && is_at_work(own)) {
        SAY(text, "'", text_at(own, v->name), "' was set to ", in_digits(digits, value), ", but it is constant in model "
            "exchange: it moves a joint without an input for its acceleration; set it before the end of the initialization");
        return mistake(own, text);
    }
    double *by_event = event_value(own, reference);
    if (by_event)
        *by_event = NAN;
    own->values[reference] = value;
    own->flags[reference] |= GIVEN;
    own->fresh = own->derived = false;
    return OK;
}

/* Set the first derivatives of inputs by time, with which they continue from the point that the FMU has reached. */
Outcome set_rates(Instance *own, const char *call, const uint32_t inputs[], size_t n, const int32_t orders[],
                  const double rates[])
{
    char text[SAYS], digits[32];
    Outcome worst = OK;
    if (own->exchange || !own->header->takes_rates)
        return not_offered(own, call);
    for (size_t k = 0; k < n; k++) {
        const Variable *v = known(own, inputs[k], 1u << TYPE_REAL);
        const char *why = v ? locked(own, v) : NULL;
        if (v && v->role == ROLE_INPUT && !why && orders[k] == 1 && isfinite(rates[k])) {
            own->rates[v->number] = rates[k];
            own->flags[inputs[k]] |= GIVEN | RATED;
            own->fresh = own->derived = false;
            continue;
        }
        worst = ERROR;
        if (!v)
            continue;
        if (v->role != ROLE_INPUT)
            SAY(text, call, " was called for '", text_at(own, v->name), "'; allowed: inputs");
        else if (why)
            SAY(text, call, " was called for '", text_at(own, v->name), "', but ", why);
        else if (orders[k] != 1)
            SAY(text, call, " was called for derivative ", in_digits(digits, orders[k]), " of '", text_at(own, v->name),
                "'; allowed: derivative 1");
        else {
            own->flags[inputs[k]] |= REFUSED;
            SAY(text, "the derivative of '", text_at(own, v->name), "' was set to ", in_digits(digits, rates[k]),
                "; allowed: a finite number");
        }
        mistake(own, text);
    }
    return worst;
}
