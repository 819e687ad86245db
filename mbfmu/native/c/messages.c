/* Messages. */

#include <math.h>
#include <stdio.h>
#include <string.h>

#include "instance.h"

#define DEGREES 57.29577951308232 /* in a radian */

/* Return a number with a point wherever the host is. */
static const char *with_point(char digits[32])
{
    for (char *c = digits; *c; c++)
        if (*c == ',')
            *c = '.';
    return digits;
}

const char *in_digits(char digits[32], double value)
{
    snprintf(digits, 32, "%.9g", value);
    return with_point(digits);
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
    own->log(own->host, outcome, outcome == DISCARD ? "logStatusDiscard" : "logStatusError", coded);
    return outcome;
}

/* Fill a text of mbfmu/session/run_messages.py: fields with a format, such as {t:.6g}, with numbers, others with texts,
   in quotes where it is {name!r}. */
static void fill(char text[SAYS], const char *form, const double numbers[], const char *const texts[])
{
    char part[SAYS], format[16], digits[32];
    text[0] = '\0';
    for (const char *open; (open = strchr(form, '{')); form = strchr(open, '}') + 1) {
        size_t before = (size_t)(open - form), width = (size_t)(strchr(open, '}') - open);
        const char *colon = memchr(open, ':', width);
        memcpy(part, form, before);
        part[before] = '\0';
        add(text, part);
        if (colon) {
            snprintf(format, sizeof format, "%%%.*s", (int)(width - (size_t)(colon - open) - 1), colon + 1);
            snprintf(digits, sizeof digits, format, *numbers++);
            add(text, with_point(digits));
            continue;
        }
        const char *quote = memchr(open, '!', width) ? "'" : "";
        const char *const parts[] = {quote, *texts++, quote};
        add_all(text, parts, 3);
    }
    add(text, form);
}

/* Describe the event that has ended or stopped the run, by a text of mbfmu/session/run_messages.py. */
static void describe_event(Instance *own, const char *form, char text[SAYS])
{
    const EventControl *control = (const EventControl *)(own->block + own->header->events_at);
    const Name *names = section(own, own->header->events);
    const double numbers[] = {clock_of(own), control->within};
    const char *const texts[] = {text_at(own, names[control->event].name)};
    fill(text, form, numbers, texts);
}

void describe_end(Instance *own, char text[SAYS])
{
    describe_event(own, RUN_ENDED_TEXT, text);
}

/* Say why a solver stopped where it stands, and what to try. */
void describe_stop(Instance *own, int64_t code, char text[SAYS])
{
    static const char *const failed_events[] = {[EVENT_TOO_MANY] = TOO_MANY_EVENTS_TEXT, [EVENT_RESTING] = RESTING_BOUNCE_TEXT,
        [EVENT_MASSLESS] = MASSLESS_EVENT_TEXT, [EVENT_PRESCRIBED] = PRESCRIBED_BOUNCE_TEXT,
        [EVENT_SINGULAR] = SINGULAR_EVENT_TEXT, [EVENT_BEYOND] = START_BEYOND_STOP_TEXT,
        [EVENT_NOT_LOCKED] = NOT_LOCKED_TEXT, [EVENT_PRESCRIBED_LOCK] = PRESCRIBED_LOCK_TEXT};
    if (code == EVENT_FAILED) {
        const EventControl *control = (const EventControl *)(own->block + own->header->events_at);
        describe_event(own, failed_events[control->failure], text);
        return;
    }
    const Sentence *sentence = (const Sentence *)section(own, own->header->sentences) + code;
    const double *clock = (const double *)(own->block + own->header->clock_at);
    char digits[32];
    SAY(text, text_at(own, sentence->what), " (t = ", in_digits(digits, *clock), " s). ",
        text_at(own, sentence->remedy));
}

/* Say what is wrong with a start: which row does not close and by what, which coordinates move no mass, which loop is
 * closed the wrong way round, which load is misplaced, where forces are not balanced, or what numbers are too coarse
 * for. */
