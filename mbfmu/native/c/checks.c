/* Whether a file is what was exported: its checksums, and every index of its tables within bounds. */

#include <string.h>

#include "instance.h"

#define POLYNOMIAL UINT64_C(0xC96C5795D7870F42) /* CRC-64 of ECMA-182, reflected, as in the format xz */
#define SLICES 8

/* Continue the CRC-64 of bytes, eight at a time; the first of several parts has the sum 0. */
uint64_t crc64(uint64_t sum, const void *bytes, size_t count)
{
    uint64_t table[SLICES][256];
    const unsigned char *at = bytes;
    for (unsigned k = 0; k < 256; k++) {
        uint64_t crc = k;
        for (int bit = 0; bit < 8; bit++)
            crc = crc & 1 ? crc >> 1 ^ POLYNOMIAL : crc >> 1;
        table[0][k] = crc;
    }
    for (unsigned i = 1; i < SLICES; i++)
        for (unsigned k = 0; k < 256; k++)
            table[i][k] = table[i - 1][k] >> 8 ^ table[0][table[i - 1][k] & 255];
    sum = ~sum;
    for (; count >= SLICES; count -= SLICES, at += SLICES) {
        uint64_t word, next = 0;
        memcpy(&word, at, sizeof word);
        word ^= sum;
        for (unsigned i = 0; i < SLICES; i++)
            next ^= table[SLICES - 1 - i][word >> 8 * i & 255];
        sum = next;
    }
    for (; count; count--)
        sum = table[0][(sum ^ *at++) & 255] ^ sum >> 8;
    return ~sum;
}

/* Whether so many items of a size, from a place on, end before a limit. */
static bool fits(int64_t limit, int64_t at, int64_t count, size_t size)
{
    return at >= 0 && at <= limit && count >= 0 && (uint64_t)count <= (uint64_t)(limit - at) / size;
}

/* Whether items in whole words are within the block. */
static bool in_block(const Header *h, int64_t at, int64_t count, size_t size)
{
    return at % 8 == 0 && fits(h->size, at, count, size);
}

/* Whether a section is after the header and before the block. */
static bool in_tables(const Header *h, int64_t at, int64_t count, size_t size)
{
    return at % 8 == 0 && at >= (int64_t)sizeof(Header) && fits(h->block, at, count, size);
}

static bool is_index(int64_t index, int64_t count)
{
    return index >= 0 && index < count;
}

/* Whether the lengths of a header are those of a file. */
bool has_length(const Header *h, int64_t length)
{
    return h->block >= (int64_t)sizeof(Header) && h->block % 8 == 0 && h->size > 0 && h->block <= length &&
           h->size <= length - h->block && is_index(h->libraries_count, INT32_MAX) &&
           h->libraries_count * (int64_t)sizeof(Library) == length - h->block - h->size;
}

static bool good_states(const Header *h)
{
    const size_t one = sizeof(double);
    return fits(h->saved, 0, h->saved_alone, 1) && is_index(h->positions, h->size) && is_index(h->velocities, h->size) &&
           in_block(h, h->exchange_x_at, h->positions + h->velocities, one) &&
           in_block(h, h->exchange_derivatives_at, h->positions + h->velocities, one) &&
           in_block(h, h->exchange_nominal_at, h->positions + h->velocities, one) &&
           in_block(h, h->exchange_times_at, EXCHANGE_TIMES, one) && is_index(h->derivatives, h->exchange + 1) &&
           (!h->derivatives || (in_block(h, h->direction_states_at, h->positions + h->velocities, one) &&
                                in_block(h, h->derivative_slopes_at, h->positions + h->velocities, one))) && h->saved >= (h->positions + h->velocities) * (int64_t)one;
}

/* Whether the table of addresses for SUNDIALS is after what states hold, where the family calls it. */
static bool good_table(const Header *h)
{
    bool is_called = family.callbacks;
    return is_called ? h->ida_at >= h->saved && in_block(h, h->ida_at, WORD_COUNT, sizeof(int64_t)) : h->ida_at == 0;
}

/* Whether the library has all entry points that are called. */
static bool good_entry_points(const Header *h)
{
    return (!h->steady || family.balance) && is_index(h->has_events, 2) && (!h->has_events || family.events_step) && (!(h->exchange || h->derivatives) || family.exchange_evaluate);
}

