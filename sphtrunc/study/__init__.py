"""Studies: theory beside experiment.

Comparison, sweeps over settings, tuning of h and Δx, and why somebody's error stops falling. Here,
and nowhere below, predictions and measurements meet; the difference of the two is the test.
"""
