/* Shared libraries in the folder of this one. */

#ifndef MBFMU_FOLDER_H
#define MBFMU_FOLDER_H

#include "core.h"

/* Load the library whose file name begins with these characters; NULL: the text says why not. It must be one of those
 * of the FMU. */
void *load_beside(const Instance *own, const char *beginning, char why[SAYS]);
void *function_of(void *library, const char *name);
void unload(void *library);

#endif
