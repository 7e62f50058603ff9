"""curlfit: friction coefficients from the trajectory of a curling stone.

    import curlfit
    throw = curlfit.load_throw("data/jensen_shegelski_2004.csv")
    fit = curlfit.fit(throw)
    fit, chain = curlfit.sample(fit)
    curlfit.fit_figure(fit); curlfit.corner_figure(fit, chain)

Axes: y along the sheet, x to the right of it, angle and spin counter-clockwise; SI units and
radians. With `import curlfit` JAX computes with 64-bit numbers, whatever JAX_ENABLE_X64 says.
"""

from __future__ import annotations

import os
import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

from curlfit.version import __version__

if TYPE_CHECKING:
    from curlfit.aiming import Aim, aim
    from curlfit.chain import Chain, load_chain
    from curlfit.claims import Claim, Reproduction, reproduce
    from curlfit.comparison import Comparison, compare, load_comparison
    from curlfit.errors import CurlfitError, DataError, InputError, UnusableFitError
    from curlfit.figures import comparison_figure, corner_figure, fit_figure, joint_figure
    from curlfit.figures_design import design_figures
    from curlfit.figures_prediction import prediction_figure
    from curlfit.figures_profile import profile_figure
    from curlfit.fitting import fit
    from curlfit.friction import LAWS, Law, LocalLaw, NetLaw, coefficient, find_law
    from curlfit.joint import JointResult, load_joint
    from curlfit.motion import Path, Start, simulate
    from curlfit.planning import Design, design, load_design
    from curlfit.prediction import held_out, predict
    from curlfit.predictions import Prediction, load_prediction
    from curlfit.profiles import PairProfile, Profile, load_profile
    from curlfit.profiling import profile
    from curlfit.readers import load_throw
    from curlfit.report import print_fit
    from curlfit.report_comparison import print_comparison
    from curlfit.report_design import print_design
    from curlfit.report_joint import print_joint
    from curlfit.report_prediction import print_prediction
    from curlfit.report_profile import print_profile
    from curlfit.results import FitResult, Posterior, load_fit
    from curlfit.sampling import sample
    from curlfit.stone import Stone
    from curlfit.synthetic import law_with, synthetic_throw
    from curlfit.throw import Throw
    from curlfit.together import fit_together

# A function of the user's may be traced before any name of curlfit is used, and the width of
# numbers cannot change while it is. JAX reads the variable when it is loaded.
if "jax" in sys.modules:
    sys.modules["jax"].config.update("jax_enable_x64", True)
else:
    os.environ["JAX_ENABLE_X64"] = "1"

# Where each public name lives. They are imported on first use, so that `import curlfit` and the
# command line's help need neither JAX nor matplotlib.
_HOMES = {
    "aiming": ("Aim", "aim"),
    "chain": ("Chain", "load_chain"),
    "claims": ("Claim", "Reproduction", "reproduce"),
    "comparison": ("Comparison", "compare", "load_comparison"),
    "errors": ("CurlfitError", "DataError", "InputError", "UnusableFitError"),
    "figures": ("comparison_figure", "corner_figure", "fit_figure", "joint_figure"),
    "figures_design": ("design_figures",),
    "figures_prediction": ("prediction_figure",),
    "figures_profile": ("profile_figure",),
    "fitting": ("fit",),
    "friction": ("LAWS", "Law", "LocalLaw", "NetLaw", "coefficient", "find_law"),
    "joint": ("JointResult", "load_joint"),
    "motion": ("Path", "Start", "simulate"),
    "planning": ("Design", "design", "load_design"),
    "prediction": ("held_out", "predict"),
    "predictions": ("Prediction", "load_prediction"),
    "profiles": ("PairProfile", "Profile", "load_profile"),
    "profiling": ("profile",),
    "readers": ("load_throw",),
    "report": ("print_fit",),
    "report_comparison": ("print_comparison",),
    "report_design": ("print_design",),
    "report_joint": ("print_joint",),
    "report_prediction": ("print_prediction",),
    "report_profile": ("print_profile",),
    "results": ("FitResult", "Posterior", "load_fit"),
    "sampling": ("sample",),
    "stone": ("Stone",),
    "synthetic": ("law_with", "synthetic_throw"),
    "throw": ("Throw",),
    "together": ("fit_together",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}

__all__ = [  # noqa: RUF022  (in the order of use)
    "load_throw", "Throw", "fit", "FitResult", "print_fit", "sample", "Chain", "Posterior",
    "fit_figure", "corner_figure", "load_fit", "load_chain",
    "fit_together", "JointResult", "print_joint", "joint_figure", "load_joint",
    "compare", "Comparison", "print_comparison", "comparison_figure", "load_comparison",
    "predict", "Prediction", "print_prediction", "prediction_figure", "load_prediction",
    "held_out", "aim", "Aim",
    "design", "Design", "print_design", "design_figures", "load_design",
    "profile", "Profile", "PairProfile", "print_profile", "profile_figure", "load_profile",
    "Stone", "Start", "Path", "simulate", "synthetic_throw",
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
    return sorted(__all__)
