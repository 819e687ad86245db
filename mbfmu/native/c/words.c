/* Messages. */

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"

#define DEGREES 57.29577951308232 /* in a radian */

/* Return a number in digits, with a point wherever the host is. */
const char *in_digits(char digits[32], double value)
{
    snprintf(digits, 32, "%.9g", value);
    for (char *c = digits; *c; c++)
        if (*c == ',')
            *c = '.';
    return digits;
}

/* Append to a text as much as there is room for. */
void add(char text[SAYS], const char *more)
{
    size_t length = strlen(text), room = SAYS - 1 - length, count = strlen(more);
    if (count > room)
        count = room;
    memcpy(text + length, more, count);
    text[length + count] = '\0';
}

void add_all(char text[SAYS], const char *const parts[], size_t count)
{
    for (size_t k = 0; k < count; k++)
        add(text, parts[k]);
}

/* Keep a text where a host can read it. */
static void keep(Instance *own, const char *text)
{
    if (text != own->message)
        SAY(own->message, text);
}

/* Tell what the host did wrong; nothing has changed. */
Outcome mistake(Instance *own, const char *text)
{
    keep(own, text);
    own->log(own->host, ERROR, "logStatusError", text);
    return ERROR;
}

/* Tell what went wrong. */
Outcome fail(Instance *own, Outcome outcome, const char *text)
{
    keep(own, text);
    own->log(own->host, outcome, "logStatusError", text);
    return outcome;
}

/* Say why a solver stopped where it stands, and what to try. */
void tell_stop(Instance *own, int64_t code, char text[SAYS])
{
    const Sentence *sentence = (const Sentence *)section(own, own->header->sentences) + code;
    const double *clock = (const double *)(own->block + own->header->clock_at);
    char digits[32];
    SAY(text, text_at(own, sentence->what), " (t = ", in_digits(digits, *clock), " s). ",
        text_at(own, sentence->remedy));
}

/* Say which row does not close and by what, or which coordinates move no mass. */
void tell_assembly(Instance *own, int64_t code, char text[SAYS])
{
    const Header *h = own->header;
    const Failure *f = (const Failure *)section(own, h->failures) + code;
    const Worst *worst = (const Worst *)(own->block + h->worst_at);
    const double *massless = (const double *)(own->block + h->massless_at);
    const Name *rows = section(own, h->rows), *coordinates = section(own, h->coordinates);
    char digits[32];
    SAY(text, text_at(own, f->before));
    if (code != ASSEMBLY_NO_MASS) {
        const char *gap = code == ASSEMBLY_NOT_FINITE ? "" : in_digits(digits, worst->gap);
        const char *const parts[] = {"'", text_at(own, rows[worst->row].name), "'", text_at(own, f->between), gap,
                                     text_at(own, f->after)};
        add_all(text, parts, sizeof parts / sizeof parts[0]);
        return;
    }
    for (int64_t k = 0, told = 0; k < h->coordinates_count; k++)
        if (massless[k] != 0.0) {
            const char *const parts[] = {told++ ? ", '" : "'", text_at(own, coordinates[k].name), "'"};
            add_all(text, parts, sizeof parts / sizeof parts[0]);
        }
    add(text, text_at(own, f->between));
}

/* Say how far cells of a sheet bend where the model stands, too far for their grid. */
void tell_bend(Instance *own, const char *before, const char *after, char text[SAYS])
{
    const Told *told = (const Told *)(own->block + own->header->told_at);
    const double *clock = (const double *)(own->block + own->header->clock_at);
    char most[32], good[32], digits[32];
    SAY(text, before, "cells bend by up to ", in_digits(most, round(told->bent * DEGREES)),
        " degrees, and are good to about ", in_digits(good, round(COARSE * DEGREES)), ": refine the grid (t = ",
        in_digits(digits, *clock), " s)", after);
}

/* Tell what is unusual and stops nothing. */
void warn(Instance *own, const char *text)
{
    own->log(own->host, WARNING, "logStatusWarning", text);
}
