"""Kernels: exact shapes, and the one place where they become floats.

A kernel is a shape w(q), piecewise polynomial with rational knots and coefficients; every constant
is derived from it. `catalogue` holds the shapes with their sources, `parse` reads what people type,
`floats` and `factors` evaluate W, W′/q, (W′/q)′/q and W′/q³ from expansions about the outer end of
each piece, for theory and experiment alike; `transform` is F(k).
"""
