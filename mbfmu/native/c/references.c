/* Value references of FMI 3: first those of the variables, then that of the time, then those of arrays of variables. */

#include "instance.h"

uint32_t time_reference(const Instance *own)
{
    return (uint32_t)count_of(own);
}

static const Array *array_of(const Instance *own, uint32_t reference)
{
    const Array *arrays = section(own, own->header->arrays);
    uint32_t first = time_reference(own) + 1;
    return reference >= first && reference - first < own->header->arrays_count ? &arrays[reference - first] : NULL;
}

/* Return how many numbers a value reference stands for. */
size_t width(const Instance *own, uint32_t reference)
{
    const Array *array = array_of(own, reference);
    return array ? (size_t)array->count : 1;
}

/* Return the value reference of one of these numbers. */
uint32_t element(const Instance *own, uint32_t reference, size_t k)
{
    const Array *array = array_of(own, reference);
    const Member *members = section(own, own->header->members);
    return array ? (uint32_t)members[array->members + (int64_t)k].variable : reference;
}
