"""The model of a throw: parameters, priors, request, problem and residuals."""
