/* Derivatives of x' and of the outputs by states and inputs: directions, and their transposes. */

#include <math.h>
#include <string.h>

#include "instance.h"

/* Where derivatives are allowed: when values are those of a solution. */
#define DEFINED (1u << INITIALIZING | 1u << RUNNING | 1u << EVENT_MODE | 1u << CONTINUOUS_MODE)

typedef enum { UNKNOWN, KNOWN } Side;

/* Return where the derivative of an unknown is, or the part of the direction along a known variable; NULL: the variable
   is neither, which is said. */
static double *entry_of(Instance *own, const char *call, uint32_t reference, Side side)
{
    char text[SAYS], digits[32];
    const Header *h = own->header;
    bool is_derivative;
    int64_t k = exchanged_index(own, reference, &is_derivative);
    if (k >= 0 && is_derivative == (side == UNKNOWN))
        return numbers_at(own, side == UNKNOWN ? h->derivative_slopes_at : h->direction_states_at) + k;
    const Variable *v = k < 0 && reference < count_of(own) ? &own->variables[reference] : NULL;
    if (v && side == UNKNOWN && v->role == ROLE_OUTPUT)
        return numbers_at(own, h->derivative_outputs_at) + v->number;
    if (v && side == KNOWN && v->role == ROLE_INPUT)
        return numbers_at(own, h->direction_inputs_at) + v->number;
    SAY(text, call, " was called with the value reference ", in_digits(digits, reference), " of ",
        v ? "'" : "", v ? text_at(own, v->name) : "another variable", v ? "'" : "",
        side == UNKNOWN ? " as an unknown; allowed: outputs and derivatives of continuous states"
                        : " as a known variable; allowed: inputs and continuous states");
    mistake(own, text);
    return NULL;
}

/* Evaluate at the point of the derivatives, if it is another one than before. */
static Outcome linearize(Instance *own)
{
    Outcome outcome = derive(own);
    if (outcome != OK || own->linearized)
        return outcome;
    bool is_reported = !own->exchange || own->phase == INITIALIZING;
    int64_t code = call_entry_at(own, is_reported ? own->family->exchange_linearize_reported
                                                  : own->family->exchange_linearize, clock_of(own));
    if (code != CODE_OK)
        return discard(own, code);
    own->linearized = true;
    return OK;
}

static Outcome differentiate(Instance *own)
{
    int64_t code = call_entry(own, own->family->exchange_differentiate);
    own->linearized = true; /* the point is still that of the last call */
    return code == CODE_OK ? OK : discard(own, code);
}

static void clear_direction(Instance *own)
{
    const Header *h = own->header;
    memset(numbers_at(own, h->direction_states_at), 0, state_count(own) * sizeof(double));
    for (size_t k = 0; k < count_of(own); k++)
        if (own->variables[k].role == ROLE_INPUT)
            numbers_at(own, h->direction_inputs_at)[own->variables[k].number] = 0.0;
}

/* Whether derivatives can be taken now, by arrays that fit; else the reason is logged. */
static bool is_allowed(Instance *own, const char *call, const Derivatives *d)
{
    char text[SAYS];
    if (!own->header->derivatives)
        not_offered(own, call);
    else if (own->phase == FAILED)
        mistake(own, own->message);
    else if (!(DEFINED & 1u << own->phase))
        refuse(own, call);
    else if (d->fits)
        return true;
    else {
        SAY(text, call, " was called with numbers of values that are not those of the value references, or with NULL");
        mistake(own, text);
    }
    return false;
}

/* How many numbers a variable of one side has: FMI 2 has no arrays. */
static size_t width_of(const Instance *own, const Derivatives *d, int side, size_t k)
{
    return d->has_arrays ? width(own, d->references[side][k]) : 1;
}

static double *place_in(Instance *own, const char *call, const Derivatives *d, Side side, size_t k, size_t i)
{
    uint32_t reference = d->references[side][k];
    return entry_of(own, call, d->has_arrays ? element(own, reference, i) : reference, side);
}

/* Visit all elements of the variables of one side: of arrays one after the other. */
#define FOR_ELEMENTS(side, k, i)                                                   \
    for (size_t k = 0; k < d->count[side]; k++)                                    \
        for (size_t i = 0; i < width_of(own, d, side, k); i++)

static bool are_known(Instance *own, const char *call, const Derivatives *d)
{
    for (int side = UNKNOWN; side <= KNOWN; side++)
        FOR_ELEMENTS(side, k, i)
            if (!place_in(own, call, d, (Side)side, k, i))
                return false;
    return true;
}

/* Fill the derivatives of all unknowns along a seed of the known variables. */
Outcome directional_derivative(Instance *own, const char *call, const Derivatives *d, const double *seed, double *found)
{
    if (!is_allowed(own, call, d) || !are_known(own, call, d))
        return ERROR;
    Outcome outcome = linearize(own);
    if (outcome == OK) {
        clear_direction(own);
        FOR_ELEMENTS(KNOWN, k, i)
            *place_in(own, call, d, KNOWN, k, i) += *seed++;
        outcome = differentiate(own);
    }
    FOR_ELEMENTS(UNKNOWN, k, i)
        *found++ = outcome == OK ? *place_in(own, call, d, UNKNOWN, k, i) : NAN;
    return outcome;
}

/* Fill the derivatives by all known variables of the sum of the unknowns times a seed: one direction for each. */
Outcome adjoint_derivative(Instance *own, const char *call, const Derivatives *d, const double *seed, double *found)
{
    if (!is_allowed(own, call, d) || !are_known(own, call, d))
        return ERROR;
    Outcome outcome = linearize(own);
    FOR_ELEMENTS(KNOWN, k, i) {
        double sum = 0.0;
        const double *factor = seed;
        if (outcome == OK) {
            clear_direction(own);
            *place_in(own, call, d, KNOWN, k, i) = 1.0;
            outcome = differentiate(own);
        }
        FOR_ELEMENTS(UNKNOWN, j, n)
            sum += *factor++ * *place_in(own, call, d, UNKNOWN, j, n);
        *found++ = outcome == OK ? sum : NAN;
    }
    return outcome;
}

/* Fill the first derivatives of outputs by time, of those that depend on positions and velocities alone. */
Outcome output_derivatives(Instance *own, const char *call, const uint32_t outputs[], size_t n, const int32_t orders[],
                           double *found)
{
    char text[SAYS], digits[32];
    if (own->exchange || !own->header->derivatives)
        return not_offered(own, call);
    if (own->phase != RUNNING)
        return own->phase == FAILED ? mistake(own, own->message) : refuse(own, call);
    Outcome outcome = linearize(own);
    bool is_known = outcome == OK;
    if (is_known)
        call_entry(own, own->family->exchange_differentiate_motion);
    for (size_t k = 0; k < n; k++) {
        const Variable *v = outputs[k] < count_of(own) ? &own->variables[outputs[k]] : NULL;
        found[k] = NAN;
        if (!v || v->role != ROLE_OUTPUT || orders[k] != 1) {
            SAY(text, call, " was called for derivative ", in_digits(digits, orders[k]), " of ", v ? "'" : "",
                v ? text_at(own, v->name) : "another variable", v ? "'" : "", "; allowed: derivative 1 of an output");
            return mistake(own, text);
        }
        if (!v->is_motion) {
            SAY(text, call, " was called for '", text_at(own, v->name), "', whose derivative is not available; allowed: outputs "
                "that depend on positions and velocities alone");
            outcome = fail(own, DISCARD, text);
        } else if (is_known)
            found[k] = numbers_at(own, own->header->derivative_outputs_at)[v->number];
    }
    return outcome;
}
