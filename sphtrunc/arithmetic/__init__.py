"""Arithmetic: the numbers in which sums are evaluated, and what each knows of its own error.

Floats, compensated floats, floats with a rigorous radius, pairs of floats, sixty digits, and floats
with derivatives: one formula, written once, runs in all of them. Nothing here knows what a kernel
or a particle is. The rule: whatever is rounded is either bounded or not claimed.
"""
