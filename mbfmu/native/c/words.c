/* Messages. */

#include <stdio.h>
#include <string.h>

#include "instance.h"

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

/* Tell what the host did wrong; nothing has changed. */
Outcome mistake(Instance *own, const char *text)
{
    own->log(own->host, ERROR, "logStatusError", text);
    return ERROR;
}

/* Tell what went wrong, and keep it where a host can read it. */
Outcome fail(Instance *own, Outcome outcome, const char *text)
{
    own->message[0] = '\0';
    add(own->message, text);
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
