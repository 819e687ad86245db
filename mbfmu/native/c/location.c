/* The address of a folder, as a host of FMI 2.0 gives it (RFC 8089). */

#include "location.h"

#include <stdbool.h>
#include <string.h>

static int hexadecimal(char c)
{
    if (c >= '0' && c <= '9')
        return c - '0';
    c = (char)(c | 0x20);
    return c >= 'a' && c <= 'f' ? c - 'a' + 10 : -1;
}

/* Whether a text begins so, in letters of either case; the beginning is in lower case. */
static bool begins(const char *text, const char *beginning)
{
    for (; *beginning; text++, beginning++)
        if (*text != *beginning && (*text < 'A' || *text > 'Z' || (*text | 0x20) != *beginning))
            return false;
    return true;
}

void read_location(const char *location, char *path)
{
    const char *at = location;
    bool coded = begins(at, "file:");
    if (coded) {
        at += 5;
        if (at[0] == '/' && at[1] == '/')
            at = strchr(at + 2, '/') ? strchr(at + 2, '/') : at + 2; /* leave out the machine */
        if (at[0] == '/' && at[1] && at[2] == ':')
            at++; /* the drive of a Windows path */
    }
    while (*at) {
        int high = coded && at[0] == '%' ? hexadecimal(at[1]) : -1, low = high >= 0 ? hexadecimal(at[2]) : -1;
        *path++ = low >= 0 ? (char)(16 * high + low) : *at;
        at += low >= 0 ? 3 : 1;
    }
    *path = '\0';
}
