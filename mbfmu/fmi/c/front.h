/* The front of an FMU that calls Python: the parts that its files share. */

#ifndef MBFMU_FRONT_H
#define MBFMU_FRONT_H

#include <stdbool.h>
#include <stddef.h>

#define LINE 512  /* bytes of a line in a file of the FMU */
#define SAYS 4096 /* bytes of a message or a path */

/* Make a text of SAYS bytes of parts; false: it does not fit, and the end is left out. */
#define SAY(text, ...) join(text, (const char *const[]){__VA_ARGS__, NULL})
bool join(char text[SAYS], const char *const parts[]);

/* python.c: make a Python available in this process in which this version of mbfmu is installed, unless one is running;
 * false: the text says why not. */
bool prepare_python(const char *version, char why[SAYS]);

/* folder.c: a line, from number 0 on, of a file in a folder; false: there is none, or it is empty. */
bool read_line(const char *folder, const char *name, int number, char line[LINE]);
/* Return a path of a folder that PythonFMU can use, which is that of a link if the real one has other characters. */
bool usable_path(const char *folder, char path[SAYS], char why[SAYS]);

#endif
