/* Co-simulation of an FMU of FMI 2.0 whose sources are compiled with this file:
   driver TOKEN REFERENCE STOP STEPS writes the variable's value at the stop time. */
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include "fmi2Functions.h"

static void log_nothing(fmi2ComponentEnvironment environment, fmi2String name, fmi2Status status,
                        fmi2String category, fmi2String message, ...) {
    (void)environment, (void)name, (void)status, (void)category, (void)message;
}

int main(int count, char **words) {
    const fmi2CallbackFunctions callbacks = {log_nothing, calloc, free, NULL, NULL};
    if (count != 5) return 2;
    const fmi2ValueReference reference = (fmi2ValueReference)atoi(words[2]);
    const double stop = atof(words[3]);
    const int steps = atoi(words[4]);
    fmi2Component fmu =
        fmi2Instantiate("one", fmi2CoSimulation, words[1], "", &callbacks, fmi2False, fmi2False);
    if (!fmu || fmi2SetupExperiment(fmu, fmi2False, 0, 0, fmi2False, 0) > fmi2Warning ||
        fmi2EnterInitializationMode(fmu) > fmi2Warning ||
        fmi2ExitInitializationMode(fmu) > fmi2Warning)
        return 1;
    for (int i = 0; i < steps; i++)
        if (fmi2DoStep(fmu, stop * i / steps, stop / steps, fmi2True) > fmi2Warning) return 1;
    double value = 0;
    if (fmi2GetReal(fmu, &reference, 1, &value) > fmi2Warning) return 1;
    printf("%.17g\n", value);
    fmi2Terminate(fmu);
    fmi2FreeInstance(fmu);
    return 0;
}
