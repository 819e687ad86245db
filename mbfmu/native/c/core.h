/* One instance of a model, as both versions of FMI serve it.

   Values live in one array by value reference, in doubles, whole numbers and truth values too. What a host sets is
   noted and reaches the block of the model with the next step, or when outputs are asked for. */

#ifndef MBFMU_CORE_H
#define MBFMU_CORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#include "layout.h"

#define SAYS 1024 /* bytes of a message */

typedef enum { OK, WARNING, DISCARD, ERROR, FATAL } Outcome; /* the numbers of both versions of FMI */

/* RUNNING is of co-simulation, the two modes are of model exchange */
typedef enum { INSTANTIATED, INITIALIZING, RUNNING, EVENT_MODE, CONTINUOUS_MODE, FAILED, TERMINATED } Phase;

/* Give a message to the host. */
typedef void Log(void *host, Outcome outcome, const char *category, const char *text);

typedef struct Instance Instance;
typedef struct State State;

/* Life. Without an instance the text says why. */
Instance *create(const char *token, const char *folder, bool exchange, Log *log, void *host, char text[SAYS]);
void destroy(Instance *own);
void *host_of(Instance *own);
Outcome set_up(Instance *own, double start, bool ends, double stop, bool tolerant, double tolerance);
Outcome enter_initialization(Instance *own);
Outcome exit_initialization(Instance *own);
Outcome step(Instance *own, double t, double length, double *reached);
bool stopped(const Instance *own);
bool has_ended(const Instance *own);
Outcome terminate(Instance *own);
Outcome reset(Instance *own);
Outcome refuse(Instance *own, const char *call);
Outcome not_offered(Instance *own, const char *call);
Outcome mistake(Instance *own, const char *text);

/* Messages. */
enum { LOG_WARNINGS = 1, LOG_ERRORS = 2, LOG_DISCARDS = 4, LOG_ALL = 7 }; /* categories, bits of what a host has asked for */
bool is_logged(unsigned logged, const char *category);
Outcome choose_logging(Instance *own, unsigned *logged, bool on, size_t count, const char *const names[]);

/* Values of variables by value reference; types are a set of 1 << TYPE_... */
Outcome get(Instance *own, uint32_t reference, unsigned types, double *value);
Outcome set(Instance *own, uint32_t reference, unsigned types, double value);
Outcome get_text(Instance *own, uint32_t reference, const char **text);
Outcome set_rates(Instance *own, const char *call, const uint32_t inputs[], size_t n, const int32_t orders[],
                  const double rates[]);
double last_successful_time(const Instance *own);

/* Value references of FMI 3: of variables, then of the time, then of arrays. */
uint32_t time_reference(const Instance *own);
size_t width(const Instance *own, uint32_t reference);
uint32_t element(const Instance *own, uint32_t reference, size_t k);

/* Model exchange; ``call`` is the name of the function that the host has called. */
typedef struct {
    bool states_changed, nominals_changed, has_next, ends;
    double next; /* s, time of the next event */
} Events;
size_t state_count(const Instance *own);
Outcome set_time(Instance *own, const char *call, bool in_events, double t);
Outcome set_states(Instance *own, const char *call, const double *x, size_t n);
Outcome get_states(Instance *own, const char *call, double *x, size_t n);
Outcome get_derivatives(Instance *own, const char *call, double *dx, size_t n);
Outcome get_nominals(Instance *own, const char *call, double *nominal, size_t n);
Outcome get_indicators(Instance *own, const char *call, double *z, size_t n);
Outcome enter_event_mode(Instance *own, const char *call);
Outcome update_events(Instance *own, const char *call, Events *events);
Outcome enter_continuous_mode(Instance *own, const char *call);
Outcome complete_step(Instance *own, const char *call, bool *event, bool *ends);
Outcome count_exchanged(Instance *own, const char *call, bool indicators, size_t *n);

/* Directional derivatives: value references of the unknowns and of the known variables. */
typedef struct {
    const uint32_t *references[2];
    size_t count[2];
    bool has_arrays; /* whether a value reference may stand for several numbers: in FMI 3 */
    bool fits;       /* whether all arrays are there, and as long as they must be */
} Derivatives;
Outcome directional_derivative(Instance *own, const char *call, const Derivatives *d, const double *seed, double *found);
Outcome adjoint_derivative(Instance *own, const char *call, const Derivatives *d, const double *seed, double *found);
Outcome output_derivatives(Instance *own, const char *call, const uint32_t outputs[], size_t n, const int32_t orders[],
                           double *found);

/* States of the FMU. */
Outcome save(Instance *own, State **state);
Outcome restore(Instance *own, const State *state);
size_t bytes_of(const Instance *own);
Outcome write_state(Instance *own, const State *state, void *bytes, size_t count);
Outcome read_state(Instance *own, const void *bytes, size_t count, State **state);

#endif
