/* The library of an FMU that calls Python (FMI 2.0, co-simulation), in front of the library of PythonFMU.

   PythonFMU ends the process if it cannot find the folder of the FMU or start Python, and logs no reason if the importing
   tool has not requested messages. Therefore its library is loaded by this one, after everything it requires has been
   examined. All other calls are passed on. */

#define _GNU_SOURCE /* dladdr, RTLD_NODELETE */

#include "front.h"

#include <dlfcn.h>
#include <pthread.h>
#include <stdlib.h>
#include <string.h>

#include "fmi2Functions.h"
#include "location.h"

#define WRAPPER "pythonfmu-export.so" /* library of PythonFMU, in the folder of this one */
#define OWN_FILE "mbfmu.txt"          /* version of mbfmu and GUID, in the folder of the resources */

#define PASSED(X)                                                                                                     \
    X(Instantiate) X(FreeInstance) X(SetDebugLogging) X(SetupExperiment) X(EnterInitializationMode)                   \
    X(ExitInitializationMode) X(Terminate) X(Reset) X(GetReal) X(GetInteger) X(GetBoolean) X(GetString) X(SetReal)    \
    X(SetInteger) X(SetBoolean) X(SetString) X(GetFMUstate) X(SetFMUstate) X(FreeFMUstate) X(SerializedFMUstateSize)  \
    X(SerializeFMUstate) X(DeSerializeFMUstate) X(GetDirectionalDerivative) X(SetRealInputDerivatives)                \
    X(GetRealOutputDerivatives) X(DoStep) X(CancelStep) X(GetStatus) X(GetRealStatus) X(GetIntegerStatus)             \
    X(GetBooleanStatus) X(GetStringStatus)

#define MEMBER(name) fmi2##name##TYPE *name;
static struct {
    PASSED(MEMBER)
    void (*finalizePythonInterpreter)(void);
} wrapper; /* functions of PythonFMU */
static bool is_loaded;
static pthread_mutex_t loading = PTHREAD_MUTEX_INITIALIZER;

extern int __cxa_atexit(void (*function)(void *), void *argument, void *library);

typedef struct {
    fmi2Component component; /* of PythonFMU */
    const fmi2CallbackFunctions *callbacks; /* of the importing tool */
    fmi2CallbackFunctions own;
    bool logging, starting;
} Host;

/* Give a message to the importing tool. The text is a format: percent signs are doubled. */
static void deliver(const fmi2CallbackFunctions *callbacks, fmi2String name, fmi2Status status, fmi2String category,
                    const char *text)
{
    char format[2 * SAYS], *out = format;
    if (!callbacks || !callbacks->logger)
        return;
    for (const char *c = text; *c && out < format + sizeof format - 2; c++) {
        *out++ = *c;
        if (*c == '%')
            *out++ = '%';
    }
    *out = '\0';
    callbacks->logger(callbacks->componentEnvironment, name, status, category, format);
}

/* Pass a message of PythonFMU on, which is no format. The reason of an instantiation that fails is always logged, as the
 * standard requires. */
static void pass_message(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status, fmi2String category,
                         fmi2String text, ...)
{
    const Host *h = environment;
    if (h->logging || (h->starting && status >= fmi2Error))
        deliver(h->callbacks, name, status, category ? category : status < fmi2Error ? "logAll" : "logStatusError", text);
}

/* End Python before the process ends its libraries: PythonFMU would end it twice. */
static void finish(void *)
{
    wrapper.finalizePythonInterpreter();
}

/* Load PythonFMU's library, whose undefined functions are those of Python. Neither it nor this one is ever unloaded. */
static bool load_wrapper(char why[SAYS])
{
    char path[SAYS];
    Dl_info self;
    const char *end = dladdr((const void *)load_wrapper, &self) && self.dli_fname ? strrchr(self.dli_fname, '/') : NULL;
    size_t length = end ? (size_t)(end + 1 - self.dli_fname) : 0;
    void *library = NULL;
    if (length + sizeof WRAPPER <= sizeof path) {
        memcpy(path, length ? self.dli_fname : "", length);
        strcpy(path + length, WRAPPER);
        library = dlopen(path, RTLD_NOW | RTLD_LOCAL);
    }
    const char *error = library ? NULL : dlerror();
#define FIND(name) wrapper.name = library ? (fmi2##name##TYPE *)dlsym(library, "fmi2" #name) : NULL; found = found && wrapper.name;
    bool found = library != NULL;
    PASSED(FIND)
    wrapper.finalizePythonInterpreter = library ? (void (*)(void))dlsym(library, "finalizePythonInterpreter") : NULL;
    if (!found || !wrapper.finalizePythonInterpreter) {
        SAY(why, "library '", WRAPPER, "' in the folder of the library of the FMU cannot be loaded: ",
            error ? error : "functions are missing", ". Unzip the FMU again [fmu-files]");
        return false;
    }
    dlopen(self.dli_fname, RTLD_NOW | RTLD_NODELETE);
    return true;
}

