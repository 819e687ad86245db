/* Which messages a host has asked for. */

#include <string.h>

#include "instance.h"

static unsigned category_of(const char *name)
{
    if (name && strcmp(name, "logAll") == 0)
        return LOG_ALL;
    if (name && strcmp(name, "logStatusWarning") == 0)
        return LOG_WARNINGS;
    if (name && strcmp(name, "logStatusDiscard") == 0)
        return LOG_DISCARDS;
    return name && strcmp(name, "logStatusError") == 0 ? LOG_ERRORS : 0;
}

/* Whether a message of a category is asked for. */
bool is_logged(unsigned logged, const char *category)
{
    return logged & category_of(category);
}

/* Turn messages on or off: all of them, or those of some categories; on means these and no others. */
Outcome choose_logging(Instance *own, unsigned *logged, bool on, size_t count, const char *const names[])
{
    unsigned named = count ? 0 : LOG_ALL;
    if (count && !names)
        return mistake(own, "the number of log categories is not zero, but NULL was given for them");
    for (size_t k = 0; k < count; k++) {
        unsigned bits = category_of(names[k]);
        if (!bits) {
            char text[SAYS];
            SAY(text, "there is no log category '", names[k] ? names[k] : "NULL",
                "'; allowed: logStatusWarning, logStatusDiscard, logStatusError, logAll");
            return mistake(own, text);
        }
        named |= bits;
    }
    *logged = on ? named : *logged & ~named;
    return OK;
}
