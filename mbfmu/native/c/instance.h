/* What an instance is made of; for the files that are its inside. */

#ifndef MBFMU_INSTANCE_H
#define MBFMU_INSTANCE_H

#include "core.h"

/* Flags of a variable: set since the last step; set to what is not allowed; its jump has been reported; its rate has been
 * set for the next step. */
enum { GIVEN = 1, REFUSED = 2, JUMP_REPORTED = 4, RATED = 8 };

struct Instance {
    Log *log;
    void *host;
    char *path;   /* of the file of the model */
    char *tables; /* that file up to the block */
    const Header *header;
    Library *libraries; /* that the FMU may load */
    const Variable *variables;
    const Family *family;
    unsigned char *room;  /* what the block lies in */
    unsigned char *block; /* the model at work */
    unsigned char *kept;  /* its state as the step found it */
    double *values;
    double *rates; /* derivatives of the inputs by time, of those that are RATED */
    unsigned char *flags; /* of the variables, and zeros up to a multiple of 8 */
    double start;   /* s */
    double reached; /* s */
    Phase phase;
    bool exchange;  /* for model exchange, not for co-simulation */
    bool stopped;   /* the last step failed */
    bool ended;     /* an event has ended the run in the last step */
    bool untouched; /* the block is that of the file */
    bool fresh;     /* outputs are those of the present state */
    bool derived;   /* so are derivatives */
    bool advanced;  /* no entry point was called since a step, which leaves the equations evaluated at its end */
    bool linearized; /* so is the point of directional derivatives: no entry point was called since */
    bool warned_balance, warned_coarse, warned_near_miss, warned_undetermined, warned_branch;
    uint64_t warned_lifting, warned_slipping, warned_second, warned_end; /* bits of the wheels */
    unsigned reported; /* reasons of discarded evaluations, bits by their codes */
    struct Sundials *sundials; /* NULL: it is not used */
    void *user_library; /* of user-defined kernels; NULL: there are none */
    bool is_table_filled;      /* the table of addresses in the block is that of this process */
    char message[SAYS];
};

static inline size_t count_of(const Instance *own)
{
    return (size_t)own->header->variables_count;
}

/* Return how many words of 8 bytes the flags of all variables take. */
static inline size_t flag_words(const Instance *own)
{
    return (count_of(own) + sizeof(uint64_t) - 1) / sizeof(uint64_t);
}

/* file.c */
bool open_model(Instance *own, const char *folder, const char *token, char text[SAYS]);
bool load_block(Instance *own);
const void *section(const Instance *own, int64_t at);
const char *text_at(const Instance *own, int64_t at);
unsigned char *root_of(Instance *own);
size_t saved_bytes(const Instance *own);

/* checks.c */
uint64_t crc64(uint64_t sum, const void *bytes, size_t count);
bool has_length(const Header *h, int64_t length);
bool within_bounds(Instance *own);
const KernelTable *table_of(int64_t *number);

/* formulas.c */
bool put_parameters(Instance *own, bool at_work);
void put_options(Instance *own);

/* starting.c */
int64_t call_entry(Instance *own, int32_t (*entry)(int64_t *, void **, void *));
int64_t call_entry_at(Instance *own, int32_t (*entry)(int64_t *, void **, void *, double), double t);
int64_t call_events(Instance *own, int32_t (*entry)(int64_t *, void **, void *, double), double t);
double *numbers_at(Instance *own, int64_t at);
double clock_of(Instance *own);
void give(Instance *own, int32_t (*entry)(int64_t *, void **, void *, int64_t, double), size_t k);
Outcome evaluate(Instance *own);
Outcome start_anew(Instance *own);
void put_back(Instance *own, const unsigned char *saved);

/* values.c */
bool is_marked(const Instance *own, unsigned flag);
void unmark(Instance *own, unsigned flag);
const Variable *refused_value(const Instance *own);
Outcome fail_refused(Instance *own, Outcome outcome, const Variable *v);
void apply_changes(Instance *own);
double present_value(const Instance *own, size_t k);

/* exchange.c */
void apply_exchange_changes(Instance *own);
int64_t start_exchange(Instance *own);
bool is_exchanged(Instance *own, uint32_t reference);
int64_t exchanged_index(Instance *own, uint32_t reference, bool *is_derivative);
Outcome derive(Instance *own);
Outcome discard(Instance *own, int64_t code);
Outcome get_exchanged(Instance *own, uint32_t reference, unsigned wanted, double *value);
Outcome set_exchanged(Instance *own, uint32_t reference, unsigned wanted, double value);
int64_t read_exchanged(Instance *own);

/* messages.c */
const char *in_digits(char digits[32], double value);
void add(char text[SAYS], const char *more);
void add_all(char text[SAYS], const char *const parts[], size_t count);
Outcome fail(Instance *own, Outcome outcome, const char *text);
void describe_stop(Instance *own, int64_t code, char text[SAYS]);
void describe_end(Instance *own, char text[SAYS]);
void describe_assembly(Instance *own, int64_t code, char text[SAYS]);
void describe_energy_error(const Instance *own, char text[SAYS]);
void describe_bend(Instance *own, const char *before, const char *after, char text[SAYS]);
void warn(Instance *own, const char *text);
void warn_filled(Instance *own, const char *form, const double numbers[], const char *const texts[]);
void warn_jump(Instance *own, const RunStatus *status, double t);
void warn_near_miss(Instance *own);
void warn_undetermined(Instance *own);
void watch_wheels(Instance *own);
void warn_singular_start(Instance *own);
void warn_coarse(Instance *own, const RunStatus *status);

/* Make a text of parts. */
#define SAY(text, ...)                                                             \
    do {                                                                           \
        const char *const parts[] = {__VA_ARGS__};                                 \
        (text)[0] = '\0';                                                          \
        add_all(text, parts, sizeof parts / sizeof parts[0]);                      \
    } while (0)

#endif
