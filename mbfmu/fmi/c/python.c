/* The Python of an FMU: it is examined in a separate process, since a Python that cannot start ends its process. */

#define _GNU_SOURCE /* RTLD_DEFAULT, pipe2 */

#include "front.h"

#include <dlfcn.h>
#include <errno.h>
#include <fcntl.h>
#include <spawn.h>
#include <stdlib.h>
#include <string.h>
#include <sys/wait.h>
#include <unistd.h>
#include <wchar.h>

#define CHOICE "MBFMU_PYTHON" /* environment variable: program of the Python to use */
#define OUTPUT 65536          /* bytes that are kept of what Python prints */

extern char **environ;

/* Print what must be known of a Python, between bytes that nothing else prints. It is as in a process that contains
 * Python: the present folder is not searched for modules. */
static const char script[] =
    "import os, sys, sysconfig\n"
    "sys.path = [place for place in sys.path if place]\n"
    "name = sysconfig.get_config_var('INSTSONAME') or 'libpython'\n"
    "places = [sysconfig.get_config_var('LIBDIR') or '', os.path.join(sys.base_prefix, 'lib')]\n"
    "files = [os.path.join(place, name) for place in places if '.so' in name]\n"
    "library = next((file for file in files if os.path.isfile(file)), '')\n"
    "try:\n"
    "    import mbfmu\n"
    "    version, error = mbfmu.__version__, ''\n"
    "except BaseException as raised:\n"
    "    version, error = '', type(raised).__name__ + ': ' + str(raised)\n"
    "program = sys.executable or os.path.realpath('/proc/self/exe')\n"
    "parts = sys.version.split()[0], program, name, library, version, error\n"
    "sys.stdout.flush()\n"
    "os.write(1, b'\\1' + b'\\2'.join(os.fsencode(part) for part in parts) + b'\\3')\n";

typedef struct {
    const char *python, *program, *name, *library, *mbfmu, *error;
} Found;

/* What to do if a Python is not the right one. */
#define ADVICE(version) \
    ". Set the environment variable " CHOICE " to the program of a Python in which mbfmu ", version, \
    " is installed, such as /home/me/venv/bin/python3, or put its folder first in PATH [no-python]"

/* Return the environment without the libraries that are loaded into every program; NULL: there is no memory. */
static char **environment_of_child(void)
{
    size_t count = 0, kept = 0;
    while (environ && environ[count])
        count++;
    char **own = calloc(count + 1, sizeof *own);
    for (size_t k = 0; own && k < count; k++)
        if (strncmp(environ[k], "LD_PRELOAD=", sizeof "LD_PRELOAD=" - 1) != 0)
            own[kept++] = environ[k];
    return own;
}

/* Keep the last of what a process prints, which begins with the first byte of its report if there is one. */
static void read_all(int file, char output[OUTPUT])
{
    size_t used = 0;
    for (ssize_t n; (n = read(file, output + used, OUTPUT - 1 - used)) != 0;) {
        if (n < 0 && errno != EINTR)
            break;
        used += n > 0 ? (size_t)n : 0;
        if (used == OUTPUT - 1) { /* full */
            memmove(output, output + OUTPUT / 2, used - OUTPUT / 2);
            used -= OUTPUT / 2;
        }
    }
    output[used] = '\0';
}

/* Run a Python and read what it prints; return an error number, 0: it was started. */
static int run(const char *program, char output[OUTPUT])
{
    char *const arguments[] = {(char *)program, "-c", (char *)script, NULL};
    char **own = environment_of_child();
    posix_spawn_file_actions_t files;
    pid_t child;
    int ends[2], wrong = own ? pipe2(ends, O_CLOEXEC) ? errno : 0 : ENOMEM;
    output[0] = '\0';
    if (!wrong) {
        posix_spawn_file_actions_init(&files);
        posix_spawn_file_actions_addopen(&files, 0, "/dev/null", O_RDONLY, 0);
        posix_spawn_file_actions_adddup2(&files, ends[1], 1);
        posix_spawn_file_actions_adddup2(&files, ends[1], 2);
        wrong = posix_spawnp(&child, program, &files, NULL, arguments, own);
        posix_spawn_file_actions_destroy(&files);
        close(ends[1]);
        if (!wrong) {
            read_all(ends[0], output);
            while (waitpid(child, NULL, 0) < 0 && errno == EINTR)
                continue;
        }
        close(ends[0]);
    }
    free(own);
    return wrong;
}

/* Split the report in what a Python has printed; false: there is none. */
static bool parse(char *output, Found *found)
{
    const char **parts[] = {&found->python, &found->program, &found->name, &found->library, &found->mbfmu, &found->error};
    char *at = strrchr(output, '\1'), *end = at ? strchr(at, '\3') : NULL;
    if (!end)
        return false;
    *end = '\0';
    for (size_t k = 0; k < sizeof parts / sizeof parts[0]; k++) {
        if (!at)
            return false;
        *parts[k] = ++at;
        at = strchr(at, '\2');
        if (at)
            *at = '\0';
    }
    return true;
}