void describe_assembly(Instance *own, int64_t code, char text[SAYS])
{
    const Header *h = own->header;
    const Failure *f = (const Failure *)section(own, h->failures) + code;
    const Worst *worst = (const Worst *)(own->block + h->worst_at);
    const double *massless = (const double *)(own->block + h->massless_at);
    const Name *coordinates = section(own, h->coordinates);
    const bool turned = code == ASSEMBLY_TURNED, misplaced = code == ASSEMBLY_MISPLACED;
    const bool unsteady = code == ASSEMBLY_NO_STEADY_STATE || code == ASSEMBLY_NOT_UNIQUE || code == ASSEMBLY_NOT_STEADY
        || code == ASSEMBLY_FAR_STATE;
    const Name *names = section(own, turned ? h->cuts : misplaced ? h->loads : unsteady ? h->coordinates : h->rows);
    const int64_t named = turned ? h->cuts_count : misplaced ? h->loads_count : unsteady ? h->coordinates_count : h->rows_count;
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
    const double parts[] = {most / status->exchanged, status->exchanged};
    const double numbers[] = {status->lost_at, most, most / status->passage, status->passage};
    char part[SAYS] = "";
    if (status->exchanged > most)
        fill(part, EXCHANGED_ENERGY_PART, parts, NULL);
    const char *const texts[] = {status->energy_error > 0.0 ? "more" : "less", part, ""};
    fill(text, status->lost == PASSAGE_INACCURATE ? SLOW_PASSAGE_TEXT : ENERGY_BALANCE_TEXT, numbers, texts);
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

void warn_filled(Instance *own, const char *form, const double numbers[], const char *const texts[])
{
    char text[SAYS];
    fill(text, form, numbers, texts);
    warn(own, text);
}

/* Tell once of each input that its position has jumped, at the point t, s. */
void warn_jump(Instance *own, const RunStatus *status, double t)
{
    if (!status->jumps)
        return;
    const Support *support = (const Support *)section(own, own->header->supports) + status->jump_support;
    const double numbers[] = {t, status->jump_size};
    const char *const texts[] = {text_at(own, own->variables[support->variable].name), text_at(own, support->unit)};
    if (own->flags[support->variable] & JUMP_REPORTED)
        return;
    own->flags[support->variable] |= JUMP_REPORTED;
    warn_filled(own, INPUT_JUMP_TEXT, numbers, texts);
}

/* Tell once that the tolerance was larger than requested near a near miss of a singular configuration. */
void warn_near_miss(Instance *own)
{
    const Header *h = own->header;
    const Options *options = (const Options *)(own->block + h->options_at);
    double factor = *numbers_at(own, h->near_miss_factor_at);
    const double numbers[] = {factor * options->rtol, options->rtol, *numbers_at(own, h->near_miss_gap_at)};
    if (own->warned_near_miss || !(factor > 1.0))
        return;
    own->warned_near_miss = true;
    warn_filled(own, LIMITED_TOLERANCE_TEXT, numbers, NULL);
}

/* Tell once that forces were asked for at a time at which they are not determined. */
void warn_undetermined(Instance *own)
{
    const Header *h = own->header;
    if (own->warned_undetermined || !h->reports_undetermined || !*(const int64_t *)(own->block + h->undetermined_at))
        return;
    own->warned_undetermined = true;
    warn_filled(own, UNDETERMINED_FORCES_TEXT, numbers_at(own, h->undetermined_time_at), NULL);
}

/* Return the next name, from a coordinate on, of a body whose rate the loops do not determine and no one has given. */
static const char *next_free_rate(Instance *own, int64_t *k)
{
    const Name *names = section(own, own->header->free_rates);
    const double *is_free = numbers_at(own, own->header->massless_at);
    const char *before = *k > 0 ? text_at(own, names[*k - 1].name) : "";
    for (; *k < own->header->free_rates_count; ++*k) {
        const char *name = text_at(own, names[*k].name);
        if (is_free[*k] != 0.0 && *name && strcmp(name, before) != 0)
            return text_at(own, names[(*k)++].name);
    }
    return NULL;
}

/* Tell that the loops do not determine all rates at the start, and which have not been given. */
void warn_singular_start(Instance *own)
{
    char joints[SAYS] = "";
    int64_t k = 0, count = 0;
    for (const char *name = next_free_rate(own, &k), *next; name; name = next) {
        next = next_free_rate(own, &k);
        const char *const parts[] = {!count++ ? "" : next ? ", " : " and ", "'", name, "'"};
        add_all(joints, parts, 4);
    }
    const char *const texts[] = {count > 1 ? "s" : "", joints};
    if (count)
        warn_filled(own, SINGULAR_START_TEXT, NULL, texts);
}

/* Return the force along a constraint equation of a wheel, N, in the last evaluation; zero without the equation. */
static double force_at(Instance *own, int64_t at)
{
    return at < 0 ? 0.0 : -*numbers_at(own, at);
}

/* Tell once of a wheel that the plane would have to pull, and once if it would slip; a difference of forces counts if
   it exceeds ``error``, N. */
static void watch_wheel(Instance *own, const Wheel *wheel, uint64_t bit, double error)
{
    const double t = clock_of(own), normal = force_at(own, wheel->normal_at);
    const double along = force_at(own, wheel->longitudinal_at), across = force_at(own, wheel->lateral_at);
    const double first = *numbers_at(own, wheel->longitudinal_friction_at);
    const double second = *numbers_at(own, wheel->lateral_friction_at);
    const char *const texts[] = {text_at(own, wheel->name)};
    if (normal < -error) {
        const double numbers[] = {t, -normal};
        if (!(own->warned_lifting & bit))
            warn_filled(own, LIFTING_WHEEL_TEXT, numbers, texts);
        own->warned_lifting |= bit;
        return;
    }
    if (first == 0.0 || second == 0.0 || own->warned_slipping & bit)
        return;
    double needed = hypot(along / first, across / second), carried = fmax(normal, 0.0), force = hypot(along, across);
    if (!(needed > normal + error))
        return;
    const double numbers[] = {t, force, force * carried / needed, carried};
    warn_filled(own, SLIPPING_WHEEL_TEXT, numbers, texts);
    own->warned_slipping |= bit;
}

/* Tell once of a wheel that its profile penetrates at a second place, and once if it is beyond an end of it. */
static void watch_profile(Instance *own, const Wheel *wheel, uint64_t bit, double tolerance)
{
    const char *const texts[] = {text_at(own, wheel->name)};
    const RunStatus *status = (const RunStatus *)(own->block + own->header->run_status_at);
    const double t = clock_of(own), distance = fabs(*numbers_at(own, wheel->distance_at));
    const double lower = *numbers_at(own, wheel->lower_at), upper = *numbers_at(own, wheel->upper_at);
    call_entry_at(own, own->family->locate_contact, (double)wheel->profile_cut);
    const double x = status->contact, depth = status->depth;
    const double radius = *numbers_at(own, wheel->radius_at) + *numbers_at(own, wheel->crown_at);
    const double error = tolerance * radius + PLACE_ROUNDING * fabs(x);
    if (depth > distance + error && !(own->warned_second & bit)) {
        const double numbers[] = {t, x, status->second_contact, depth};
        warn_filled(own, SECOND_CONTACT_TEXT, numbers, texts);
        own->warned_second |= bit;
    }
    if (!(lower - error <= x && x <= upper + error) && !(own->warned_end & bit)) {
        const double numbers[] = {x, t, lower, upper};
        warn_filled(own, PROFILE_END_TEXT, numbers, texts);
        own->warned_end |= bit;
    }
}

/* Compare the forces of rolling wheels at the time reached, as mbfmu/session/wheel_monitor.py does. */
void watch_wheels(Instance *own)
{
    const Header *h = own->header;
    const Wheel *wheels = section(own, h->wheels);
    const Options *options = (const Options *)(own->block + h->options_at);
    double largest = 0.0;
    if (!h->wheels_count || (!own->fresh && evaluate(own) != OK))
        return;
    for (int64_t k = 0; k < h->wheels_count; k++)
        largest = fmax(largest, fabs(force_at(own, wheels[k].normal_at)));
    for (int64_t k = 0; k < h->wheels_count; k++)
        watch_wheel(own, wheels + k, UINT64_C(1) << (k < 63 ? k : 63), options->rtol * largest);
    for (int64_t k = 0; k < h->wheels_count; k++)
        if (wheels[k].profile_cut != -1)
            watch_profile(own, wheels + k, UINT64_C(1) << (k < 63 ? k : 63), options->rtol);
}
