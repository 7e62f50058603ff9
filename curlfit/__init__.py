"""Friction coefficients from the trajectory of a curling stone.

curlfit fits a friction law to a measured path (time, position and, if available, angle), samples
the posterior, and reports which coefficients the path determines and which it does not.

    import curlfit
    throw = curlfit.load_throw("data/jensen_shegelski_2004.csv")
    fit = curlfit.fit(throw)               # in a notebook, a table
    fit["mu2_xi"], fit.residuals["x"], fit.to_frame()
    fit, chain = curlfit.sample(fit)
    curlfit.fit_figure(fit); curlfit.corner_figure(fit, chain); curlfit.explore(fit)

Most used:

    load_throw   a throw from a file; `Throw.from_arrays`, `Throw.from_frame` from memory
    fit          coefficients and initial state of one throw; `fit_together` for several
    sample       the posterior; `chain.to_frame`, `chain.to_arviz`
    compare      which law describes the data best
    profile      intervals where chi squared is not quadratic
    predict      another throw on the same ice; `design` plans a measurement
    write_report any of these results as one HTML page to share
    simulate     the model itself, for `jax.jit`, `vmap` and derivatives

`dir(curlfit)` lists all names, `help(curlfit.fit)` shows arguments and an example; for the rest see
the pages and notebooks named in the README.

Axes: y along the sheet, x to the right of it, angle and spin counter-clockwise; SI units and
radians. `import curlfit` makes JAX compute with 64-bit numbers, whatever JAX_ENABLE_X64 says.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from curlfit.version import __version__

if TYPE_CHECKING:
    from curlfit.comparison.compare import compare
    from curlfit.comparison.figures import comparison_figure
    from curlfit.comparison.report import print_comparison
    from curlfit.comparison.result import Comparison, load_comparison
    from curlfit.dynamics.aim import Aim, aim
    from curlfit.dynamics.trajectory import InitialState, Trajectory, simulate
    from curlfit.errors import CurlfitError, DataError, InputError, UnusableFitError
    from curlfit.exploration.explore import explore
    from curlfit.friction import LAWS, Law, LocalLaw, NetLaw, coefficient, find_law
    from curlfit.html_report.page import write_report
    from curlfit.inference.figures import corner_figure, fit_figure, joint_figure
    from curlfit.inference.fit.fit import fit
    from curlfit.inference.fit.result import FitResult, Posterior, load_fit
    from curlfit.inference.joint.fit import fit_together
    from curlfit.inference.joint.report import print_joint
    from curlfit.inference.joint.result import JointResult, load_joint
    from curlfit.inference.mcmc.chain import Chain, load_chain
    from curlfit.inference.mcmc.sampler import sample
    from curlfit.inference.report import print_fit
    from curlfit.optimal_design.design import design
    from curlfit.optimal_design.figures import design_figures
    from curlfit.optimal_design.report import print_design
    from curlfit.optimal_design.result import Design, load_design
    from curlfit.paper.claim import Claim
    from curlfit.paper.reproduce import Reproduction, reproduce
    from curlfit.prediction.figures import prediction_figure
    from curlfit.prediction.predict import held_out, predict
    from curlfit.prediction.report import print_prediction
    from curlfit.prediction.result import Prediction, load_prediction
    from curlfit.profile_likelihood.figures import profile_figure
    from curlfit.profile_likelihood.profile import profile
    from curlfit.profile_likelihood.report import print_profile
    from curlfit.profile_likelihood.result import PairProfile, Profile, load_profile
    from curlfit.stone import Stone
    from curlfit.throws.load import load_throw
    from curlfit.throws.synthetic import law_with, synthetic_throw
    from curlfit.throws.throw import Throw

# A user's function may be traced before any name of curlfit is used, and the width of numbers
# cannot change during tracing. JAX reads the environment variable when it is imported.
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    os.environ["JAX_ENABLE_X64"] = "1"

# Each run-time check of equinox calls Python, and a program with such a call cannot be stored.
# curlfit checks the status of optimistix itself.
os.environ.setdefault("EQX_ON_ERROR", "nan")

# The module of each public name. Names are imported on first use, so that `import curlfit` and the
# command line's help need neither JAX nor matplotlib.
_HOMES = {
    "dynamics.aim": ("Aim", "aim"),
    "inference.mcmc.chain": ("Chain", "load_chain"),
    "paper.claim": ("Claim",),
    "paper.reproduce": ("Reproduction", "reproduce"),
    "comparison.compare": ("compare",),
    "comparison.result": ("Comparison", "load_comparison"),
    "errors": ("CurlfitError", "DataError", "InputError", "UnusableFitError"),
    "comparison.figures": ("comparison_figure",),
    "inference.figures": ("corner_figure", "fit_figure", "joint_figure"),
    "optimal_design.figures": ("design_figures",),
    "prediction.figures": ("prediction_figure",),
    "profile_likelihood.figures": ("profile_figure",),
    "exploration.explore": ("explore",),
    "inference.fit.fit": ("fit",),
    "friction": ("LAWS", "Law", "LocalLaw", "NetLaw", "coefficient", "find_law"),
    "inference.joint.result": ("JointResult", "load_joint"),
    "dynamics.trajectory": ("InitialState", "Trajectory", "simulate"),
    "optimal_design.design": ("design",),
    "optimal_design.result": ("Design", "load_design"),
    "prediction.predict": ("held_out", "predict"),
    "prediction.result": ("Prediction", "load_prediction"),
    "profile_likelihood.result": ("PairProfile", "Profile", "load_profile"),
    "profile_likelihood.profile": ("profile",),
    "throws.load": ("load_throw",),
    "inference.report": ("print_fit",),
    "comparison.report": ("print_comparison",),
    "optimal_design.report": ("print_design",),
    "inference.joint.report": ("print_joint",),
    "prediction.report": ("print_prediction",),
    "profile_likelihood.report": ("print_profile",),
    "inference.fit.result": ("FitResult", "Posterior", "load_fit"),
    "inference.mcmc.sampler": ("sample",),
    "stone": ("Stone",),
    "throws.synthetic": ("law_with", "synthetic_throw"),
    "throws.throw": ("Throw",),
    "inference.joint.fit": ("fit_together",),
    "html_report.page": ("write_report",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [  # noqa: RUF022  (in the order of use)
    "load_throw", "Throw", "fit", "FitResult", "print_fit", "sample", "Chain", "Posterior",
    "fit_figure", "corner_figure", "explore", "load_fit", "load_chain",
    "fit_together", "JointResult", "print_joint", "joint_figure", "load_joint",
    "compare", "Comparison", "print_comparison", "comparison_figure", "load_comparison",
    "predict", "Prediction", "print_prediction", "prediction_figure", "load_prediction",
    "held_out", "aim", "Aim",
    "design", "Design", "print_design", "design_figures", "load_design",
    "profile", "Profile", "PairProfile", "print_profile", "profile_figure", "load_profile",
    "write_report",
    "Stone", "InitialState", "Trajectory", "simulate", "synthetic_throw",
    "reproduce", "Reproduction", "Claim",
    "LAWS", "law_with", "find_law", "Law", "LocalLaw", "NetLaw", "coefficient",
    "CurlfitError", "InputError", "DataError", "UnusableFitError",
    "__version__",
]  # fmt: skip


def __getattr__(name: str) -> Any:
    home = _HOME_OF.get(name)
    if home is None:
        raise AttributeError(f"module 'curlfit' has no attribute {name!r}")
    return getattr(import_module(f"curlfit.{home}"), name)


def __dir__() -> list[str]:
    # `help(curlfit)` would print each of them in full, thousands of lines; the docstring is enough.
    # pydoc calls this through `inspect.getmembers`.
    frame = sys._getframe(1)
    for _ in range(3):
        if frame.f_globals.get("__name__") == "pydoc":
            return []
        frame = frame.f_back or frame
    return sorted(__all__)
