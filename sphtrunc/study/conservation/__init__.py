"""Conservation: what momentum equations and density rates keep, beside the error that they make."""
