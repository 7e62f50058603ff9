"""Every kind of result: its document, its figures, and how it is read.

To add one: a class here, in the call of `register` at the end. The rooms of the verbs
are imported within the methods, so that `import curlfit` and the command line load what
they need alone.
"""

from __future__ import annotations

from curlfit.output.kinds import Kind, Part, register

TYPE_CHECKING = False  # of `typing`, whose import takes as long as that of curlfit
if TYPE_CHECKING:
    from os import PathLike

    from matplotlib.figure import Figure

    from curlfit.comparison.result import Comparison
    from curlfit.friction_tables.result import FrictionFits
    from curlfit.inference.fit.estimates import Posterior
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.sampling.chain import Chain
    from curlfit.inference.together.result import JointResult
    from curlfit.optimal_design.discrimination import Discrimination
    from curlfit.optimal_design.result import Design
    from curlfit.output.document import Document
    from curlfit.prediction.result import Prediction
    from curlfit.profile_likelihood.result import PairProfile, Profile

    File = str | PathLike[str]


class _Fit(Kind):
    name = "fit"
    noun = "fit"

    def document(self, result: FitResult) -> Document:
        from curlfit.reports.fit import document

        return document(result)

    def figures(self, result: FitResult) -> dict[str, Figure]:
        from curlfit.reports.figures import fit_figure

        return {"fit": fit_figure(result)}

    def load(self, file: File) -> FitResult:
        from curlfit.inference.fit.result import load_fit

        return load_fit(file)


class _Joint(Kind):
    name = "joint"
    noun = "joint"
    figure_names = ("joint", "corner")

    def document(self, result: JointResult) -> Document:
        from curlfit.reports.joint import document

        return document(result)

    def figures(self, result: JointResult) -> dict[str, Figure]:
        from curlfit.reports.corner import corner_of
        from curlfit.reports.figures import joint_figure

        figures: dict[str, Figure] = {"joint": joint_figure(result)}
        if result.chain is not None:
            figures |= corner_of(result, result.chain)
        return figures

    def load(self, file: File) -> JointResult:
        from curlfit.inference.together.result import load_joint

        return load_joint(file)


class _Comparison(Kind):
    name = "compare"
    noun = "comparison"

    def document(self, result: Comparison) -> Document:
        from curlfit.comparison.report import document

        return document(result)

    def figures(self, result: Comparison) -> dict[str, Figure]:
        from curlfit.comparison.figures import comparison_figure

        return {"compare": comparison_figure(result)}

    def load(self, file: File) -> Comparison:
        from curlfit.comparison.result import load_comparison

        return load_comparison(file)


class _Prediction(Kind):
    name = "predict"
    noun = "prediction"

    def document(self, result: Prediction) -> Document:
        from curlfit.prediction.report import document

        return document(result)

    def figures(self, result: Prediction) -> dict[str, Figure]:
        from curlfit.prediction.figures import prediction_figure

        return {"predict": prediction_figure(result)}

    def load(self, file: File) -> Prediction:
        from curlfit.prediction.result import load_prediction

        return load_prediction(file)


class _Friction(Kind):
    name = "friction"
    noun = "friction"

    def document(self, result: FrictionFits) -> Document:
        from curlfit.friction_tables.report import document

        return document(result)

    def figures(self, result: FrictionFits) -> dict[str, Figure]:
        from curlfit.friction_tables.figures import friction_figure

        return {"friction": friction_figure(result)}

    def load(self, file: File) -> FrictionFits:
        from curlfit.friction_tables.result import load_friction

        return load_friction(file)


class _Profile(Kind):
    name = "profile"
    noun = "profile"

    def document(self, result: Profile | PairProfile) -> Document:
        from curlfit.profile_likelihood.report import document

        return document(result)

    def figures(self, result: Profile | PairProfile) -> dict[str, Figure]:
        from curlfit.profile_likelihood.figures import profile_figure

        return {"profile": profile_figure(result)}

    def load(self, file: File) -> Profile | PairProfile:
        from curlfit.profile_likelihood.result import load_profile

        return load_profile(file)


class _Design(Kind):
    name = "design"
    noun = "design"
    figure_names = ("design-map", "design-errors")

    def document(self, result: Design) -> Document:
        from curlfit.optimal_design.report import document

        return document(result)

    def figures(self, result: Design) -> dict[str, Figure]:
        from curlfit.optimal_design.figures import design_figures

        return design_figures(result)

    def load(self, file: File) -> Design:
        from curlfit.optimal_design.result import load_design

        return load_design(file)


class _Discrimination(Kind):
    name = "discrimination"
    noun = "discrimination"

    def document(self, result: Discrimination) -> Document:
        from curlfit.optimal_design.discrimination import document

        return document(result)

    def figures(self, result: Discrimination) -> dict[str, Figure]:
        from curlfit.optimal_design.figures import discrimination_figure

        return {"discrimination": discrimination_figure(result)}

    def load(self, file: File) -> Discrimination:
        from curlfit.optimal_design.discrimination import load_discrimination

        return load_discrimination(file)


class _Posterior(Part):
    name = "posterior"

    def document(self, part: Posterior) -> Document:
        from curlfit.reports.posterior import of_posterior

        return of_posterior(part)


class _Chain(Part):
    name = "chain"

    def document(self, part: Chain) -> Document:
        from curlfit.reports.posterior import of_chain

        return of_chain(part)


register(
    _Fit(),
    _Joint(),
    _Comparison(),
    _Prediction(),
    _Friction(),
    _Profile(),
    _Design(),
    _Discrimination(),
    _Posterior(),
    _Chain(),
)
