"""An FMU in CasADi, integrated by CVODES: FILE OUTPUT TYPE STOP_TIME."""

import sys
import tempfile
import zipfile

import casadi

path, output, _, stop_time = sys.argv[1:]
folder = tempfile.mkdtemp()
zipfile.ZipFile(path).extractall(folder)
dae = casadi.DaeBuilder("fmu", folder)
functions = dae.create("functions", ["t", "x", "u"], ["ode", "y"])
t, x, u = casadi.MX.sym("t"), casadi.MX.sym("x", dae.nx()), casadi.MX.sym("u", dae.nu())
slope, outputs = functions(t, x, u)
problem = {"t": t, "x": x, "u": u, "ode": slope}
integrator = casadi.integrator("integrator", "cvodes", problem, 0.0, float(stop_time), {"reltol": 1e-6, "abstol": 1e-8})
starts = [[float(dae.start(name)) for name in names] for names in (dae.x(), dae.u())]
end = integrator(x0=starts[0], u=starts[1])["xf"]
print("result", stop_time, float(functions(float(stop_time), end, starts[1])[1][dae.y().index(output)]))