/* Return the last line with an error that a process has printed, or the last one. */
static const char *reason_in(char *output)
{
    const char *reason = NULL, *last = NULL;
    for (char *line = strtok(output, "\r\n"); line; line = strtok(NULL, "\r\n")) {
        last = line;
        if (strstr(line, "rror: "))
            reason = line;
    }
    return reason ? reason : last ? last : "it prints nothing";
}

/* Whether the Python whose library is loaded has the same version, up to the minor number, as one that was examined. */
static bool is_same_version(const char *one, const char *other)
{
    size_t length = strcspn(one, ".");
    length += one[length] ? 1 + strcspn(one + length + 1, ".") : 0;
    return strncmp(one, other, length) == 0 && strchr(". +abcr", other[length]) != NULL;
}

/* Load the library of Python for all libraries of this process, and let it start as its program does. */
static bool load(const Found *found, const char *version, char why[SAYS])
{
    const char *(*version_of)(void) = (const char *(*)(void))dlsym(RTLD_DEFAULT, "Py_GetVersion");
    if (version_of && !is_same_version(found->python, version_of())) {
        char loaded[SAYS];
        SAY(loaded, version_of());
        loaded[strcspn(loaded, " ")] = '\0';
        SAY(why, "the library of Python ", loaded, " is loaded in this process, but '", found->program, "' is Python ",
            found->python, "; both must have the same version. Start the importing tool without LD_PRELOAD, or set the "
            "environment variable " CHOICE " to the program of a Python ", loaded, " in which mbfmu ", version,
            " is installed [no-python]");
        return false;
    }
    if (!version_of && !found->library[0]) {
        SAY(why, "Python ", found->python, " ('", found->program, "') has no shared library '", found->name,
            "', which this process requires. Install it (in Debian the package libpython3.11 for Python 3.11)" ADVICE(version));
        return false;
    }
    if (!version_of && !dlopen(found->library, RTLD_NOW | RTLD_GLOBAL)) {
        const char *error = dlerror();
        SAY(why, "the library of Python '", found->library, "' cannot be loaded: ", error ? error : "unknown error",
            ADVICE(version));
        return false;
    }
    int *is_utf8 = dlsym(RTLD_DEFAULT, "Py_UTF8Mode"); /* as the program, without locale too: paths are UTF-8 */
    wchar_t *(*decode)(const char *, size_t *) = (wchar_t *(*)(const char *, size_t *))dlsym(RTLD_DEFAULT, "Py_DecodeLocale");
    void (*set_program)(const wchar_t *) = (void (*)(const wchar_t *))dlsym(RTLD_DEFAULT, "Py_SetProgramName");
    wchar_t *program = is_utf8 && decode && set_program ? decode(found->program, NULL) : NULL;
    if (program) {
        *is_utf8 = 1;
        set_program(program); /* Python keeps the text */
    } else
        SAY(why, "Python ", found->python, " ('", found->program, "') cannot be started in this process; allowed: Python 3.11 "
            "to 3.14", ADVICE(version));
    return program != NULL;
}

static bool is_running(void)
{
    int (*is_initialized)(void) = (int (*)(void))dlsym(RTLD_DEFAULT, "Py_IsInitialized");
    return is_initialized && is_initialized();
}

bool prepare_python(const char *version, char why[SAYS])
{
    const char *chosen = getenv(CHOICE), *program = chosen && chosen[0] ? chosen : "python3", *places = getenv("PATH");
    Found found;
    bool ready = false;
    if (is_running())
        return true;
    char *output = malloc(OUTPUT);
    int wrong = output ? run(program, output) : ENOMEM;
    if (wrong == ENOENT && program != chosen)
        SAY(why, "this FMU calls Python, but the folders of PATH ('", places ? places : "", "') contain no program 'python3'",
            ADVICE(version));
    else if (wrong)
        SAY(why, "the Python program '", program, "' cannot be started: ", strerror(wrong), ADVICE(version));
    else if (!parse(output, &found))
        SAY(why, "the Python program '", program, "' cannot start: ", reason_in(output), ADVICE(version));
    else if (strcmp(found.mbfmu, version) != 0 && found.mbfmu[0])
        SAY(why, "Python ", found.python, " ('", found.program, "') has mbfmu ", found.mbfmu, "; this FMU requires mbfmu ",
            version, ADVICE(version));
    else if (!found.mbfmu[0])
        SAY(why, "Python ", found.python, " ('", found.program, "') cannot import mbfmu (", found.error,
            "); this FMU requires mbfmu ", version, ADVICE(version));
    else
        ready = load(&found, version, why);
    free(output);
    return ready;
}
