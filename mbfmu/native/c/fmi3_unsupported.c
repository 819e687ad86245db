/* Functions of FMI 3.0 that hosts look for, and this FMU does not offer. */

#include "fmi3_host.h"

static fmi3Status refused(fmi3Instance c, const char *call)
{
    return c ? (fmi3Status)not_offered(instance(c), call) : fmi3Error;
}

#define NOT_OFFERED(name, parameters)                                              \
    fmi3Status name parameters                                                     \
    {                                                                              \
        return refused(c, #name);                                                  \
    }
#define NO_TYPE(kind)                                                              \
    NOT_OFFERED(fmi3Get##kind, (fmi3Instance c, const fmi3ValueReference[], size_t, fmi3##kind[], size_t)) \
    NOT_OFFERED(fmi3Set##kind, (fmi3Instance c, const fmi3ValueReference[], size_t, const fmi3##kind[], size_t))
#define REFERENCES const fmi3ValueReference[], size_t

NO_TYPE(Float32)
NO_TYPE(Int8)
NO_TYPE(UInt8)
NO_TYPE(Int16)
NO_TYPE(UInt16)
NO_TYPE(Int32)
NO_TYPE(UInt32)
NO_TYPE(UInt64)
NOT_OFFERED(fmi3SetString, (fmi3Instance c, REFERENCES, const fmi3String[], size_t))
NOT_OFFERED(fmi3GetBinary, (fmi3Instance c, REFERENCES, size_t[], fmi3Binary[], size_t))
NOT_OFFERED(fmi3SetBinary, (fmi3Instance c, REFERENCES, const size_t[], const fmi3Binary[], size_t))
NOT_OFFERED(fmi3GetClock, (fmi3Instance c, REFERENCES, fmi3Clock[]))
NOT_OFFERED(fmi3SetClock, (fmi3Instance c, REFERENCES, const fmi3Clock[]))
NOT_OFFERED(fmi3GetNumberOfVariableDependencies, (fmi3Instance c, fmi3ValueReference, size_t *))
NOT_OFFERED(fmi3GetVariableDependencies, (fmi3Instance c, fmi3ValueReference, size_t[], fmi3ValueReference[], size_t[],
            fmi3DependencyKind[], size_t))
NOT_OFFERED(fmi3EnterConfigurationMode, (fmi3Instance c))
NOT_OFFERED(fmi3ExitConfigurationMode, (fmi3Instance c))
NOT_OFFERED(fmi3GetIntervalDecimal, (fmi3Instance c, REFERENCES, fmi3Float64[], fmi3IntervalQualifier[]))
NOT_OFFERED(fmi3GetIntervalFraction, (fmi3Instance c, REFERENCES, fmi3UInt64[], fmi3UInt64[], fmi3IntervalQualifier[]))
NOT_OFFERED(fmi3GetShiftDecimal, (fmi3Instance c, REFERENCES, fmi3Float64[]))
NOT_OFFERED(fmi3GetShiftFraction, (fmi3Instance c, REFERENCES, fmi3UInt64[], fmi3UInt64[]))
NOT_OFFERED(fmi3SetIntervalDecimal, (fmi3Instance c, REFERENCES, const fmi3Float64[]))
NOT_OFFERED(fmi3SetIntervalFraction, (fmi3Instance c, REFERENCES, const fmi3UInt64[], const fmi3UInt64[]))
NOT_OFFERED(fmi3SetShiftDecimal, (fmi3Instance c, REFERENCES, const fmi3Float64[]))
NOT_OFFERED(fmi3SetShiftFraction, (fmi3Instance c, REFERENCES, const fmi3UInt64[], const fmi3UInt64[]))
NOT_OFFERED(fmi3EvaluateDiscreteStates, (fmi3Instance c))
NOT_OFFERED(fmi3EnterStepMode, (fmi3Instance c))
NOT_OFFERED(fmi3ActivateModelPartition, (fmi3Instance c, fmi3ValueReference, fmi3Float64))