/* Find out whether PythonFMU can make an instance, and give it a path that it can use; false: the text says why not. */
static bool check(fmi2Type type, fmi2String guid, fmi2String location, char path[SAYS], char version[LINE], char why[SAYS])
{
    char token[LINE], script[LINE], name[SAYS], folder[SAYS];
    if (type != fmi2CoSimulation) {
        SAY(why, type == fmi2ModelExchange ? "model exchange" : "this type of FMU", " is not supported: this FMU is for "
            "co-simulation. Instantiate it with the type fmi2CoSimulation, or export a native FMU [fmi-call]");
        return false;
    }
    if (!location || strlen(location) >= SAYS) {
        SAY(why, "the resource location is ", location ? "too long" : "NULL", "; required: the URI of the folder 'resources' "
            "of the unzipped FMU [fmi-call]");
        return false;
    }
    read_location(location, folder);
    if (!usable_path(folder, path, why))
        return false;
    bool whole = read_line(path, OWN_FILE, 0, version) && read_line(path, OWN_FILE, 1, token) &&
                 read_line(path, "slavemodule.txt", 0, script) && SAY(name, script, ".py") && read_line(path, name, 0, script);
    if (!whole) {
        SAY(why, "folder '", folder, "' does not contain the files of the FMU; required: the folder 'resources' of the unzipped "
            "FMU as the resource location. Unzip the FMU again [fmu-files]");
        return false;
    }
    if (strcmp(guid ? guid : "", token) != 0) {
        SAY(why, "the GUID is '", guid ? guid : "", "'; required: '", token, "', as in modelDescription.xml [fmi-call]");
        return false;
    }
    return true;
}

/* The same for one thread at a time. No thread waits here for Python, which other threads may occupy. */
static bool prepare(fmi2Type type, fmi2String guid, fmi2String location, char path[SAYS], char why[SAYS])
{
    char version[LINE];
    pthread_mutex_lock(&loading);
    bool ready = check(type, guid, location, path, version, why);
    if (ready && !is_loaded)
        ready = is_loaded = prepare_python(version, why) && load_wrapper(why);
    pthread_mutex_unlock(&loading);
    return ready;
}

fmi2Component fmi2Instantiate(fmi2String name, fmi2Type type, fmi2String guid, fmi2String location,
                              const fmi2CallbackFunctions *callbacks, fmi2Boolean visible, fmi2Boolean logging)
{
    char path[SAYS], why[SAYS];
    const char *known = name ? name : "";
    Host *host = calloc(1, sizeof *host);
    bool was_loaded = is_loaded;
    if (!host || !prepare(type, guid, location, path, why)) {
        deliver(callbacks, known, fmi2Error, "logStatusError",
                host ? why : "the memory for the instance cannot be allocated [out-of-memory]");
        free(host);
        return NULL;
    }
    host->callbacks = callbacks;
    host->own = (fmi2CallbackFunctions){pass_message, NULL, NULL, NULL, host};
    host->logging = logging != fmi2False;
    host->starting = true;
    host->component = wrapper.Instantiate(known, type, guid, path, &host->own, visible, fmi2True);
    host->starting = false;
    if (!was_loaded)
        __cxa_atexit(finish, NULL, NULL); /* after PythonFMU has started Python: what is registered last is called first */
    if (!host->component) {
        free(host);
        return NULL;
    }
    if (!host->logging)
        wrapper.SetDebugLogging(host->component, fmi2False, 0, NULL);
    return host;
}

