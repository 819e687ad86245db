/* Messages. */

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"

#define DEGREES 57.29577951308232 /* in a radian */

/* Return a number in so many digits, with a point wherever the host is. */
static const char *with_digits(char digits[32], int count, double value)
{
    snprintf(digits, 32, "%.*g", count, value);
    for (char *c = digits; *c; c++)
        if (*c == ',')
            *c = '.';
    return digits;
}

const char *in_digits(char digits[32], double value)
{
    return with_digits(digits, 9, value);
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

/* Copy a message, with the code of wrong calls at its end if it has none. */
static void copy_coded(char coded[SAYS], const char *text)
{
    size_t length = strlen(text);
    SAY(coded, text);
    if (!length || text[length - 1] != ']')
        add(coded, " [fmi-call]");
}

/* Report a wrong call of the importing tool; nothing has changed. */
Outcome mistake(Instance *own, const char *text)
{
    return fail(own, ERROR, text);
}

/* Report an error: in the log, and in the variable for messages. */
Outcome fail(Instance *own, Outcome outcome, const char *text)
{
    char coded[SAYS];
    copy_coded(coded, text);
    keep(own, coded);
    own->log(own->host, outcome, "logStatusError", coded);
    return outcome;
}

/* Say why a solver stopped where it stands, and what to try. */
void describe_stop(Instance *own, int64_t code, char text[SAYS])
{
    const Sentence *sentence = (const Sentence *)section(own, own->header->sentences) + code;
    const double *clock = (const double *)(own->block + own->header->clock_at);
    char digits[32];
    SAY(text, text_at(own, sentence->what), " (t = ", in_digits(digits, *clock), " s). ",
        text_at(own, sentence->remedy));
}

/* Say what is wrong with a start: which row does not close and by what, which coordinates move no mass, which loop is
 * closed the wrong way round, which load is misplaced, or what numbers are too coarse for. */
void describe_assembly(Instance *own, int64_t code, char text[SAYS])
{
    const Header *h = own->header;
    const Failure *f = (const Failure *)section(own, h->failures) + code;
    const Worst *worst = (const Worst *)(own->block + h->worst_at);
    const double *massless = (const double *)(own->block + h->massless_at);
    const Name *coordinates = section(own, h->coordinates);
    const bool turned = code == ASSEMBLY_TURNED, misplaced = code == ASSEMBLY_MISPLACED;
    const Name *names = section(own, turned ? h->cuts : misplaced ? h->loads : h->rows);
    const int64_t named = turned ? h->cuts_count : misplaced ? h->loads_count : h->rows_count;
    char digits[32];
    SAY(text, text_at(own, f->before));
    if (code == ASSEMBLY_NO_BRANCH)
        return;
    if (code == ASSEMBLY_UNRESOLVED || code == ASSEMBLY_UNPLACED) {
        add(text, in_digits(digits, worst->gap));
        add(text, text_at(own, f->between));
        return;
    }
    if (code != ASSEMBLY_NO_MASS) {
        const char *gap = code == ASSEMBLY_NOT_FINITE ? "" : in_digits(digits, worst->gap);
        const char *name = worst->row >= 0 && worst->row < named ? text_at(own, names[worst->row].name) : "";
        const char *const parts[] = {"'", name, "'", text_at(own, f->between), gap, text_at(own, f->after)};
        add_all(text, parts, sizeof parts / sizeof parts[0]);
        return;
    }
    for (int64_t k = 0, listed = 0; k < h->coordinates_count; k++)
        if (massless[k] != 0.0) {
            const char *const parts[] = {listed++ ? ", '" : "'", text_at(own, coordinates[k].name), "'"};
            add_all(text, parts, sizeof parts / sizeof parts[0]);
        }
    add(text, text_at(own, f->between));
}

/* Say when and by how much the balance of energy and work was lost. */
void describe_energy_error(const Instance *own, char text[SAYS])
{
    const RunStatus *status = (const RunStatus *)(own->block + own->header->run_status_at);
    double most = fabs(status->energy_error);
    char at[32], lost[32], part[32], all[32];
    if (status->lost == PASSAGE_INACCURATE) {
        SAY(text, "the energy error is too large at t = ", with_digits(at, 6, status->lost_at),
            " s: the energy has changed by ", with_digits(lost, 3, most), " J ", status->energy_error > 0.0 ? "more" : "less",
            " than the work done on the mechanism, which is ", with_digits(part, 2, most / status->passage), " of the ",
            with_digits(all, 3, status->passage), " J by which the motion has just passed an unstable equilibrium, or missed ",
            "it. The time of the passage and the motion after it may be wrong: reduce the tolerance and compare the ",
            "results [slow-passage]");
        return;
    }
    SAY(text, "the energy error is too large at t = ", with_digits(at, 6, status->lost_at),
        " s: the energy has changed by ", with_digits(lost, 3, most), " J ", status->energy_error > 0.0 ? "more" : "less",
        " than the work done on the mechanism");
    if (status->exchanged != 0.0) {
        const char *const parts[] = {", ", with_digits(part, 2, most / status->exchanged), " of the ",
                                     with_digits(all, 3, status->exchanged), " J of energy exchanged"};
        add_all(text, parts, sizeof parts / sizeof parts[0]);
    }
    add(text, ", and more than the tolerance explains. The motion after this time may be wrong: reduce the tolerance or "
              "use another solver, and compare the results [energy-balance]");
}

/* Say how far cells of a sheet bend where the model stands, too far for their grid: limit_ratio is 1 where plates are
   accurate, 2 where they are valid. */
void describe_bend(Instance *own, const char *before, const char *after, char text[SAYS])
{
    const RunStatus *status = (const RunStatus *)(own->block + own->header->run_status_at);
    const double *clock = (const double *)(own->block + own->header->clock_at);
    double ratio = status->limit_ratio;
    double angle = ratio <= 1.0 ? ratio * MAX_ACCURATE_ANGLE
                                : MAX_ACCURATE_ANGLE + (ratio - 1.0) * (MAX_VALID_ANGLE - MAX_ACCURATE_ANGLE);
    char most[32], good[32], digits[32];
    SAY(text, before, " at t = ", in_digits(digits, *clock), " s: adjacent cells are rotated by up to ",
        in_digits(most, round(angle)), " deg; allowed: about ", in_digits(good, round(MAX_ACCURATE_ANGLE)),
        " deg. Refine the grid", after);
}

/* Tell what is unusual and stops nothing. */
void warn(Instance *own, const char *text)
{
    own->log(own->host, WARNING, "logStatusWarning", text);
}

/* Tell once that cells of a sheet bend too far for their grid. */
void warn_coarse(Instance *own, const RunStatus *status)
{
    char text[SAYS];
    if (status->limit_ratio <= 1.0 || own->warned_coarse)
        return;
    describe_bend(own, "the mesh is too coarse", " [coarse-mesh]", text);
    warn(own, text);
    own->warned_coarse = true;
}
