/* What parameters and settings do to the model. */

#include <math.h>
#include <string.h>

#include "instance.h"

static double *number_at(const Instance *own, int64_t at)
{
    return (double *)(own->block + at);
}

static double value_of(const Instance *own, int64_t variable)
{
    return variable == LENGTH ? *number_at(own, own->header->length_at) : present_value(own, (size_t)variable);
}

static double product(const Instance *own, const Term *term)
{
    const Factor *factors = section(own, own->header->factors);
    double value = 1.0;
    for (int64_t k = term->factors; k < term->factors + term->count; k++)
        value *= pow(value_of(own, factors[k].variable) - factors[k].offset, factors[k].power);
    return term->coefficient * value;
}

static double sum_of(const Instance *own, const Sum *sum)
{
    const Term *terms = section(own, own->header->terms);
    double value = 0.0;
    for (int64_t k = sum->terms; k < sum->terms + sum->count; k++)
        value += product(own, &terms[k]);
    return value;
}

/* The root of the largest of some sums of products of powers. */
static double formula(const Instance *own, const Entry *entry)
{
    const Sum *sums = section(own, own->header->sums);
    double largest = sum_of(own, &sums[entry->sums]);
    for (int64_t k = 1; k < entry->count; k++)
        largest = fmax(largest, sum_of(own, &sums[entry->sums + k]));
    return entry->root == 1 ? largest : pow(largest, 1.0 / (double)entry->root);
}

static bool moved(const Instance *own, const Term *term, bool longer)
{
    const Factor *factors = section(own, own->header->factors);
    for (int64_t k = term->factors; k < term->factors + term->count; k++) {
        int64_t variable = factors[k].variable;
        if (variable == LENGTH ? longer : present_value(own, (size_t)variable) != own->variables[variable].start)
            return true;
    }
    return false;
}

/* Whether a parameter of an entry has another value than at the export. */
static bool follows(const Instance *own, const Entry *entry, bool longer)
{
    const Sum *sums = section(own, own->header->sums);
    const Term *terms = section(own, own->header->terms);
    for (int64_t i = entry->sums; i < entry->sums + entry->count; i++)
        for (int64_t k = sums[i].terms; k < sums[i].terms + sums[i].count; k++)
            if (moved(own, &terms[k], longer))
                return true;
    return false;
}

/* Write all that parameters move; whether anything moved. What an input owns is left to it once it was given, and at
   work to what it is. */
bool put_parameters(Instance *own, bool at_work)
{
    const Entry *entries = section(own, own->header->entries);
    bool any = false, longer = false;
    for (int64_t k = 0; k < own->header->entries_count; k++) {
        const Entry *entry = &entries[k];
        bool off = follows(own, entry, longer);
        double value = off ? formula(own, entry) : entry->base;
        if (entry->at == own->header->length_at)
            longer = off;
        any = any || off;
        if (at_work && (entry->once || entry->input >= 0))
            continue;
        if (entry->input >= 0) {
            if (own->flags[entry->input] & GIVEN)
                continue;
            own->values[entry->input] = value;
        }
        *number_at(own, entry->at) = value;
    }
    return any;
}

/* Write what the solver is asked for. */
void put_options(Instance *own)
{
    Options *o = (Options *)(own->block + own->header->options_at);
    for (size_t k = 0; k < count_of(own); k++) {
        if (own->variables[k].role != ROLE_SETTING)
            continue;
        double value = own->values[k];
        switch (own->variables[k].number) {
        case SETTING_TOLERANCE:
            o->rtol = value;
            o->absolute = value;
            break;
        case SETTING_ABSOLUTE_TOLERANCE: /* comes after the tolerance, which it is where it is zero */
            if (value > 0.0)
                o->absolute = value;
            break;
        case SETTING_MAX_ORDER:
            o->max_order = (int64_t)value;
            break;
        case SETTING_MAX_STEPS:
            o->max_steps = (int64_t)value;
            break;
        case SETTING_MAX_STEP:
            o->max_step = value > 0.0 ? value : INFINITY;
            break;
        case SETTING_ENERGY_CHECK:
            o->energy_check = value != 0.0 && !own->exchange; /* model exchange has no account of the work */
            break;
        default: /* constant */
            break;
        }
    }
}