void fmi2FreeInstance(fmi2Component c)
{
    Host *host = c;
    if (!host)
        return;
    wrapper.FreeInstance(host->component);
    free(host);
}

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean on, size_t n, const fmi2String categories[])
{
    Host *host = c;
    if (!host)
        return fmi2Error;
    host->logging = on != fmi2False;
    return wrapper.SetDebugLogging(host->component, on, n, categories);
}

const char *fmi2GetTypesPlatform(void)
{
    return fmi2TypesPlatform;
}

const char *fmi2GetVersion(void)
{
    return fmi2Version;
}

/* ---- states: PythonFMU ends the process if one is NULL or was freed ---------------------------------------------- */

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *state)
{
    if (!state || !*state)
        return fmi2OK;
    if (!c)
        return fmi2Error;
    fmi2Status status = wrapper.FreeFMUstate(((Host *)c)->component, state);
    *state = NULL;
    return status;
}

#define COMPONENT ((Host *)c)->component
#define PASS(needed, name, parameters, arguments)          \
    fmi2Status fmi2##name parameters                       \
    {                                                      \
        return c && (needed) ? wrapper.name arguments : fmi2Error; \
    }

PASS(state, GetFMUstate, (fmi2Component c, fmi2FMUstate *state), (COMPONENT, state))
PASS(state, SetFMUstate, (fmi2Component c, fmi2FMUstate state), (COMPONENT, state))
PASS(state && size, SerializedFMUstateSize, (fmi2Component c, fmi2FMUstate state, size_t *size), (COMPONENT, state, size))
PASS(state && bytes, SerializeFMUstate, (fmi2Component c, fmi2FMUstate state, fmi2Byte bytes[], size_t size),
     (COMPONENT, state, bytes, size))
PASS(state && bytes, DeSerializeFMUstate, (fmi2Component c, const fmi2Byte bytes[], size_t size, fmi2FMUstate *state),
     (COMPONENT, bytes, size, state))

/* ---- calls that are passed on as they are ------------------------------------------------------------------------ */

#define REFERENCES fmi2Component c, const fmi2ValueReference references[], size_t n
#define PASS_VALUES(kind)                                                                                      \
    PASS(true, Get##kind, (REFERENCES, fmi2##kind values[]), (COMPONENT, references, n, values))               \
    PASS(true, Set##kind, (REFERENCES, const fmi2##kind values[]), (COMPONENT, references, n, values))

PASS_VALUES(Real)
PASS_VALUES(Integer)
PASS_VALUES(Boolean)
PASS_VALUES(String)
PASS(true, SetupExperiment,
     (fmi2Component c, fmi2Boolean tolerant, fmi2Real tolerance, fmi2Real start, fmi2Boolean ends, fmi2Real stop),
     (COMPONENT, tolerant, tolerance, start, ends, stop))
PASS(true, EnterInitializationMode, (fmi2Component c), (COMPONENT))
PASS(true, ExitInitializationMode, (fmi2Component c), (COMPONENT))
PASS(true, Terminate, (fmi2Component c), (COMPONENT))
PASS(true, Reset, (fmi2Component c), (COMPONENT))
PASS(true, DoStep, (fmi2Component c, fmi2Real t, fmi2Real length, fmi2Boolean final), (COMPONENT, t, length, final))
PASS(true, CancelStep, (fmi2Component c), (COMPONENT))
PASS(true, SetRealInputDerivatives, (REFERENCES, const fmi2Integer orders[], const fmi2Real values[]),
     (COMPONENT, references, n, orders, values))
PASS(true, GetRealOutputDerivatives, (REFERENCES, const fmi2Integer orders[], fmi2Real values[]),
     (COMPONENT, references, n, orders, values))
PASS(true, GetDirectionalDerivative,
     (REFERENCES, const fmi2ValueReference knowns[], size_t m, const fmi2Real seed[], fmi2Real values[]),
     (COMPONENT, references, n, knowns, m, seed, values))
PASS(true, GetStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Status *value), (COMPONENT, kind, value))
PASS(true, GetRealStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Real *value), (COMPONENT, kind, value))
PASS(true, GetIntegerStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Integer *value), (COMPONENT, kind, value))
PASS(true, GetBooleanStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2Boolean *value), (COMPONENT, kind, value))
PASS(true, GetStringStatus, (fmi2Component c, const fmi2StatusKind kind, fmi2String *value), (COMPONENT, kind, value))
