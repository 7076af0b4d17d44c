"""Variable h: sums whose particles carry smoothing lengths of their own.

`moments` are exact in the gradient of h, `scenes` predicts particles with slowly varying h and
spacing, `atmosphere` is the error of an acceleration where h follows the density.
"""
