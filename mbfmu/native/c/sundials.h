/* SUNDIALS IDA, from the libraries of SUNDIALS in the folder of the FMU's own library. Each instance has a context of
   its own, and addresses of functions in the table of its block (solvers/steppers/ida/calls.py). */

#ifndef MBFMU_SUNDIALS_H
#define MBFMU_SUNDIALS_H

#include "instance.h"

typedef struct Sundials Sundials;

bool open_sundials(Instance *own, char text[SAYS]);
void close_sundials(Instance *own);
void fill_table(Instance *own);
void free_objects(Instance *own);
void clear_report(Instance *own);
void warn_reported(Instance *own);

#endif
