"""Least-squares fits of throws: searches, revisions, uncertainties and records.

One fit, from `curlfit.fit` to its record
-----------------------------------------
    fit.fit_request                           a request becomes a record
      fit._fit
        throw_stack.ThrowStack                its problem; a stack of one throw
        search.fitted                         the search for its optima
          search._Search.outcomes
            ThrowStack.starts                 initial values, on all sides that may fit
            least_squares.minimize_many       from each of them
            revisions.revisions               sigma, robust loss, correlated noise, in
                                              this order; the fit is solved again
        summary.summarize                     from the optimum to the record
          optima.Optima                       what the optimum determines:
            .departures                       chi squared at probes about it; its ridge
                                              is followed where it is no quadratic
              .covariances                    made here first: Information.of the last
                                              Jacobian, FitCovariance.of_fit
              departures.to_be_held, ridge.follow
            .searched_on                      along a ridge to a lower optimum, if any
          summary._record                     FitCovariance.classified says errors and
                                              verdicts, Departures.judged has the last
                                              word; caveats.warnings_of
        change_points.change_of, advice       what the residuals show
        quantities.quantities_of              curl, turns, times of the path
        advice.remedies                       what would determine the rest

Throws of a batch take the same way in stacks (`fit.fit_throws`); throws that are fitted
together have `curlfit.inference.together`, which ends in `summary.summarize_many` too.

Reading order
-------------
fit                 the way above
throw_stack         the problems of throws, as the fits of these revise them
search              starts, restarts, solutions that fit equally
other_rests         starts with the rest of the stone in other rows of a measured spin
revisions           what follows a first fit: sigma, robust loss, correlated noise
residuals           residuals, the sigmas that they show, outliers
outcome             what a search ends with
optima              what optima determine
fit_covariance      errors, with the degrees of freedom that estimated sigmas leave
departures          how chi squared departs from its quadratic
ridge               values that fit about as well as the optimum
products            what stays constant along a ridge
summary             the record from the optimum
systematics         errors due to conditions that are held fixed
caveats, advice     warnings; what to measure or to type
change_points       when the residuals change
quantities          curl, turns, times between lines, mean friction
result, entries     the record, and the objects in it
estimates, estimate_columns    estimates, and columns of tables of them
curves              the path at other values of the parameters
problems            the problem of a saved fit; bounds and priors of requests
coefficient_rows    what a fit says of its coefficients, for fits of many throws
"""
