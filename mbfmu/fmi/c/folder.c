/* The folder of the resources of an FMU, and links to it. */

#define _GNU_SOURCE /* mkdtemp, realpath, strdup */

#include "front.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#define LINK "/resources" /* name of a link in its temporary folder */

typedef struct Link {
    struct Link *next;
    char *target;
    pid_t owner; /* a process that was forked from it does not remove the link */
    char path[];
} Link;

static Link *links; /* of this library */

bool join(char text[SAYS], const char *const parts[])
{
    size_t used = 0;
    for (; *parts; parts++) {
        size_t length = strlen(*parts), room = SAYS - 1 - used;
        memcpy(text + used, *parts, length < room ? length : room);
        used += length < room ? length : room;
        if (length > room)
            break;
    }
    text[used] = '\0';
    return !*parts;
}

bool read_line(const char *folder, const char *name, int number, char line[LINE])
{
    char path[SAYS];
    FILE *file = SAY(path, folder, "/", name) ? fopen(path, "rb") : NULL;
    bool there = file != NULL;
    for (int k = 0; there && k <= number; k++)
        there = fgets(line, LINE, file) != NULL;
    if (file)
        fclose(file);
    if (there)
        line[strcspn(line, "\r\n")] = '\0';
    return there && line[0];
}

/* Whether PythonFMU can use a path: it decodes %20 in it, and Python encodes other characters as the locale requires. */
static bool is_usable(const char *path)
{
    for (const char *c = path; *c; c++)
        if (*c == '%' || *c < ' ' || *c > '~')
            return false;
    return true;
}

/* Link to a folder from a new temporary one, which only this user can write to. */
static bool make_link(const char *target, char why[SAYS])
{
    const char *place = getenv("TMPDIR");
    char path[SAYS];
    if (!place || place[0] != '/' || !is_usable(place))
        place = "/tmp";
    Link *made = calloc(1, sizeof *made + strlen(place) + sizeof "/mbfmu_XXXXXX" LINK);
    if (made && (made->target = strdup(target)) && SAY(path, place, "/mbfmu_XXXXXX") && mkdtemp(path)) {
        strcat(strcpy(made->path, path), LINK);
        if (symlink(target, made->path) == 0) {
            made->owner = getpid();
            made->next = links;
            links = made;
            return true;
        }
        rmdir(path);
    }
    SAY(why, "folder '", target, "' has characters that PythonFMU does not accept, and no link to it can be created in '",
        place, "' (", strerror(errno), "). Set the environment variable TMPDIR to a folder that can be written to, or unzip "
        "the FMU into a folder whose path has only ASCII characters other than % [fmu-files]");
    if (made)
        free(made->target);
    free(made);
    return false;
}

bool usable_path(const char *folder, char path[SAYS], char why[SAYS])
{
    char *real = realpath(folder, NULL);
    if (!real || strlen(real) >= SAYS) {
        SAY(why, "folder '", folder, "' of the resource location is not accessible (", strerror(errno),
            "); required: the folder 'resources' of the unzipped FMU. Unzip the FMU again [fmu-files]");
        free(real);
        return false;
    }
    const char *found = is_usable(real) ? real : NULL;
    for (const Link *own = links; !found && own; own = own->next)
        if (strcmp(own->target, real) == 0)
            found = own->path;
    if (!found && make_link(real, why))
        found = links->path;
    if (found)
        strcpy(path, found);
    free(real);
    return found != NULL;
}

/* Called when this library is unloaded, which is at the end of the process if it has made instances. */
__attribute__((destructor)) static void remove_links(void)
{
    while (links) {
        Link *own = links;
        links = own->next;
        if (own->owner == getpid()) {
            unlink(own->path);
            *strrchr(own->path, '/') = '\0';
            rmdir(own->path);
        }
        free(own->target);
        free(own);
    }
}
