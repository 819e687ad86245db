/* Loading of SUNDIALS, its context, and what it calls back. */

#include "sundials.h"

#include <stdlib.h>
#include <string.h>

#include "folder.h"

struct Sundials {
    void *libraries[LIBRARY_COUNT];
    void *context;
    double *(*vector)(void *);
    double *(*matrix)(void *);
    int (*free_context)(void **);
    char report[SAYS]; /* last message of SUNDIALS in this step */
};

typedef void ErrorHandler(int, const char *, const char *, const char *, int, void *, void *);

/* ---- callbacks --------------------------------------------------------------------------------------------------- */

#define AT(place) own->sundials->vector(place)
#define RETURN(name, ...)                                                          \
    int64_t code;                                                                  \
    void *error;                                                                   \
    own->family->callbacks->name(&code, &error, root_of(own), __VA_ARGS__);        \
    return (int)code

static int residual(double t, void *y, void *slopes, void *out, void *data)
{
    Instance *own = data;
    RETURN(residual, t, AT(y), AT(slopes), AT(out));
}

static int set_up_preconditioner(double t, void *y, void *slopes, void *, double c, void *data)
{
    Instance *own = data;
    RETURN(set_up_preconditioner, t, AT(y), AT(slopes), c);
}

static int apply_preconditioner(double t, void *y, void *slopes, void *, void *right, void *left, double c, double,
                                void *data)
{
    Instance *own = data;
    RETURN(apply_preconditioner, t, AT(y), AT(slopes), AT(right), AT(left), c);
}

static int matvec(double, void *, void *, void *, void *x, void *product, double, void *data, void *, void *)
{
    Instance *own = data;
    RETURN(matvec, AT(x), AT(product));
}

static int jacobian(double t, double c, void *y, void *slopes, void *, void *matrix, void *data, void *, void *, void *)
{
    Instance *own = data;
    RETURN(jacobian, t, c, AT(y), AT(slopes), own->sundials->matrix(matrix));
}

static int error_weights(void *y, void *out, void *data)
{
    Instance *own = data;
    RETURN(error_weights, AT(y), AT(out));
}

static void keep_report(int, const char *function, const char *, const char *message, int, void *data, void *)
{
    Instance *own = data;
    SAY(own->sundials->report, function ? function : "SUNDIALS", " reports: ", message ? message : "an error");
}

/* ---- libraries --------------------------------------------------------------------------------------------------- */

static void *find(const Sundials *s, const char *name)
{
    for (size_t k = 0; k < LIBRARY_COUNT; k++) {
        void *found = s->libraries[k] ? function_of(s->libraries[k], name) : NULL;
        if (found)
            return found;
    }
    return NULL;
}

static void put_word(Instance *own, size_t word, const void *address)
{
    memcpy(own->block + own->header->ida_at + sizeof(int64_t) * word, &address, sizeof address);
}

/* Put the addresses of this process into the table of the block, which was just read. */
void fill_table(Instance *own)
{
    const Sundials *s = own->sundials;
    const struct {
        size_t word;
        void (*address)(void);
    } callbacks[] = {
#define CALLBACK(name, word) {word, (void (*)(void))name}
        CALLBACK(residual, WORD_RESIDUAL), CALLBACK(set_up_preconditioner, WORD_SET_UP_PRECONDITIONER),
        CALLBACK(apply_preconditioner, WORD_APPLY_PRECONDITIONER), CALLBACK(matvec, WORD_MATVEC),
        CALLBACK(jacobian, WORD_JACOBIAN), CALLBACK(error_weights, WORD_ERROR_WEIGHTS),
    };
    for (size_t k = 0; k < FUNCTION_COUNT; k++)
        put_word(own, k, find(s, function_names[k]));
    for (size_t k = 0; k < sizeof callbacks / sizeof callbacks[0]; k++)
        put_word(own, callbacks[k].word, (const void *)callbacks[k].address);
    put_word(own, WORD_USER_DATA, own);
    put_word(own, WORD_CONTEXT, s->context);
    memset(own->block + own->header->ida_at + sizeof(int64_t) * WORD_MEMORY, 0,
           sizeof(int64_t) * (WORD_COUNT - WORD_MEMORY));
    own->is_table_filled = true;
}

