r"""What data say of parameters to first order, of fits, joint fits and plans.

About values p0 of the parameters p, residuals over their sigma are r + J (p - p0). All
that chi squared says near p0 is in these rows [J, r], and by a QR decomposition in as
many rows [R, r] as there are parameters, and one (square-root information: forming
J^T J would lose half the digits, and with them the distinction between what is weakly
determined and what is not determined at all). A row is one equation about the
parameters: a linear combination of residuals, whose error is one; it is no row of the
data's table. `information.Information` is such rows with the names, values, typical
sizes and bounds of the parameters. A parameter divided
by its typical size is near one, so that a singular value of R, in typical sizes, says
how well its direction is determined: to 1/s typical sizes.

A direction that is not determined
----------------------------------
In the front-back law of Ivanov and Shuvalov (eq. 25-26) the friction along the motion
is proportional to mu1_eta under the front half of the ring and to mu2_eta under the
back half. Points of the two halves that mirror one another slide forward equally fast.
Under a uniform load both therefore brake the stone equally, and turn it equally: the
path tells the sum. The two columns of R are the same, and contours of chi squared are
no ellipses but a trough:

    mu2_eta
       |  \   \ \ \   \
       |    \   \ \ \   \        across it, chi squared rises: mu1_eta + mu2_eta is
       |      \   \ \ \   \      known, its direction has a large singular value
       |        \   \ * \   \
       |          \   \ \ \   \  along it, chi squared stays: the split of the sum,
       |            \   \ \ \    mu1_eta - mu2_eta, is not identifiable, its singular
       |              \   \ \    value is zero; * is the fit, where the search ended
       +------------------------ mu1_eta

The singular value decomposition of R turns the axes across and along the trough
(`directions`): the sum is a direction that the data see, the difference one that they
do not. The standard error of a parameter that takes part in an unseen direction is not
large but unknown. What is said instead is the sum, found from the directions as words
(`combinations`): "mu1_eta + mu2_eta
= 0.01757 +- 0.00002".

Two more things make a direction unknown or an error doubtful. Bounds: a trough that
leads across a narrow interval of bounds is limited by these alone, and a parameter that
the data push against its bound has a spread on one side of it (`bounds`). A curve: the
values that fit may bend away from the tangent, so that the rows say too much
(`ridge_information`; ridges are followed in `curlfit.inference.fit.ridge`).

Reading order
-------------
directions          which directions rows determine, and errors of weighted sums
bounds              values within bounds; the spread of a parameter at its bound
information         the noun, its sums and marginals; throws with parameters in common
combinations        directions as words
identifiability     rank, null directions, covariance and combinations of an Information
covariance          errors and verdicts at an optimum, some parameters at their bounds
thresholds          from which singular value, share or error on something is unknown
verdict             the verdicts, each with its meaning
intervals           confidence intervals by Student's t
named_matrix        a covariance, or J^T J, with the names of its parameters
ridge_information   what of an Information its ridge leaves

Quantities that are made of parameters, with their errors, are in
`curlfit.inference.derived`.
"""
