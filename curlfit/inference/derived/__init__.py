"""Quantities that are made of the parameters of a fit, with their errors.

Where the values that fit lie on a curve, the ridge of the fit, a quantity is followed
along it: what moves there is as uncertain as it moves, and what is constant there is
determined, whatever its form. The product of a coefficient and the spin may be known
though neither is.

Reading order
-------------
expression          arithmetic of parameters, from a text: its value and gradient
quantiles           of a sample, at the levels that every table has
quantity            `Derived`: a value with its error, verdict and quantiles
first_order         `FirstOrder`: what a fit says of its parameters on the tangent;
                    standard errors, and shifts by the conditions held
along_ridge         what the points of the ridge say of a quantity
assessed            a quantity's error and verdict, from both
derive              from the text of an expression to the quantity
"""