static bool good_header(const Header *h)
{
    return h->family == FAMILY && fits(h->size, 0, h->saved, 1) &&
           in_block(h, h->root, 1, sizeof(double)) && in_block(h, h->clock_at, 1, sizeof(double)) &&
           in_block(h, h->length_at, 1, sizeof(double)) && in_block(h, h->options_at, 1, sizeof(Options)) &&
           in_block(h, h->run_status_at, 1, sizeof(RunStatus)) && in_block(h, h->worst_at, 1, sizeof(Worst)) &&
           in_block(h, h->massless_at, h->coordinates_count, sizeof(double)) && in_block(h, h->out_at, 0, 1) &&
           in_block(h, h->counts_at, 0, 1) && is_index(h->reports_coarse, 2) && is_index(h->steady, 2) && is_index(h->takes_rates, 2) &&
           is_index(h->user_kernels, INT32_MAX) && is_index(h->reports_undetermined, 2) &&
           in_block(h, h->undetermined_at, 1, sizeof(int64_t)) &&
           in_block(h, h->undetermined_time_at, 1, sizeof(double)) &&
           in_block(h, h->near_miss_factor_at, 1, sizeof(double)) &&
           in_block(h, h->near_miss_gap_at, 1, sizeof(double)) && in_block(h, h->events_at, 1, sizeof(EventControl)) &&
           in_block(h, h->event_values_at, h->event_parameters_count, sizeof(double)) &&
           is_index(h->indicators, h->size) && in_block(h, h->indicators_at, h->indicators, sizeof(double)) &&
           h->free_rates_count <= h->coordinates_count && is_index(h->exchange, 2) && good_states(h) &&
           good_table(h) && good_entry_points(h);
}

#define SECTION(name, kind) in_tables(h, h->name, h->name##_count, sizeof(kind))

static bool good_sections(const Header *h)
{
    return SECTION(variables, Variable) && SECTION(arrays, Array) && SECTION(members, Member) &&
           SECTION(entries, Entry) && SECTION(sums, Sum) && SECTION(terms, Term) && SECTION(factors, Factor) &&
           SECTION(relocations, Relocation) && SECTION(kernels, Relocation) && SECTION(sentences, Sentence) &&
           SECTION(failures, Failure) && SECTION(rows, Name) && SECTION(coordinates, Name) && SECTION(cuts, Name) && SECTION(loads, Name) &&
           SECTION(free_rates, Name) && SECTION(supports, Support) && SECTION(events, Name) && SECTION(event_parameters, Member) &&
           SECTION(wheels, Wheel) &&
           SECTION(text, char) && h->sentences_count >= CODE_COUNT && h->failures_count >= ASSEMBLY_COUNT;
}

/* Whether there is a text at a place; all texts end before the last byte of theirs, which is zero. */
static bool good_text(const Header *h, int64_t at)
{
    return is_index(at, h->text_count);
}

static bool good_variables(const Instance *own)
{
    const Header *h = own->header;
    int64_t inputs = 0;
    for (int64_t k = 0; k < h->variables_count; k++) {
        const Variable *v = &own->variables[k];
        if (!good_text(h, v->name) || !good_text(h, v->allowed) || !is_index(v->type, TYPE_COUNT) ||
            !is_index(v->role, ROLE_COUNT) || !is_index(v->settable, SETTABLE_COUNT) ||
            !is_index(v->number, h->variables_count))
            return false;
        if ((v->role == ROLE_INPUT && v->number != inputs++) ||
            (v->role == ROLE_SETTING && v->number >= SETTING_COUNT) ||
            (v->role == ROLE_OUTPUT && !in_block(h, h->out_at, v->number + 1, sizeof(double))) ||
            (h->derivatives && v->role == ROLE_OUTPUT && !in_block(h, h->derivative_outputs_at, v->number + 1, sizeof(double))) ||
            (h->derivatives && v->role == ROLE_INPUT && !in_block(h, h->direction_inputs_at, v->number + 1, sizeof(double))) ||
            (v->role == ROLE_COUNTER && !in_block(h, h->counts_at, v->number + 1, sizeof(int64_t))))
            return false;
    }
    return h->inputs == inputs;
}

static bool good_arrays(const Instance *own)
{
    const Header *h = own->header;
    const Array *arrays = section(own, h->arrays);
    const Member *members = section(own, h->members);
    for (int64_t k = 0; k < h->arrays_count; k++)
        if (!fits(h->members_count, arrays[k].members, arrays[k].count, 1))
            return false;
    for (int64_t k = 0; k < h->members_count; k++)
        if (!is_index(members[k].variable, h->variables_count))
            return false;
    return true;
}

static bool good_entries(const Instance *own)
{
    const Header *h = own->header;
    const Entry *entries = section(own, h->entries);
    for (int64_t k = 0; k < h->entries_count; k++) {
        const Entry *e = &entries[k];
        bool free = e->input == -1;
        if (!in_block(h, e->at, 1, sizeof(double)) || e->root == 0 || e->count < 1 ||
            !fits(h->sums_count, e->sums, e->count, 1) || (!free && !is_index(e->input, h->variables_count)) ||
            (!free && own->variables[e->input].role != ROLE_INPUT))
            return false;
    }
    return true;
}

static bool good_formulas(const Instance *own)
{
    const Header *h = own->header;
    const Sum *sums = section(own, h->sums);
    const Term *terms = section(own, h->terms);
    const Factor *factors = section(own, h->factors);
    for (int64_t k = 0; k < h->sums_count; k++)
        if (!fits(h->terms_count, sums[k].terms, sums[k].count, 1))
            return false;
    for (int64_t k = 0; k < h->terms_count; k++)
        if (!fits(h->factors_count, terms[k].factors, terms[k].count, 1))
            return false;
    for (int64_t k = 0; k < h->factors_count; k++)
        if (factors[k].variable != LENGTH && !is_index(factors[k].variable, h->variables_count))
            return false;
    return true;
}

