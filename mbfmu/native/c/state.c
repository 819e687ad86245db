/* States of an instance: what is set, and the first part of the block, which has no addresses. */

#include <stdlib.h>
#include <string.h>

#include "instance.h"

struct State {
    int64_t magic;
    uint64_t bytes; /* of all of it */
    uint64_t checked; /* checksum of what comes after it, where it is written for others */
    char token[sizeof((Header *)0)->token];
    int64_t exchange;
    int64_t phase;
    double start;
    double reached;
    char message[SAYS];
    double values[]; /* then the rates of inputs, the block's state, and the flags */
};

#define BEFORE offsetof(State, token)

static size_t inputs_of(const Instance *own)
{
    return (size_t)own->header->inputs;
}

size_t bytes_of(const Instance *own)
{
    return sizeof(State) + (count_of(own) + inputs_of(own)) * sizeof(double) + saved_bytes(own) + count_of(own);
}

/* FNV-1a. */
static uint64_t checksum(const void *bytes, size_t count)
{
    const unsigned char *at = bytes;
    uint64_t sum = UINT64_C(14695981039346656037);
    for (size_t k = 0; k < count; k++)
        sum = (sum ^ at[k]) * UINT64_C(1099511628211);
    return sum;
}

static unsigned char *block_of(const Instance *own, const State *state)
{
    return (unsigned char *)(state->values + count_of(own) + inputs_of(own));
}

static bool ours(const Instance *own, const State *state)
{
    return state && state->magic == MAGIC && state->bytes == bytes_of(own) && state->exchange == own->exchange &&
           strncmp(state->token, own->header->token, sizeof state->token) == 0;
}

static Outcome refuse_state(Instance *own)
{
    return mistake(own, "the given FMU state is damaged or not one of this FMU; allowed: a state that it saved, for the same type of FMU "
                        "(co-simulation or model exchange) [saved-state]");
}

/* Take a state; one that is given is used again. */
Outcome save(Instance *own, State **state)
{
    if (*state && !ours(own, *state))
        return refuse_state(own);
    if (!*state && !(*state = malloc(bytes_of(own))))
        return mistake(own, "the memory for an FMU state cannot be allocated [out-of-memory]");
    State *s = *state;
    size_t count = count_of(own), saved = saved_bytes(own);
    s->magic = MAGIC;
    s->bytes = bytes_of(own);
    s->checked = 0;
    memcpy(s->token, own->header->token, sizeof s->token);
    s->exchange = own->exchange;
    s->phase = own->phase;
    s->start = own->start;
    s->reached = own->reached;
    memset(s->message, 0, sizeof s->message);
    add(s->message, own->message);
    memcpy(s->values, own->values, count * sizeof *s->values);
    memcpy(s->values + count, own->rates, inputs_of(own) * sizeof *s->values);
    memcpy(block_of(own, s), own->block, saved);
    memcpy(block_of(own, s) + saved, own->flags, count);
    return OK;
}

Outcome restore(Instance *own, const State *state)
{
    if (!ours(own, state))
        return refuse_state(own);
    size_t count = count_of(own), saved = saved_bytes(own);
    own->phase = (Phase)state->phase;
    own->start = state->start;
    own->reached = state->reached;
    own->stopped = own->ended = false;
    memcpy(own->message, state->message, sizeof own->message);
    memcpy(own->values, state->values, count * sizeof *state->values);
    memcpy(own->rates, state->values + count, inputs_of(own) * sizeof *state->values);
    put_back(own, block_of(own, state));
    memcpy(own->flags, block_of(own, state) + saved, count);
    own->untouched = own->fresh = own->derived = false;
    return OK;
}

Outcome write_state(Instance *own, const State *state, void *bytes, size_t count)
{
    if (!ours(own, state))
        return refuse_state(own);
    if (!bytes || count < state->bytes)
        return mistake(own, "the array for an FMU state is too small; allowed: the size that fmi2SerializedFMUstateSize or fmi3SerializedFMUStateSize returns");
    memcpy(bytes, state, (size_t)state->bytes);
    uint64_t sum = checksum((const char *)bytes + BEFORE, (size_t)state->bytes - BEFORE);
    memcpy((char *)bytes + offsetof(State, checked), &sum, sizeof sum);
    return OK;
}

Outcome read_state(Instance *own, const void *bytes, size_t count, State **state)
{
    uint64_t sum;
    State *read = bytes && count == bytes_of(own) ? malloc(count) : NULL;
    if (!read)
        return refuse_state(own);
    memcpy(read, bytes, count);
    memcpy(&sum, &read->checked, sizeof sum);
    if (!ours(own, read) || sum != checksum((const char *)bytes + BEFORE, count - BEFORE) ||
        read->phase < INSTANTIATED || read->phase > TERMINATED || read->message[SAYS - 1]) {
        free(read);
        return refuse_state(own);
    }
    read->checked = 0;
    *state = read;
    return OK;
}
