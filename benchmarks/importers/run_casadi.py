"""An FMU in CasADi, integrated by CVODES: FILE OUTPUT TYPE STOP_TIME.

CasADi reads start values of states from the description; states of a mechanism whose loops are closed when the FMU
is initialized have none there. They come from the initialized FMU, by FMPy.
"""

import sys

import casadi
import fmpy

path, output, _, stop_time = sys.argv[1:]
folder = str(fmpy.extract(path))
dae = casadi.DaeBuilder("fmu", folder)
description = fmpy.read_model_description(folder)
fmu = fmpy.instantiate_fmu(folder, description, "ModelExchange")
fmu.setupExperiment(startTime=0.0)
fmu.enterInitializationMode()
fmu.exitInitializationMode()
states = fmu.getReal([derivative.variable.derivative.valueReference for derivative in description.derivatives])
fmu.freeInstance()

functions = dae.create("functions", ["t", "x", "u"], ["ode", "y"])
t, x, u = casadi.MX.sym("t"), casadi.MX.sym("x", dae.nx()), casadi.MX.sym("u", dae.nu())
slope, _ = functions(t, x, u)
inputs = [dae.start(name)[0] for name in dae.u()]
problem = {"t": t, "x": x, "u": u, "ode": slope}
integrator = casadi.integrator("integrator", "cvodes", problem, 0.0, float(stop_time), {"reltol": 1e-6, "abstol": 1e-8})
end = integrator(x0=states, u=inputs)["xf"]
print("result", stop_time, float(functions(float(stop_time), end, inputs)[1][dae.y().index(output)]))
