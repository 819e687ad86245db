/* Functions of FMI 2.0 and 3.0 that differ in their prefix alone. The file that includes this one defines FMI(name), the
   function of its version, and the types Status, Component and Real. */

#define TEXT_OF(name) #name
#define EXPANDED_TEXT_OF(name) TEXT_OF(name)
#define NAME(name) EXPANDED_TEXT_OF(FMI(name)) /* for messages */

Status FMI(ExitInitializationMode)(Component c)
{
    return c ? (Status)exit_initialization(instance(c)) : (Status)ERROR;
}

Status FMI(Terminate)(Component c)
{
    return c ? (Status)terminate(instance(c)) : (Status)ERROR;
}

Status FMI(Reset)(Component c)
{
    return c ? (Status)reset(instance(c)) : (Status)ERROR;
}

Status FMI(EnterEventMode)(Component c)
{
    return c ? (Status)enter_event_mode(instance(c), NAME(EnterEventMode)) : (Status)ERROR;
}

Status FMI(EnterContinuousTimeMode)(Component c)
{
    return c ? (Status)enter_continuous_mode(instance(c), NAME(EnterContinuousTimeMode)) : (Status)ERROR;
}

Status FMI(SetContinuousStates)(Component c, const Real x[], size_t n)
{
    return c ? (Status)set_states(instance(c), NAME(SetContinuousStates), x, n) : (Status)ERROR;
}

Status FMI(GetContinuousStates)(Component c, Real x[], size_t n)
{
    return c ? (Status)get_states(instance(c), NAME(GetContinuousStates), x, n) : (Status)ERROR;
}

Status FMI(GetNominalsOfContinuousStates)(Component c, Real nominal[], size_t n)
{
    return c ? (Status)get_nominals(instance(c), NAME(GetNominalsOfContinuousStates), nominal, n) : (Status)ERROR;
}

Status FMI(GetEventIndicators)(Component c, Real z[], size_t n)
{
    return c ? (Status)get_indicators(instance(c), NAME(GetEventIndicators), z, n) : (Status)ERROR;
}