/* Return the table of a kernel that ships, and its number there; NULL: it is user-defined, and has the number left. */
const KernelTable *table_of(int64_t *number)
{
    for (size_t k = 0; k < sizeof kernel_tables / sizeof *kernel_tables; k++) {
        if (*number < kernel_tables[k].count)
            return &kernel_tables[k];
        *number -= kernel_tables[k].count;
    }
    return NULL;
}

/* Whether the library has a kernel. */
static bool is_kernel(int64_t number, int64_t user_kernels)
{
    if (number < 0)
        return false;
    const KernelTable *table = table_of(&number);
    return table ? table->addresses != NULL : number < user_kernels;
}

/* Addresses are after what states hold, so that no state changes one. */
static bool good_addresses(const Instance *own)
{
    const Header *h = own->header;
    const Relocation *relocations = section(own, h->relocations), *kernels = section(own, h->kernels);
    for (int64_t k = 0; k < h->relocations_count; k++)
        if (relocations[k].at < h->saved || !in_block(h, relocations[k].at, 1, sizeof(void *)) ||
            !in_block(h, relocations[k].target, 0, 1))
            return false;
    for (int64_t k = 0; k < h->kernels_count; k++)
        if (kernels[k].at < h->saved || !in_block(h, kernels[k].at, 1, sizeof(void *)) ||
            !is_kernel(kernels[k].target, h->user_kernels))
            return false;
    return true;
}

static bool good_names(const Instance *own, int64_t at, int64_t count)
{
    const Name *names = section(own, at);
    for (int64_t k = 0; k < count; k++)
        if (!good_text(own->header, names[k].name))
            return false;
    return true;
}

static bool good_supports(const Instance *own)
{
    const Support *supports = section(own, own->header->supports);
    for (int64_t k = 0; k < own->header->supports_count; k++)
        if (!is_index(supports[k].variable, own->header->variables_count) || !good_text(own->header, supports[k].unit))
            return false;
    return true;
}

static bool good_event_parameters(const Instance *own)
{
    const Member *set = section(own, own->header->event_parameters);
    for (int64_t k = 0; k < own->header->event_parameters_count; k++)
        if (!is_index(set[k].variable, own->header->variables_count))
            return false;
    return true;
}

static bool good_wheels(const Instance *own)
{
    const Header *h = own->header;
    const Wheel *wheels = section(own, h->wheels);
    const size_t one = sizeof(double);
    for (int64_t k = 0; k < h->wheels_count; k++) {
        const Wheel *w = wheels + k;
        if (!good_text(h, w->name) || !in_block(h, w->normal_at, 1, one) ||
            !(w->longitudinal_at == -1 || in_block(h, w->longitudinal_at, 1, one)) ||
            !(w->lateral_at == -1 || in_block(h, w->lateral_at, 1, one)) ||
            !in_block(h, w->longitudinal_friction_at, 1, one) || !in_block(h, w->lateral_friction_at, 1, one))
            return false;
        if (w->profile_cut != -1 &&
            (!family.locate_contact || !is_index(w->profile_cut, h->size) || !in_block(h, w->distance_at, 1, one) ||
             !in_block(h, w->radius_at, 1, one) || !in_block(h, w->crown_at, 1, one) ||
             !in_block(h, w->lower_at, 1, one) || !in_block(h, w->upper_at, 1, one)))
            return false;
    }
    return true;
}

static bool good_texts(const Instance *own)
{
    const Header *h = own->header;
    const Sentence *sentences = section(own, h->sentences);
    const Failure *failures = section(own, h->failures);
    if (h->text_count && *text_at(own, h->text_count - 1))
        return false;
    for (int64_t k = 0; k < h->sentences_count; k++)
        if (!good_text(h, sentences[k].what) || !good_text(h, sentences[k].remedy))
            return false;
    for (int64_t k = 0; k < h->failures_count; k++)
        if (!good_text(h, failures[k].before) || !good_text(h, failures[k].between) ||
            !good_text(h, failures[k].after))
            return false;
    return good_names(own, h->rows, h->rows_count) && good_names(own, h->coordinates, h->coordinates_count) &&
           good_names(own, h->cuts, h->cuts_count) && good_names(own, h->loads, h->loads_count) &&
           good_names(own, h->free_rates, h->free_rates_count) && good_names(own, h->events, h->events_count) && good_supports(own) && good_wheels(own);
}

/* Whether all that the tables refer to is there; the sections are checked before anything in them is read. */
bool within_bounds(Instance *own)
{
    const Header *h = own->header;
    if (!good_header(h) || !good_sections(h))
        return false;
    own->variables = section(own, h->variables);
    return good_texts(own) && good_variables(own) && good_arrays(own) && good_event_parameters(own) && good_entries(own) && good_formulas(own) &&
           good_addresses(own);
}
