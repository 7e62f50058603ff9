"""Friction coefficients from the trajectory of a curling stone.

curlfit fits a friction law to a measured path (time, position and, if available,
angle), samples the posterior, and reports which coefficients the path determines and
which it does not.

    import curlfit
    throw = curlfit.load_throw("data/jensen_shegelski_2004.csv")
    fit = curlfit.fit(throw)               # in a notebook, a table
    fit["mu2_xi"], fit.residuals["x"], fit.to_frame()
    fit, chain = curlfit.sample(fit)
    curlfit.fit_figure(fit); curlfit.corner_figure(fit, chain); curlfit.explore(fit)

Most used:

    load_throw   a throw from a file; `Throw.from_arrays`, `Throw.from_frame` from
                 memory
    fit          coefficients and initial state of one throw; `fit_together` for several
    sample       the posterior; `chain.to_frame`, `chain.to_arviz`
    compare      which law describes the data best
    profile      intervals where chi squared is not quadratic
    predict      another throw on the same ice; `design` plans a measurement
    write_report any of these results as one HTML page to share
    simulate     the model itself, for `jax.jit`, `vmap` and derivatives

`dir(curlfit)` lists all names, `help(curlfit.fit)` shows arguments and an example; for
the rest see the pages and notebooks named in the README.

Axes: y along the sheet, x to the right of it, angle and spin counter-clockwise; SI
units and radians. `import curlfit` makes JAX compute with 64-bit numbers, whatever
JAX_ENABLE_X64 says.
"""

import os
import sys

# `python -m curlfit` has the working folder first on its path, where a file of data
# named as a module, such as numpy.py, would run in place of that module. It leaves the
# path before anything is imported: argv[0] is "-m" while Python looks for the module.
if (
    sys.argv[:1] == ["-m"]
    and sys.orig_argv[-len(sys.argv)] in ("curlfit", "-mcurlfit")
    and not sys.flags.safe_path
):
    _working_folder = sys.path.pop(0)
    # a checkout that is not installed is found there, after everything else
    if os.path.realpath(_working_folder) == os.path.realpath(f"{__path__[0]}/.."):
        sys.path.append(_working_folder)

import lazy_loader

# A user's function may be traced before any name of curlfit is used, and the width
# of numbers cannot change during tracing. JAX reads the environment variable when it
# is imported.
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    os.environ["JAX_ENABLE_X64"] = "1"

# Each run-time check of equinox calls Python, and a program with such a call cannot be
# stored. curlfit checks the status of optimistix itself.
os.environ.setdefault("EQX_ON_ERROR", "nan")

# Results of any kind find there what is said of them.
import curlfit.results  # noqa: F401

# Public names, listed in the stub beside this file, are imported on first use, so that
# `import curlfit` and the command line's help need neither JAX nor matplotlib.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