static bool load_libraries(const Instance *own, char text[SAYS])
{
    Sundials *s = own->sundials;
    for (size_t k = 0; k < LIBRARY_COUNT; k++) {
        char why[SAYS];
        s->libraries[k] = load_beside(own, library_names[k], why);
        if (!s->libraries[k]) {
            SAY(text, "library '", library_names[k], "' of SUNDIALS, which must be in the folder of the FMU's own library, cannot "
                "be loaded: ", why, "; unzip the FMU again, or export it for this machine [fmu-files]");
            return false;
        }
    }
    for (size_t k = 0; k < FUNCTION_COUNT; k++)
        if (!find(s, function_names[k])) {
            SAY(text, "the libraries of SUNDIALS in the FMU have no function '", function_names[k], "'; unzip the FMU again [fmu-files]");
            return false;
        }
    return true;
}

/* Create a context without a log of its own, which reports its errors to this instance. */
static bool create_context(Instance *own, Sundials *s, char text[SAYS])
{
    int (*create)(int, void **), (*set_logger)(void *, void *), (*clear)(void *), (*push)(void *, ErrorHandler *, void *);
    create = (int (*)(int, void **))find(s, "SUNContext_Create");
    set_logger = (int (*)(void *, void *))find(s, "SUNContext_SetLogger");
    clear = (int (*)(void *))find(s, "SUNContext_ClearErrHandlers");
    push = (int (*)(void *, ErrorHandler *, void *))find(s, "SUNContext_PushErrHandler");
    s->free_context = (int (*)(void **))find(s, "SUNContext_Free");
    s->vector = (double *(*)(void *))find(s, "N_VGetArrayPointer");
    s->matrix = (double *(*)(void *))find(s, "SUNDenseMatrix_Data");
    if (create && set_logger && clear && push && s->free_context && s->vector && s->matrix && !create(0, &s->context) &&
        !set_logger(s->context, NULL) && !clear(s->context) && !push(s->context, keep_report, own))
        return true;
    SAY(text, "SUNDIALS cannot be started, although its libraries were loaded; unzip the FMU again, or free memory [fmu-files]");
    return false;
}

/* Load SUNDIALS; without it the text says why. */
bool open_sundials(Instance *own, char text[SAYS])
{
    Sundials *s = own->sundials = calloc(1, sizeof *s);
    if (!s) {
        SAY(text, "the memory for the instance cannot be allocated [out-of-memory]");
        return false;
    }
    return load_libraries(own, text) && create_context(own, s, text);
}

/* Free what IDA has allocated for the block. */
void free_objects(Instance *own)
{
    if (own->sundials && own->is_table_filled)
        call_entry(own, own->family->close);
    own->is_table_filled = false;
}

void close_sundials(Instance *own)
{
    Sundials *s = own->sundials;
    if (!s)
        return;
    free_objects(own);
    if (s->context)
        s->free_context(&s->context);
    for (size_t k = LIBRARY_COUNT; k-- > 0;)
        if (s->libraries[k])
            unload(s->libraries[k]);
    free(s);
    own->sundials = NULL;
}

/* ---- messages ---------------------------------------------------------------------------------------------------- */

void clear_report(Instance *own)
{
    if (own->sundials)
        own->sundials->report[0] = '\0';
}

/* Log what SUNDIALS has reported in a step that failed. */
void warn_reported(Instance *own)
{
    if (own->sundials && own->sundials->report[0]) {
        add(own->sundials->report, " [sundials-error]");
        warn(own, own->sundials->report);
        clear_report(own);
    }
}
