from .batch.season import fit_season as fit_season
from .comparison.compare import compare as compare
from .comparison.figures import comparison_figure as comparison_figure
from .comparison.report import print_comparison as print_comparison
from .comparison.result import (
    Comparison as Comparison,
    load_comparison as load_comparison,
)
from .dynamics.aim import Aim as Aim, aim as aim
from .dynamics.trajectory import (
    InitialState as InitialState,
    Trajectory as Trajectory,
    simulate as simulate,
)
from .errors import (
    CurlfitError as CurlfitError,
    DataError as DataError,
    InputError as InputError,
    UnusableFitError as UnusableFitError,
)
from .findings.finding import Finding as Finding
from .friction import (
    LAWS as LAWS,
    Law as Law,
    LocalLaw as LocalLaw,
    NetLaw as NetLaw,
    coefficient as coefficient,
    find_law as find_law,
)
from .friction_tables.figures import friction_figure as friction_figure
from .friction_tables.fit import fit_friction as fit_friction
from .friction_tables.report import print_friction as print_friction
from .friction_tables.result import (
    FrictionFits as FrictionFits,
    load_friction as load_friction,
)
from .html_report.explore import explore as explore
from .html_report.page import write_report as write_report
from .inference.fit.estimates import Posterior as Posterior
from .inference.fit.fit import fit as fit
from .inference.fit.result import FitResult as FitResult, load_fit as load_fit
from .inference.sampling.chain import Chain as Chain, load_chain as load_chain
from .inference.sampling.sampler import sample as sample
from .inference.together.fit import fit_together as fit_together
from .inference.together.result import (
    JointResult as JointResult,
    load_joint as load_joint,
)
from .optimal_design.design import design as design
from .optimal_design.discriminate import discriminate as discriminate
from .optimal_design.discrimination import (
    Discrimination as Discrimination,
    load_discrimination as load_discrimination,
    print_discrimination as print_discrimination,
)
from .optimal_design.figures import (
    design_figures as design_figures,
    discrimination_figure as discrimination_figure,
)
from .optimal_design.report import print_design as print_design
from .optimal_design.result import Design as Design, load_design as load_design
from .paper.claim import Claim as Claim
from .paper.reproduce import Reproduction as Reproduction, reproduce as reproduce
from .prediction.figures import prediction_figure as prediction_figure
from .prediction.predict import held_out as held_out, predict as predict
from .prediction.report import print_prediction as print_prediction
from .prediction.result import (
    Call as Call,
    Prediction as Prediction,
    load_prediction as load_prediction,
)
from .profile_likelihood.figures import profile_figure as profile_figure
from .profile_likelihood.profile import profile as profile
from .profile_likelihood.report import print_profile as print_profile
from .profile_likelihood.result import (
    PairProfile as PairProfile,
    Profile as Profile,
    load_profile as load_profile,
)
from .reports.corner import corner_figure as corner_figure
from .reports.figures import fit_figure as fit_figure, joint_figure as joint_figure
from .reports.fit import print_fit as print_fit
from .reports.joint import print_joint as print_joint
from .stone import Stone as Stone
from .throws.friction_table import (
    FrictionTable as FrictionTable,
    load_friction_table as load_friction_table,
)
from .throws.load import load_throw as load_throw, load_throws as load_throws
from .throws.synthetic import law_with as law_with, synthetic_throw as synthetic_throw
from .throws.throw import Throw as Throw
from .version import __version__ as __version__
